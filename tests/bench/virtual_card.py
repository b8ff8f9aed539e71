"""How fast the virtual card runs, beside the same core under cocotb, a clock at a time."""

import json
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from magtrak import protocol
from sim.core import SimulatedCore
from sim.verilator import card_verilog
from tests.bench import Figure
from tests.support.cocotb import simulate_cocotb

WIDTH, HEIGHT, ROW_CLOCKS = 640, 480, 672
CLOCK_HZ = 20_000_000
RUN = protocol.Packet(
    protocol.PacketType.WRITE, 0, protocol.COMMAND.pack({"address": protocol.register("run").address, "value": 1})
)


def picture() -> np.ndarray:
    """A green line on noise, (HEIGHT, WIDTH, 3)."""
    rng = np.random.default_rng(1)
    image = rng.integers(0, 12, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    centre = np.linspace(100, 500, HEIGHT)[:, None]
    line = 180 * np.exp(-((np.arange(WIDTH) - centre) ** 2) / 4.5)
    image[:, :, 1] += line.astype(np.uint8)
    return image


def library_speed() -> float:
    """Clocks per second of the compiled card, pictures of 640 x 480 in without a pause."""
    core = SimulatedCore(CLOCK_HZ, 1.2e6)
    core.send(protocol.frame_packet(RUN))
    core.run(10_000)
    image = picture()
    frames = 10
    started, begin = time.perf_counter(), core.clock
    for frame in range(frames):
        start = begin + frame * (HEIGHT + 10) * ROW_CLOCKS + 10
        starts = start + ROW_CLOCKS * np.arange(HEIGHT)
        core.rows(starts, image, frame_first=True, end=int(starts[-1]) + WIDTH + 1)
        core.run(start + (HEIGHT + 10) * ROW_CLOCKS)
        core.receive()
    speed = (core.clock - begin) / (time.perf_counter() - started)
    core.close()
    return speed


def cocotb_speed() -> float:
    """Clocks per second of the same core when a cocotb coroutine sets the pixel at each clock."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "speed.json"
        variables = {"MAGTRAK_SPEED": os.fspath(result)}
        simulate_cocotb(card_verilog(), "tests.cocotb.tb_speed", variables=variables, optimise=True)
        return float(json.loads(result.read_text())["clocks_per_second"])


def run() -> Iterator[Figure]:
    fast, slow = library_speed(), cocotb_speed()
    yield Figure(
        "clocks per second of the whole card",
        fast,
        "1/s",
        "cocotb, per clock",
        slow,
        "at least 50 times",
        fast >= 50 * slow,
    )
