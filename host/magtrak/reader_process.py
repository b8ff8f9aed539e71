"""Empties a port in a process of its own; started by :mod:`magtrak.reader`, never imported by others.

The program that uses the data may be busy for seconds; here nothing is done but moving bytes from the port to a pipe,
so that the system's buffer does not fill. The standard library alone is used, so that it starts in some 20 ms.

Each piece that was read goes into the pipe behind a ``RECORD``: kind, when it came (monotonic clock, ns), bytes that
wait here for the program, and length. At most ``LIMIT`` bytes wait here; then the port is left alone, and the card
drops whole images and counts them. It ends when the port dies, and when the program closes the pipe or dies: a pipe
without a reader is reported at once, whatever killed the reader.
"""

import os
import select
import struct
import sys
import time
from collections import deque

RECORD = struct.Struct("<BQII")
DATA, END = 0, 1
"""Kinds of record: bytes of the port; why there will be no more, as text."""

LIMIT = 1 << 28
_READ = 1 << 16


def pump(port: int, pipe: int) -> None:
    """Move bytes from descriptor ``port`` to descriptor ``pipe`` until one of them ends."""
    os.set_blocking(pipe, False)
    poll = select.poll()
    poll.register(pipe, 0)  # whether it is broken is reported unasked
    waiting: deque[memoryview] = deque()
    held, listening, ended = 0, False, False
    while not ended or waiting:
        if listening != (want := not ended and held < LIMIT):
            listening = want
            poll.register(port, select.POLLIN) if want else poll.unregister(port)
        poll.modify(pipe, select.POLLOUT if waiting else 0)
        events = dict(poll.poll())
        if events.get(pipe, 0) & (select.POLLERR | select.POLLHUP | select.POLLNVAL):
            return
        if port in events:
            data, error = _read(port)
            kind, ended = (END, True) if error else (DATA, False)
            held += RECORD.size + len(data)
            waiting.append(memoryview(RECORD.pack(kind, time.monotonic_ns(), held, len(data)) + data))
        if waiting:
            held -= _write(pipe, waiting)


def _read(port: int) -> tuple[bytes, bool]:
    """What waits at the port; or why it died, and True."""
    try:
        data = os.read(port, _READ)
    except BlockingIOError:
        return b"", False
    except OSError as error:  # what termios raises elsewhere is an OSError here, too
        return (error.strerror or "error").encode(), True
    # A port that is ready to be read and has nothing is gone; it would say so for ever.
    return (data, False) if data else (b"hung up", True)


def _write(pipe: int, waiting: deque[memoryview]) -> int:
    """Bytes that went into the pipe."""
    moved = 0
    try:
        while waiting:
            count = os.write(pipe, waiting[0])
            moved += count
            if count < len(waiting[0]):
                waiting[0] = waiting[0][count:]
                break
            waiting.popleft()
    except BlockingIOError:
        pass
    except BrokenPipeError:
        raise SystemExit(0) from None
    return moved


if __name__ == "__main__":
    pump(int(sys.argv[1]), int(sys.argv[2]))
