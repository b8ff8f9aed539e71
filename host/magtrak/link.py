"""Packets in, packets out, over a serial port whose bytes a process of its own reads."""

import contextlib
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType

import serial

from .errors import EndOfStreamError, LinkError
from .port import BAUD, PORT_ERRORS, is_pseudo_terminal, open_port
from .protocol import Packet, frame_packet
from .reader import KILLED, Chunk, Reader
from .stream import PacketStream, Statistics


class Link:
    """Packets over a serial port.

    A process of its own empties the port and does nothing else, so that whatever the program does with a frame does not
    fill the system's buffer. Packets received before the port died are all given out before the error is raised.

    Parameters
    ----------
    port : name of the port, or of a symbolic link to it
    baud : baud rate

    Attributes
    ----------
    arrival_s : when the last bytes of the packet given out last came, s of the monotonic clock
    tap : called with every chunk as it came, before its packets are given out; for recordings

    Raises
    ------
    LinkError
        The port is not there, is none, or is in use.
    """

    def __init__(self, port: str, baud: int = BAUD) -> None:
        self.port = port
        self.arrival_s = 0.0
        self.tap: Callable[[Chunk], None] | None = None
        self._before = Statistics()
        self._stream = PacketStream()
        self._packets: deque[tuple[Packet, float]] = deque()
        self._sequence = 0
        self._is_pseudo_terminal = is_pseudo_terminal(port)
        self._serial = open_port(port, baud)
        try:
            self._reader = Reader(self._serial.fileno())
        except OSError as error:
            self._serial.close()
            raise LinkError(f"port {port} cannot be read: no process could be started ({error.strerror})") from None

    @property
    def statistics(self) -> Statistics:
        """Since the link was made, or since :meth:`begin`."""
        return self._stream.statistics(self._reader.backlog) - self._before

    @property
    def reader_pid(self) -> int:
        """Of the process that reads."""
        return self._reader.pid

    def begin(self) -> None:
        """Count anew: what came so far may be the rest of a stream for somebody else."""
        self._before = self._stream.statistics()

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
        except PORT_ERRORS:
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
            if self._reader.ended is not None:
                raise self._death()
            chunks = self._reader.read(max(deadline - time.monotonic(), 0))
            for chunk in chunks:
                self._take(chunk)
            if not chunks and self._reader.ended is None and time.monotonic() >= deadline:
                return None
        packet, self.arrival_s = self._packets.popleft()
        return packet

    def close(self) -> None:
        """Close the port and end the process."""
        self._reader.close()
        with contextlib.suppress(*PORT_ERRORS):
            self._serial.close()

    def __enter__(self) -> "Link":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _take(self, chunk: Chunk) -> None:
        if self.tap is not None:
            self.tap(chunk)
        self._packets += [(packet, chunk.arrival_s) for packet in self._stream.feed(chunk.data)]

    def _death(self) -> LinkError:
        if self._reader.ended == KILLED:
            return LinkError(f"{self.port} is not read any more: {KILLED}; start again")
        if self._is_pseudo_terminal and not self._stream.within_packet:
            return EndOfStreamError(f"{self.port} was closed by the other end")
        if self._is_pseudo_terminal:
            return LinkError(f"{self.port} was closed in the middle of a packet: the virtual card was stopped")
        return LinkError(f"{self.port} went away: check cable and power of the card, then start again")
