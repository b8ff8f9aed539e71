"""Runs: the reference by hand, the gateware against the reference."""

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from gateware.layouts import FrameSettings
from gateware.vision.lookahead import LOOKAHEAD, Lookahead
from gateware.vision.pixels import MeasuredPixel
from gateware.vision.runs import Run, Runs
from magtrak.reference import find_runs
from tests.support.simulation import simulate
from tests.support.vision import default_settings

SEED = 99
FIELDS = ("first", "last", "width", "sum", "peak", "clipped", "gated")
MORE = ("moment", "peak_first", "peak_last")


class Found(wiring.Component):
    """Lookahead and runs, as they stand in the card, without a filter."""

    settings: In(FrameSettings)
    i: In(stream.Signature(MeasuredPixel, always_ready=True))
    valid: Out(1)
    o: Out(Run())

    def elaborate(self, platform):
        m = Module()
        m.submodules.lookahead = ahead = Lookahead()
        m.submodules.runs = runs = Runs()
        m.d.comb += ahead.coming.eq(self.i.valid)
        m.d.sync += [ahead.i.valid.eq(self.i.valid), ahead.i.p.eq(self.i.p)]
        wiring.connect(m, ahead.o, runs.column)
        wiring.connect(m, runs.o, wiring.flipped(self.o))
        m.d.comb += [
            self.valid.eq(runs.valid),
            runs.before.eq(ahead.before),
            ahead.settings.eq(self.settings),
            runs.settings.eq(self.settings),
        ]
        return m


def reference_runs(weight, gate, saturated, settings) -> list[tuple[int, ...]]:
    runs = find_runs(weight, gate, saturated, settings)
    return [tuple(int(getattr(runs, name)[at]) for name in FIELDS + MORE) for at in range(runs.row.size)]


def gateware_runs(weight, gate, saturated, settings, gap: float) -> list[tuple[int, ...]]:
    dut = Found()
    rng = np.random.default_rng(SEED)
    found, last_clock = [], [-2]

    async def collect(ctx):
        clock = 0
        async for _, _, valid, *run in ctx.tick().sample(dut.valid, *(getattr(dut.o, name) for name in FIELDS + MORE)):
            clock += 1
            if valid:
                assert clock >= last_clock[0] + 2, "runs are at least two clocks apart"
                last_clock[0] = clock
                found.append(tuple(run))

    async def testbench(ctx):
        ctx.set(dut.settings, settings)
        rows, columns = weight.shape
        for row in range(rows):
            for column in range(columns):
                while rng.random() < gap:
                    await ctx.tick()
                pixel = {
                    "weight": int(weight[row, column]),
                    "gate": int(gate[row, column]),
                    "saturated": int(saturated[row, column]),
                    "row_first": column == 0,
                    "row_last": column == columns - 1,
                }
                ctx.set(dut.i.payload, pixel)
                ctx.set(dut.i.valid, 1)
                await ctx.tick()
                ctx.set(dut.i.valid, 0)
            await ctx.tick().repeat(LOOKAHEAD)
        await ctx.tick().repeat(Runs.latency + 2)

    simulate(dut, testbench, collect, clocks=100_000)
    return found


def row(text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A row of weights: digits are weights, a letter is a gated pixel of weight 1 (upper case: and saturated)."""
    weight = [int(c) if c.isdigit() else int(c.isalpha()) for c in text]
    image = np.array([weight], np.int32)
    return image, np.array([[c.isalpha() for c in text]]), np.array([[c.isupper() for c in text]])


@pytest.mark.parametrize(
    ("text", "changes", "expected"),
    [
        ("0000", {}, []),
        ("1", {}, [(0, 0, 1, 1, 1, 0, 0)]),
        ("0120", {}, [(1, 2, 2, 3, 2, 0, 0)]),
        ("1101", {}, [(0, 1, 2, 2, 1, 0, 0), (3, 3, 1, 1, 1, 0, 0)]),
        ("1101", {"run_bridge": 1}, [(0, 3, 4, 3, 1, 0, 0)]),
        ("11001", {"run_bridge": 1}, [(0, 1, 2, 2, 1, 0, 0), (4, 4, 1, 1, 1, 0, 0)]),
        ("5aB9", {"run_reach": 0}, [(0, 3, 4, 16, 9, 1, 2)]),
        ("a0100a", {"run_reach": 2}, [(0, 0, 1, 1, 1, 0, 1), (2, 2, 1, 1, 1, 0, 1), (5, 5, 1, 1, 1, 0, 1)]),
        ("a0100a", {"run_reach": 3}, [(0, 0, 1, 1, 1, 0, 1), (2, 2, 1, 1, 1, 0, 2), (5, 5, 1, 1, 1, 0, 1)]),
    ],
)
def test_by_hand(text, changes, expected):
    settings = default_settings(**{"run_reach": 0, **changes})
    found = reference_runs(*row(text), settings)
    assert [run[: len(FIELDS)] for run in found] == expected
    assert gateware_runs(*row(text), settings, 0) == found


@pytest.mark.parametrize(
    ("text", "moment", "first", "last"),
    [("5", 0, 0, 0), ("123", 1 * 2 + 2 * 1, 2, 2), ("0909", 9 * 2, 1, 3), ("39190", 3 * 3 + 9 * 2 + 1, 1, 3)],
)
def test_moment_and_greatest_by_hand(text, moment, first, last):
    """The moment is about the last lit column; gaps that are bridged count as columns, those behind it do not."""
    settings = default_settings(run_bridge=2)
    (run,) = reference_runs(*row(text), settings)
    assert run[len(FIELDS) :] == (moment, first, last)
    assert gateware_runs(*row(text), settings, 0) == [run]


def test_what_counts():
    weight, gate, saturated = row("1110a01100aab")
    for changes, expected in (
        ({"run_gated": 1}, [0, 1, 0, 1]),
        ({"run_gated": 2}, [0, 0, 0, 1]),
        ({"run_gated": 0, "run_width_min": 2}, [1, 0, 1, 1]),
        ({"run_gated": 0, "run_width_max": 2}, [0, 1, 1, 0]),
    ):
        runs = find_runs(weight, gate, saturated, default_settings(run_reach=0, **changes))
        assert runs.counts.tolist() == [bool(value) for value in expected]


@pytest.mark.parametrize("gap", [0.0, 0.4])
@pytest.mark.parametrize("density", [0.1, 0.5, 0.95])
def test_random(gap, density):
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    for columns in (1, 2, 3, 17, 40):
        shape = (10, columns)
        weight = np.where(rng.random(shape) < density, rng.integers(1, 256, shape), 0).astype(np.int32)
        gate, saturated = rng.random(shape) < 0.5, rng.random(shape) < 0.3
        settings = default_settings(run_reach=int(rng.integers(0, 16)), run_bridge=int(rng.integers(0, 4)))
        assert gateware_runs(weight, gate, saturated, settings, gap) == reference_runs(
            weight, gate, saturated, settings
        )


def test_longest_run():
    """2048 columns of full weight, all gated and saturated: no field overflows."""
    shape = (1, 2048)
    image = np.full(shape, 255, np.int32), np.ones(shape, bool), np.ones(shape, bool)
    settings = default_settings(run_reach=15, run_bridge=15)
    moment = 255 * 2047 * 2048 // 2
    assert gateware_runs(*image, settings, 0) == [(0, 2047, 2048, 2048 * 255, 255, 2048, 2048, moment, 0, 2047)]
