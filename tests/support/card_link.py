"""The compiled card with a camera and a host that speaks the protocol, in card time, without a serial port."""

from collections import deque

import numpy as np

from magtrak import protocol
from magtrak.protocol import Deframer, Packet, PacketType, register
from sim.core import SimulatedCore

CLOCK_HZ = 2_000_000
BLANKING = 16
ROW_CLOCKS = 48
FRAME_GAP = 160
SLICE = 500
"""Clocks between two looks at what the card sent."""


class CardLink:
    """A card just after reset.

    Parameters
    ----------
    bytes_per_clock : speed of the link
    deframer : of the host; a card that was reset comes back on the same line

    Attributes
    ----------
    answers, frames, pieces : payloads, as they came, oldest first
    sent : all bytes from the card
    reading : the host takes what comes; if not, the line stands still
    """

    def __init__(self, bytes_per_clock: float = 1.0, deframer: Deframer | None = None) -> None:
        self.core = SimulatedCore(CLOCK_HZ, bytes_per_clock * CLOCK_HZ)
        self.deframer = deframer or Deframer()
        self.answers: deque[dict[str, int]] = deque()
        self.frames: list[bytes] = []
        self.pieces: list[bytes] = []
        self.sent = bytearray()
        self.reading = True
        self._sequence = 0
        self._expected: int | None = 0

    def close(self) -> None:
        self.core.close()

    def run(self, clocks: int) -> None:
        until = self.core.clock + clocks
        while self.core.clock < until:
            self.core.run(min(until, self.core.clock + SLICE))
            if self.reading:
                self.take()

    def take(self) -> None:
        """What the card sent; there is no gap in the numbers of its packets."""
        data = self.core.receive()
        self.sent += data
        for packet in self.deframer.feed(data):
            assert packet.sequence == self._expected, f"packet {packet.sequence}, not {self._expected}"
            self._expected = packet.sequence + 1 & 0xFFFF
            match packet.type:
                case PacketType.ANSWER:
                    self.answers.append(protocol.ANSWER.unpack(packet.payload))
                case PacketType.FRAME:
                    self.frames.append(packet.payload)
                case PacketType.SNAPSHOT:
                    self.pieces.append(packet.payload)
                case _:
                    raise AssertionError(f"a packet of type {packet.type}")

    def settle(self, quiet: int = 4000, limit: int = 10_000_000) -> None:
        """Run on until the card has taken everything and was silent for ``quiet`` clocks."""
        until, silent = self.core.clock + limit, 0
        while silent < quiet:
            before = len(self.sent)
            self.run(SLICE)
            silent = 0 if len(self.sent) > before or self.core.waiting else silent + SLICE
            assert self.core.clock < until, "the card never comes to rest"

    def command(self, kind: int, address: int, value: int = 0) -> dict[str, int]:
        """Send a command and run until its answer."""
        self._sequence = self._sequence + 1 & 0xFFFF
        payload = protocol.COMMAND.pack({"address": address, "value": value & 0xFFFF_FFFF})
        self.core.send(protocol.frame_packet(Packet(kind, self._sequence, payload)))
        for _ in range(100):
            self.run(SLICE)
            while self.answers:
                answer = self.answers.popleft()
                if answer["to"] == self._sequence:
                    return answer
        raise AssertionError(f"no answer to {kind} of 0x{address:04X}")

    def write(self, name: str, value: int, word: int = 0) -> int:
        return self.command(PacketType.WRITE, register(name).address + word, value)["code"]

    def read(self, name: str) -> int:
        return register(name).decode(self.command(PacketType.READ, register(name).address)["value"])

    def show(self, image: np.ndarray, row_clocks: int = 0) -> None:
        """Queue an image (rows, columns, 3), a pixel a clock, and let it pass."""
        rows, columns = image.shape[:2]
        row_clocks = max(row_clocks, columns + BLANKING, ROW_CLOCKS)
        starts = self.core.clock + 1 + row_clocks * np.arange(rows)
        end = int(starts[-1]) + row_clocks
        self.core.rows(starts, image, frame_first=True, end=end)
        self.run(end + FRAME_GAP - self.core.clock)
