"""What Yosys made of a card sends and does what was written: the iCEBreaker's card, and a whole one for an ECP5."""

from pathlib import Path

import numpy as np
import pytest

from gateware.features import Features
from magtrak import protocol
from magtrak.frames import decode_frame
from magtrak.protocol import Access, Choice, Deframer, Detector, Packet, PacketType, frame_packet, register
from magtrak.protocol import Window as Span
from sim.core import ENCODER_A, ENCODER_B, INDEX, INTERLOCK, PIN, Outputs, SimulatedCore, load
from tests.support.netlist import FAMILIES, Family, as_written, compiled, synthesised

CLOCK_HZ = 1_000_000
ROWS, COLUMNS, ROW_CLOCKS = 12, 48, 80
LOOK = 50
"""Clocks of which the means of the pins are compared."""

X_SEED = 3
"""Of what the netlist leaves open."""


def command(number: int, name: str, value: int | None = None, word: int = 0) -> bytes:
    kind = PacketType.READ if value is None else PacketType.WRITE
    payload = protocol.COMMAND.pack({"address": register(name).address + word, "value": (value or 0) & 0xFFFF_FFFF})
    return frame_packet(Packet(kind, number, payload))


class Session:
    """A card under way: what it sent, and what its pins did on the way, at a look every :data:`LOOK` clocks."""

    def __init__(self, library: Path) -> None:
        self.core = SimulatedCore(CLOCK_HZ, CLOCK_HZ, serial=0x1234, compiled=load(library))
        self.sent = bytearray()
        self.pins: list[Outputs] = []
        self._rng = np.random.default_rng(6)

    def advance(self, clocks: int) -> None:
        until = self.core.clock + clocks
        while self.core.clock < until:
            self.pins.append(self.core.run(min(self.core.clock + LOOK, until)))
            self.sent.extend(self.core.receive())

    def write(self, **values: int) -> None:
        for name, value in values.items():
            self.core.send(command(7, name, value))

    def read_all(self) -> None:
        readable = [one.name for one in protocol.REGISTERS if one.access is not Access.WRITE and one.words == 1]
        for number, name in enumerate(readable):
            self.core.send(command(number, name))
        self.advance(40_000)

    def open_gate(self) -> None:
        """All colours pass that are not dark; of the bank that comes in force with the next commit."""
        for word in range(protocol.LUT_WORDS):
            for name in ("lut_hue", "lut_luminance", "lut_saturation"):
                dark = name == "lut_luminance" and word == 0
                self.core.send(command(8, name, 0 if dark else 0xFFFF_FFFF, word))
        self.advance(12_000)

    def image(self, lit: bool = True) -> None:
        """A line that leans, in noise, or the noise alone."""
        image = self._rng.integers(0, 12, (ROWS, COLUMNS, 3), dtype=np.uint8)
        middle = np.linspace(14, 33, ROWS)[:, None]
        image[:, :, 1] += (220 * lit * np.exp(-((np.arange(COLUMNS) - middle) ** 2) / 4.5)).astype(np.uint8)
        starts = self.core.clock + 1 + ROW_CLOCKS * np.arange(ROWS)
        self.core.rows(starts, image, frame_first=True, end=int(starts[-1]) + ROW_CLOCKS)
        self.advance(ROW_CLOCKS * ROWS + 3000)


def scenario(library: Path, features: Features) -> Session:
    """A host reads all registers, sets some, arms the laser, drives the motor, and images come by every detector; then
    by whatever else the card is built with.
    """
    card = Session(library)
    levels = [(ENCODER_A, ENCODER_B)[step % 2] for step in range(80)]
    turns = [(3000 + 90 * step, pin, (step // 2 + 1) % 2) for step, pin in enumerate(levels)]
    index = [(5000, INDEX, 1), (5400, INDEX, 0)]
    card.core.pins(np.array(sorted([(0, INTERLOCK, 1), *turns, *index]), PIN))
    card.core.send(b"\x05\x01\x02\x03\x04\x00")  # damaged
    card.write(laser_delay_ms=1, motor_duty=-9000, motor_mode=1, laser_arm=protocol.LASER_KEY)
    card.write(floor=12 if features.runs else 255, centroid_window=Span.HALF_7 if features.window else Span.RUN)
    card.write(detector=Detector.BINARY, run=1)
    card.read_all()
    detectors = list(Detector) if features.runs else [Detector.BINARY]
    for number, detector in enumerate(detectors):
        if number < 2:  # each bank
            card.open_gate()
        card.write(detector=detector, form=number % 2 if features.full_rows else 0, commit=number + 1)
        card.advance(3000)
        card.image()
    if features.isolate:
        card.write(isolate=2, choice=Choice.NEAREST, ambient_mode=1, ambient_measured=2)
        card.write(motor_speed=256 * 900, motor_kp=4000, motor_ki=300, motor_acceleration=256 * 4000, motor_mode=2)
        card.write(snapshot_step=3, snapshot=1, commit=50)
        card.advance(3000)
        for _ in range(6):
            card.image(card.pins[-1].laser)
    card.read_all()
    card.core.close()
    return card


@pytest.mark.parametrize("family", FAMILIES, ids=[family.name for family in FAMILIES])
def test_the_netlist_gives_the_same_packets(family: Family) -> None:
    libraries = compiled(as_written(family)), compiled(synthesised(family, X_SEED))
    written, made = (scenario(library, family.features) for library in libraries)
    assert written.sent == made.sent
    assert written.pins == made.pins
    packets = list(Deframer().feed(bytes(written.sent)))
    frames = [decode_frame(one.payload) for one in packets if one.type == PacketType.FRAME]
    detectors = list(Detector) if family.features.runs else [Detector.BINARY]
    assert [one.header["detector"] for one in frames[: len(detectors)]] == [int(one) for one in detectors]
    found = [int(one.rows.valid.sum()) for one in frames]
    assert found[: len(detectors)] == [ROWS] * len(detectors)
    answers = [protocol.ANSWER.unpack(one.payload) for one in packets if one.type == PacketType.ANSWER]
    assert len(answers) > 200
    assert any(one.laser for one in written.pins), "the laser was never on"
    assert any(one.drive for one in written.pins), "the motor never moved"
    if family.features.isolate:
        assert any(one.edges for one in frames)
        assert found[len(detectors) :] == [ROWS, 0, ROWS, ROWS, 0, ROWS], "every third is of the room alone"
        assert any(one.type == PacketType.SNAPSHOT for one in packets)
