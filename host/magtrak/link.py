"""The serial port: packets in, packets out, and one kind of error for all the ways in which a port dies."""

import contextlib
import queue
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

import serial

from .errors import EndOfStreamError, LinkError
from .protocol import Deframer, Packet, frame_packet

try:
    from termios import error as _termios_error
except ImportError:  # no termios on Windows, and no such error there
    _termios_error = OSError  # type: ignore[assignment,misc]

# Unplugging raises one or another of these, depending on the call; termios.error is no OSError.
_PORT_ERRORS = (serial.SerialException, OSError, _termios_error)

BAUD = 3_000_000
"""Baud rate of the boards' UART; on USB CDC and pseudo-terminals it means nothing."""


class Link:
    """Packets over a serial port.

    A thread of its own empties the port and does nothing else, so that whatever the program does with a frame does not
    fill the system's buffer. Packets received before the port died are all given out before the error is raised.

    Parameters
    ----------
    port : name of the port, or of a symbolic link to it
    baud : baud rate

    Attributes
    ----------
    bytes_received : so far
    lost_packets : gaps in the card's sequence numbers, damaged packets included

    Raises
    ------
    LinkError
        The port is not there, is none, or is in use.
    """

    def __init__(self, port: str, baud: int = BAUD) -> None:
        self.port = port
        self.bytes_received = 0
        self.lost_packets = 0
        self._deframer = Deframer()
        self._packets: deque[Packet] = deque()
        self._chunks: queue.SimpleQueue[bytes | Exception] = queue.SimpleQueue()
        self._ended: LinkError | None = None
        self._sequence = 0
        self._expected: int | None = None
        self._closing = False
        # Pseudo-terminals are named so on Linux; only there is a hang-up the orderly end of a card.
        self._is_pseudo_terminal = str(Path(port).resolve()).startswith("/dev/pts/")
        self._serial = _open(port, baud)
        self._reader = threading.Thread(target=self._read, name=f"reader of {port}", daemon=True)
        self._reader.start()

    @property
    def damaged_packets(self) -> int:
        """Stretches of the stream that were no intact packet."""
        return self._deframer.damaged

    @property
    def packets(self) -> int:
        """Intact packets."""
        return self._deframer.packets

    def send(self, kind: int, payload: bytes) -> int:
        """Send a packet, return its sequence number; :exc:`LinkError` where the port died."""
        sequence = self._sequence
        self._sequence = (sequence + 1) & 0xFFFF
        self.send_bytes(frame_packet(Packet(kind, sequence, payload)))
        return sequence

    def send_bytes(self, data: bytes) -> None:
        """Send bytes as they are."""
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise LinkError(f"{self.port} takes no more data: the other end does not read; restart it") from None
        except _PORT_ERRORS:
            raise self._death() from None

    def receive(self, timeout_s: float) -> Packet | None:
        """The next intact packet, or None where none came in time.

        Raises
        ------
        EndOfStreamError
            A pseudo-terminal was closed between two packets, and all packets have been given out.
        LinkError
            The port died, and all packets have been given out.
        """
        deadline = time.monotonic() + timeout_s
        while not self._packets:
            if self._ended is not None:
                raise self._ended
            try:
                chunk = self._chunks.get(timeout=max(deadline - time.monotonic(), 0))
            except queue.Empty:
                return None
            if isinstance(chunk, bytes):
                self._take(chunk)
            else:
                self._ended = self._death()
        return self._packets.popleft()

    def close(self) -> None:
        """Close the port."""
        self._closing = True
        with contextlib.suppress(*_PORT_ERRORS, AttributeError):
            self._serial.cancel_read()
        self._reader.join(timeout=1)
        with contextlib.suppress(*_PORT_ERRORS):
            self._serial.close()

    def __enter__(self) -> "Link":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _take(self, chunk: bytes) -> None:
        self.bytes_received += len(chunk)
        for packet in self._deframer.feed(chunk):
            if self._expected is not None:
                self.lost_packets += (packet.sequence - self._expected) & 0xFFFF
            self._expected = (packet.sequence + 1) & 0xFFFF
            self._packets.append(packet)

    def _death(self) -> LinkError:
        if self._is_pseudo_terminal and not self._deframer.within_packet:
            return EndOfStreamError(f"{self.port} was closed by the other end")
        if self._is_pseudo_terminal:
            return LinkError(f"{self.port} was closed in the middle of a packet: the virtual card was stopped")
        return LinkError(f"{self.port} went away: check cable and power of the card, then start again")

    def _read(self) -> None:
        try:
            while not self._closing:
                # A read of what waits moves megabytes a second; byte by byte it would be a tenth of one.
                data = self._serial.read(max(self._serial.in_waiting, 1))
                if data:
                    self._chunks.put(data)
        except Exception as error:  # a port that dies raises many things; each of them ends the stream
            self._chunks.put(error)


def _open(port: str, baud: int) -> serial.Serial:
    if not Path(port).exists() and "/" in port:
        raise LinkError(f"port {port} does not exist: is the card plugged in, or magtrak-sim running?")
    try:
        return serial.Serial(port, baud, timeout=0.1, write_timeout=2, exclusive=True)
    except _PORT_ERRORS as error:
        causes = list(_chain(error))
        if any(isinstance(cause, PermissionError) for cause in causes):
            cure = "this user may not open it; join the group that owns it (often 'dialout')"
        elif any(isinstance(cause, BlockingIOError) for cause in causes) or "exclusively lock" in str(error):
            cure = "another program has it open; close that first"
        else:
            cure = "it is no serial port, or broken; check the name"
        raise LinkError(f"port {port} cannot be opened: {cure}") from None
    except ValueError as error:
        raise LinkError(f"port {port} cannot be opened at {baud} baud: {error}") from None


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
