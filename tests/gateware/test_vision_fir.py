"""The filter: the reference by hand and against theory, the gateware against the reference."""

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from gateware.arithmetic import Multiply
from gateware.vision.fir import Fir
from gateware.vision.lookahead import LOOKAHEAD, Lookahead
from gateware.vision.pixels import MeasuredPixel
from magtrak.reference import fir
from tests.support.simulation import simulate

SEED = 8


class Multipliers:
    """What a platform is that has multipliers, here those that the simulator knows."""

    def get_multiplier(self, multiply: Multiply) -> Module:
        return multiply.elaborate(None)


@pytest.fixture(params=[None, Multipliers()], ids=["plain", "multipliers"])
def platform(request, monkeypatch):
    elaborate = Fir.elaborate
    monkeypatch.setattr(Fir, "elaborate", lambda self, _: elaborate(self, request.param))


class Filtered(wiring.Component):
    """Lookahead and filter, as they stand in the card."""

    i: In(stream.Signature(MeasuredPixel, always_ready=True))
    column: Out(12)
    valid: Out(1)
    falls: Out(1)
    distance: Out(12)
    rise: Out(16)
    contrast: Out(16)

    def elaborate(self, platform):
        m = Module()
        m.submodules.lookahead = ahead = Lookahead()
        m.submodules.fir = block = Fir()
        m.d.comb += ahead.coming.eq(self.i.valid)
        m.d.sync += [ahead.i.valid.eq(self.i.valid), ahead.i.p.eq(self.i.p)]
        m.d.comb += [
            block.step.eq(ahead.step),
            block.mix.eq(ahead.mix),
            block.row_first.eq(ahead.row_first),
            self.column.eq(ahead.o.p.column),
            self.valid.eq(ahead.o.valid),
        ]
        for name in ("falls", "distance", "rise", "contrast"):
            m.d.comb += getattr(self, name).eq(getattr(block, name))
        return m


def gateware_crossings(image: np.ndarray, gap: float) -> list[tuple[int, ...]]:
    dut = Filtered()
    rng = np.random.default_rng(SEED)
    found, seen = [], []

    async def collect(ctx):
        async for _, _, valid, falls, column, *rest in ctx.tick().sample(
            dut.valid, dut.falls, dut.column, dut.distance, dut.rise, dut.contrast
        ):
            if valid:
                seen.append(column)
                if falls:
                    distance, *rest = rest
                    row = (len(seen) - 1) // image.shape[1]
                    found.append((row, column - distance, column, *rest))

    async def testbench(ctx):
        for row in image:
            for column, value in enumerate(row):
                while rng.random() < gap:
                    await ctx.tick()
                pixel = {"mix": int(value), "row_first": column == 0, "row_last": column == len(row) - 1}
                ctx.set(dut.i.payload, pixel)
                ctx.set(dut.i.valid, 1)
                await ctx.tick()
                ctx.set(dut.i.valid, 0)
            await ctx.tick().repeat(LOOKAHEAD)
        await ctx.tick().repeat(4)

    simulate(dut, testbench, collect, clocks=60_000)
    assert seen == list(range(image.shape[1])) * len(image)
    return found


def stripe(columns: int, centre, amplitude: float = 180, sigma: float = 1.5, base: float = 20) -> np.ndarray:
    x = np.arange(columns)
    return base + amplitude * np.exp(-((x - np.asarray(centre)[..., None]) ** 2) / (2 * sigma**2))


def image_of_all_kinds(rng, rows: int, columns: int) -> np.ndarray:
    image = rng.integers(0, 256, (rows, columns))
    for row in range(0, rows, 3):
        lines = stripe(columns, rng.uniform(-2, columns + 1), rng.integers(50, 900), rng.uniform(0.4, 6))
        image[row] = np.clip(lines + rng.integers(0, 3, columns), 0, 255)
    for row in range(1, rows, 3):  # steps and plateaus: derivatives that are exactly 0
        image[row] = np.repeat(rng.integers(0, 256, columns), rng.integers(1, 24, columns))[:columns]
    return image.astype(np.int32)


@pytest.mark.usefixtures("platform")
@pytest.mark.parametrize("gap", [0.0, 0.5])
def test_gateware(gap):
    print("seed", SEED)
    image = image_of_all_kinds(np.random.default_rng(SEED), 36, 61)
    image[0], image[-1] = 255, 0
    image[3, :30], image[3, 30:] = 0, 255  # the greatest derivative
    image[4, :30], image[4, 30:] = 255, 0
    found = fir.crossings(image)
    columns = (found.row, found.before, found.after, found.rise, found.contrast)
    expected = [tuple(int(value) for value in item) for item in zip(*columns, strict=True)]
    assert len(expected) > 60
    assert gateware_crossings(image, gap) == expected


@pytest.mark.parametrize("columns", [1, 2, 7, 16])
def test_short_rows(columns):
    image = np.random.default_rng(SEED).integers(0, 256, (12, columns)).astype(np.int32)
    found = fir.crossings(image)
    assert [item[:3] for item in gateware_crossings(image, 0)] == [
        (int(row), int(before), int(after))
        for row, before, after in zip(found.row, found.before, found.after, strict=True)
    ]


def test_derivative_by_hand():
    row = np.zeros((1, 31), np.int32)
    row[0, 15] = 1
    falling = [-tap for tap in fir.TAPS]
    assert fir.derivative(row)[0, 8:23].tolist() == [*reversed(fir.TAPS), 0, *falling]


def test_bound_is_tight():
    step = np.zeros((1, 60), np.int32)
    step[0, 30:] = 255
    assert fir.derivative(step).max() == fir.DERIVATIVE_MAX


def position_of(row: np.ndarray) -> float:
    found = fir.crossings(row[None].astype(np.int32))
    best = int(found.contrast.argmax())
    return float(fir.position(found)[best]) / 256


def test_plateaus_and_single_zeros():
    row = np.zeros(64)
    row[20:23] = 100
    assert position_of(row) == 21
    row = np.zeros(64)
    row[20:41] = 100
    assert position_of(row) == 30
    row = np.zeros(64)
    row[20:40] = 100
    assert position_of(row) == 29.5


@pytest.mark.parametrize(
    ("sigma", "noise", "limit"), [(1.5, 0, 0.003), (3, 0, 0.005), (1.5, 2, 0.0175), (3, 2, 0.024), (1.5, 5, 0.042)]
)
def test_accuracy(sigma, noise, limit):
    """RMS error in px over stripes at all sub-pixel places; the Cramer-Rao bound is 0.0144 at sigma 1.5, noise 2."""
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    centres = 32 + rng.uniform(-0.5, 0.5, 4000)
    image = np.clip(np.round(stripe(64, centres, sigma=sigma) + rng.normal(0, noise, (4000, 64))), 0, 255)
    found = fir.crossings(image.astype(np.int32))
    order = np.lexsort((-found.contrast, found.row))
    rows, at = np.unique(found.row[order], return_index=True)
    assert rows.size == 4000
    error = fir.position(found)[order[at]] / 256 - centres
    rms = float(np.sqrt(np.mean(error**2)))
    print(f"sigma {sigma} noise {noise}: {rms:.4f} px RMS, bias {error.mean():+.4f} px")
    assert rms <= limit
    assert abs(error.mean()) <= 0.003
