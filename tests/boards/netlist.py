"""What Yosys made of a card does, clock by clock, what was written: a small card for an iCE40, all for an ECP5."""

from pathlib import Path

import numpy as np
import pytest

from magtrak import protocol
from magtrak.frames import decode_frame
from magtrak.protocol import Access, Deframer, Packet, PacketType, frame_packet, register
from sim.core import ENCODER_A, ENCODER_B, INDEX, INTERLOCK, PIN, SimulatedCore, load
from tests.support.netlist import FAMILIES, Family, as_written, compiled, synthesised

CLOCK_HZ = 1_000_000
ROWS, COLUMNS, ROW_CLOCKS = 12, 48, 80
IMAGES = 4
X_SEED = 3
"""Of what the netlist leaves open."""


def command(number: int, name: str, value: int | None = None, word: int = 0) -> bytes:
    kind = PacketType.READ if value is None else PacketType.WRITE
    payload = protocol.COMMAND.pack({"address": register(name).address + word, "value": (value or 0) & 0xFFFF_FFFF})
    return frame_packet(Packet(kind, number, payload))


def scenario(library: Path) -> tuple[bytes, list[object]]:
    """All bytes of a card, and what its pins did, while a host reads all registers, sets some, arms the laser, drives
    the motor, and images come by every detector.
    """
    core = SimulatedCore(CLOCK_HZ, CLOCK_HZ, serial=0x1234, compiled=load(library))
    sent, pins = bytearray(), []

    def advance(clocks: int) -> None:
        until = core.clock + clocks
        while core.clock < until:
            pins.append(core.run(min(core.clock + 500, until)))
            sent.extend(core.receive())

    rng = np.random.default_rng(6)
    levels = [(ENCODER_A, ENCODER_B)[step % 2] for step in range(80)]
    turns = [(3000 + 90 * step, pin, (step // 2 + 1) % 2) for step, pin in enumerate(levels)]
    index = [(5000, INDEX, 1), (5400, INDEX, 0)]
    core.pins(np.array(sorted([(0, INTERLOCK, 1), *turns, *index]), PIN))
    readable = [one.name for one in protocol.REGISTERS if one.access is not Access.WRITE and one.words == 1]
    for number, name in enumerate(readable):
        core.send(command(number, name))
    core.send(b"\x05\x01\x02\x03\x04\x00")  # damaged
    settings = {
        "laser_delay_ms": 1,
        "floor": 12,
        "motor_period": 64,
        "motor_duty": -9000,
        "motor_mode": 1,
        "laser_arm": protocol.LASER_KEY,
    }
    for name, value in [*settings.items(), ("detector", 9), ("run", 1)]:
        core.send(command(7, name, value))
    for word in range(protocol.LUT_WORDS):  # one bank; the other after the first commit
        for name in ("lut_hue", "lut_luminance", "lut_saturation"):
            core.send(command(8, name, 0xFFFF_FFFF, word))
    advance(40_000)
    for number, detector in enumerate(protocol.Detector):
        if number == 1:
            for word in range(protocol.LUT_WORDS):
                for name in ("lut_hue", "lut_luminance", "lut_saturation"):
                    core.send(command(8, name, 0xFFFF_FFFF, word))
        core.send(command(8, "detector", detector) + command(9, "form", number % 2) + command(10, "commit", number + 1))
        advance(9000)
        image = rng.integers(0, 12, (ROWS, COLUMNS, 3), dtype=np.uint8)
        middle = np.linspace(14, 33, ROWS)[:, None]
        image[:, :, 1] += (220 * np.exp(-((np.arange(COLUMNS) - middle) ** 2) / 4.5)).astype(np.uint8)
        starts = core.clock + 1 + ROW_CLOCKS * np.arange(ROWS)
        core.rows(starts, image, frame_first=True, end=int(starts[-1]) + ROW_CLOCKS)
        advance(ROW_CLOCKS * ROWS + 3000)
    for number, name in enumerate(readable):
        core.send(command(number, name))
    advance(40_000)
    core.close()
    return bytes(sent), pins


@pytest.mark.parametrize("family", FAMILIES, ids=[family.name for family in FAMILIES])
def test_the_netlist_gives_the_same_packets(family: Family) -> None:
    cards = compiled(as_written(family)), compiled(synthesised(family, X_SEED))
    written, made = (scenario(library) for library in cards)
    assert written == made
    packets = list(Deframer().feed(written[0]))
    frames = [decode_frame(one.payload) for one in packets if one.type == PacketType.FRAME]
    assert [one.number for one in frames] == list(range(IMAGES))
    assert [one.header["detector"] for one in frames] == [int(one) for one in protocol.Detector]
    assert all(one.rows.valid.sum() == ROWS for one in frames)
    assert any(one.edges for one in frames)
    answers = [protocol.ANSWER.unpack(one.payload) for one in packets if one.type == PacketType.ANSWER]
    assert len(answers) > 200
    assert any(one.laser for one in written[1]), "the laser was never on"
    assert any(one.drive for one in written[1]), "the motor never moved"
