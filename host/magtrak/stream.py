"""A stream of bytes from a card made into packets, and what was lost on the way."""

from dataclasses import astuple, dataclass

from .protocol import Deframer, Packet


@dataclass(frozen=True)
class Statistics:
    """What has been seen of a stream.

    Attributes
    ----------
    bytes : received
    packets : intact ones
    damaged : stretches of the stream that were no intact packet
    lost : gaps in the card's sequence numbers, damaged packets included
    restarts : sequence numbers that went back: the card was reset, or old data came again
    backlog : bytes that the program has been slow to take
    """

    bytes: int = 0
    packets: int = 0
    damaged: int = 0
    lost: int = 0
    restarts: int = 0
    backlog: int = 0

    def __add__(self, other: "Statistics") -> "Statistics":
        """Of two streams together."""
        return Statistics(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __sub__(self, other: "Statistics") -> "Statistics":
        """Since an earlier moment; the backlog is that of now."""
        earlier = (*astuple(other)[:-1], 0)
        return Statistics(*(a - b for a, b in zip(astuple(self), earlier, strict=True)))


class PacketStream:
    """Decodes a stream from anywhere in it, and counts."""

    def __init__(self) -> None:
        self._bytes = self._lost = self._restarts = 0
        self._deframer = Deframer()
        self._expected: int | None = None

    @property
    def within_packet(self) -> bool:
        """Bytes have come since the last packet's end."""
        return self._deframer.within_packet

    def statistics(self, backlog: int = 0) -> Statistics:
        """So far."""
        deframer = self._deframer
        return Statistics(self._bytes, deframer.packets, deframer.damaged, self._lost, self._restarts, backlog)

    def feed(self, data: bytes) -> list[Packet]:
        """Take the next bytes; the intact packets that they complete, in order."""
        self._bytes += len(data)
        packets = list(self._deframer.feed(data))
        for packet in packets:
            if self._expected is not None:
                gap = (packet.sequence - self._expected) & 0xFFFF
                if gap < 0x8000:
                    self._lost += gap
                else:  # backwards: what came earlier is not lost now
                    self._restarts += 1
            self._expected = (packet.sequence + 1) & 0xFFFF
        return packets
