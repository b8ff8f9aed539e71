"""A host and a camera for a card inside the simulator."""

import random
from collections import deque
from dataclasses import dataclass

import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, Timer

from magtrak import protocol
from magtrak.protocol import AnswerCode, Packet, PacketType

CLOCK_HZ = 1_000_000
PERIOD_NS = 10
LINE_BLANKING = 16
ROW_CLOCKS = 48
FRAME_GAP = 80
PATIENCE = 200_000


@dataclass(frozen=True)
class Frame:
    """A frame packet, unpacked with the protocol's own layouts."""

    header: dict[str, int]
    edges: list[dict[str, int]]
    rows: list[dict[str, int]]


def unpack_frame(payload: bytes) -> Frame:
    header = protocol.FRAME.unpack(payload[: protocol.FRAME.size])
    at = protocol.FRAME.size
    parts = []
    for layout, count in ((protocol.EDGE, header["edges"]), (protocol.FULL_ROW, header["rows"])):
        parts.append([layout.unpack(payload[at + n * layout.size : at + (n + 1) * layout.size]) for n in range(count)])
        at += count * layout.size
    assert at == len(payload), f"{len(payload)} bytes in a frame, {at} expected"
    return Frame(header, *parts)


class CardDriver:
    """Drives the ports of ``boards/simulation.py`` at falling edges of the clock.

    Parameters
    ----------
    dut : the module ``top``
    rng : of all stalls and gaps
    stalls : part of the clocks in which either side of the link pauses
    pixel_ps : period of the pixels' clock, where they have one of their own

    Attributes
    ----------
    listening : the host reads; if not, the link stands still
    frames, pieces : received, oldest first; pieces are those of snapshots, with the pixels' bytes
    damaged : packets that came damaged; a test may not leave any behind
    """

    def __init__(self, dut, rng: random.Random, stalls: float = 0.3, pixel_ps: int | None = None) -> None:
        self.dut = dut
        self.rng = rng
        self.stalls = stalls
        self.listening = True
        self.pixel_clk = dut.pixel_clk if pixel_ps else dut.clk
        self.pixel_clock = Clock(self.pixel_clk, pixel_ps, unit="ps") if pixel_ps else None
        self.frames: deque[Frame] = deque()
        self.pieces: list[tuple[dict[str, int], bytes]] = []
        self._answers: deque[dict[str, int]] = deque()
        self._out: deque[int] = deque()
        self._deframer = protocol.Deframer()
        self._sequence = 0
        self._expected = 0

    @property
    def damaged(self) -> int:
        return self._deframer.damaged

    async def start(self) -> None:
        dut = self.dut
        for port in ("video_valid", "video_frame_end", "encoder_a", "encoder_b", "index", "rx_valid", "tx_ready"):
            getattr(dut, port).value = 0
        dut.interlock.value = 1
        dut.clock_hz.value = CLOCK_HZ
        Clock(dut.clk, PERIOD_NS, unit="ns").start()
        if self.pixel_clock:
            self.pixel_clock.start()
        await FallingEdge(dut.clk)

    async def link(self) -> None:
        """Background task: moves bytes both ways with random pauses, sorts packets."""
        dut, rng = self.dut, self.rng
        while True:
            await FallingEdge(dut.clk)
            sending = bool(self._out) and rng.random() >= self.stalls
            reading = self.listening and rng.random() >= self.stalls
            dut.rx_valid.value = sending
            if sending:
                dut.rx_data.value = self._out[0]
            dut.tx_ready.value = reading
            await Timer(PERIOD_NS // 4, "ns")  # settled: what holds now holds at the rising edge
            if sending and dut.rx_ready.value:
                self._out.popleft()
            if reading and dut.tx_valid.value:
                self._take(int(dut.tx_data.value))

    def _take(self, byte: int) -> None:
        for packet in self._deframer.feed(bytes([byte])):
            assert packet.sequence == self._expected, f"packet {packet.sequence} after {self._expected - 1}"
            self._expected = (self._expected + 1) % 65536
            if packet.type == PacketType.FRAME:
                self.frames.append(unpack_frame(packet.payload))
            elif packet.type == PacketType.SNAPSHOT:
                size = protocol.SNAPSHOT.size
                self.pieces.append((protocol.SNAPSHOT.unpack(packet.payload[:size]), packet.payload[size:]))
            else:
                assert packet.type == PacketType.ANSWER, packet.type
                self._answers.append(protocol.ANSWER.unpack(packet.payload))

    async def until(self, what: str, condition) -> None:
        for _ in range(PATIENCE):
            if condition():
                return
            await FallingEdge(self.dut.clk)
        raise AssertionError(f"{what} did not come within {PATIENCE} clocks")

    def send_raw(self, data: bytes) -> None:
        self._out.extend(data)

    async def command(self, kind: int, address: int, value: int = 0) -> dict[str, int]:
        """Send a command; its answer."""
        sequence = self._sequence
        self._sequence = (sequence + 1) % 65536
        payload = protocol.COMMAND.pack({"address": address, "value": value & 0xFFFF_FFFF})
        self.send_raw(protocol.frame_packet(Packet(kind, sequence, payload)))
        await self.until("an answer", lambda: self._answers)
        answer = self._answers.popleft()
        assert answer["to"] == sequence
        assert answer["address"] == address
        return answer

    async def write(self, name: str, value: int, word: int = 0) -> AnswerCode:
        answer = await self.command(PacketType.WRITE, protocol.register(name).address + word, value)
        return AnswerCode(answer["code"])

    async def read(self, name: str) -> int:
        register = protocol.register(name)
        answer = await self.command(PacketType.READ, register.address)
        assert answer["code"] == AnswerCode.DONE, answer
        return register.decode(answer["value"])

    async def show(self, image: np.ndarray, gaps: float = 0.0, pause: int = FRAME_GAP) -> None:
        """An image (rows, columns, 3), with random pauses between its pixels and the least blanking there may be.

        ``pause`` clocks follow it.
        """
        dut, rng, clock = self.dut, self.rng, self.pixel_clk
        if self.pixel_clock:  # the caller has the card's clock
            await FallingEdge(clock)
        for y, row in enumerate(image.tolist()):
            clocks = 0
            for x, (r, g, b) in enumerate(row):
                while x and gaps and rng.random() < gaps:
                    dut.video_valid.value = 0
                    await FallingEdge(clock)
                    clocks += 1
                dut.video_valid.value = 1
                dut.video_r.value = r
                dut.video_g.value = g
                dut.video_b.value = b
                dut.video_row_first.value = x == 0
                dut.video_row_last.value = x == len(row) - 1
                dut.video_frame_first.value = x == 0 and y == 0
                await FallingEdge(clock)
                clocks += 1
            dut.video_valid.value = 0
            for _ in range(max(LINE_BLANKING, ROW_CLOCKS - clocks)):
                await FallingEdge(clock)
        dut.video_frame_end.value = 1
        await FallingEdge(clock)
        dut.video_frame_end.value = 0
        for _ in range(pause):
            await FallingEdge(clock)
