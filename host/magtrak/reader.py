"""Bytes from a port, read by a process of its own: see :mod:`magtrak.reader_process`."""

import contextlib
import fcntl
import os
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from .reader_process import DATA, RECORD

KILLED = "the process that read it was ended"
"""Why nothing comes any more where the port has not died."""

_PROGRAM = Path(__file__).with_name("reader_process.py")
_PIPE_BYTES = 1 << 20
_READ = 1 << 20


@dataclass(frozen=True)
class Chunk:
    """Bytes as they came.

    Attributes
    ----------
    data : the bytes
    arrival_s : when they were read from the port, s of the monotonic clock
    """

    data: bytes
    arrival_s: float


class Reader:
    """Starts the process that empties a port, and takes over what it read.

    The process gets no signals of the terminal (Ctrl-C is the program's business), and ends with the program, however
    that ends. The main module of the program is not imported anew in it, so that a script needs no
    ``if __name__ == "__main__"``.

    Parameters
    ----------
    port : descriptor of the open port

    Attributes
    ----------
    backlog : bytes that waited in the process when it sent the newest ones
    ended : why there will be no more bytes; None while there may be
    """

    def __init__(self, port: int) -> None:
        self.backlog = 0
        self.ended: str | None = None
        self._rest = b""
        self._pipe, theirs = os.pipe()
        with contextlib.suppress(OSError, AttributeError):  # a small pipe will do, where no other is to be had
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        os.set_blocking(self._pipe, False)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", _PROGRAM, str(port), str(theirs)],
                stdin=subprocess.DEVNULL,
                pass_fds=(port, theirs),
                start_new_session=True,
            )
        finally:
            os.close(theirs)

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def read(self, timeout_s: float) -> list[Chunk]:
        """What has come, oldest first; waits for it up to ``timeout_s``. Sets ``ended`` at the end."""
        deadline = time.monotonic() + timeout_s
        while self.ended is None:
            # poll, not select: a program with many files may have descriptors above 1023.
            poll = select.poll()
            poll.register(self._pipe, select.POLLIN)
            if not poll.poll(1e3 * max(deadline - time.monotonic(), 0)):
                return []
            data = os.read(self._pipe, _READ)
            if not data:
                self.ended = KILLED
                break
            chunks = self._take(data)
            if chunks:
                return chunks
        return []

    def close(self) -> None:
        """End the process; what it has not handed over is lost."""
        os.close(self._pipe)
        try:
            self._process.wait(timeout=1)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _take(self, data: bytes) -> list[Chunk]:
        data = self._rest + data
        chunks = []
        at = 0
        while len(data) - at >= RECORD.size:
            kind, arrival_ns, self.backlog, length = RECORD.unpack_from(data, at)
            if len(data) - at - RECORD.size < length:
                break
            at += RECORD.size
            payload = data[at : at + length]
            at += length
            if kind == DATA:
                chunks.append(Chunk(payload, arrival_ns * 1e-9))
            else:
                self.ended = payload.decode("utf-8", "replace")
        self._rest = data[at:]
        return chunks
