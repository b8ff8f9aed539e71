"""HLS with 16-bit multipliers and tables: each factor is exact, the gateware is the reference."""

import numpy as np

from gateware.vision.hls import OFFSET_BITS, SEXTANTS, hue_offset
from gateware.vision.hls16 import (
    FACTOR_BITS,
    HLS16,
    HUE_BITS,
    SATURATION_ADDED,
    SATURATION_BITS,
    factors,
    shift,
)
from magtrak.reference import hls
from tests.support.simulation import simulate

SEED = 78


def test_factors_are_exact():
    """Every difference and every span, and all numbers that they can divide."""
    hues, saturations = (np.array(table) for table in factors())
    assert max(hues.max(), saturations.max()) < 1 << FACTOR_BITS
    for divisor in range(1, 256):
        number = np.arange(divisor + 1)
        scaled = number << shift(divisor)
        assert scaled.max() < 256
        for start, offset in SEXTANTS:
            added = (start << OFFSET_BITS) + hue_offset(offset)
            got = ((scaled * hues[divisor] >> (HUE_BITS - OFFSET_BITS)) + added) >> OFFSET_BITS
            assert (got == start + (256 * number + offset * divisor) // (6 * divisor)).all(), (divisor, start)
        got = scaled * saturations[divisor] + SATURATION_ADDED >> SATURATION_BITS
        assert (got == (510 * number + divisor) // (2 * divisor)).all(), divisor
    assert not hues[0] and not saturations[0], "greys"


def test_gateware():
    """At corners, greys, near greys (small divisors), sums about 255 (where the span turns round), and at random."""
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    steps = np.array([0, 1, 2, 127, 128, 129, 253, 254, 255])
    corners = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    greys = np.repeat(np.arange(256)[:, None], 3, axis=1)
    near_greys = np.clip(rng.integers(0, 256, (2000, 1)) + rng.integers(-3, 4, (2000, 3)), 0, 255)
    least, middle = rng.integers(0, 128, 2000), rng.random(2000)
    greatest = 255 - least + rng.integers(-2, 3, 2000).clip(-np.inf, least).astype(int)
    turning = np.stack((greatest, least, (least + middle * (greatest - least)).astype(int)), axis=-1)
    turning = rng.permuted(turning, axis=1)
    colours = np.concatenate((corners, greys, near_greys, turning, rng.integers(0, 256, (5000, 3)))).astype(np.uint8)
    expected = np.stack(hls(colours))
    dut = HLS16()
    results = []

    async def testbench(ctx):
        for r, g, b in colours.tolist() + [[0, 0, 0]] * dut.latency:
            ctx.set(dut.r, r)
            ctx.set(dut.g, g)
            ctx.set(dut.b, b)
            _, _, *colour = await ctx.tick().sample(dut.hue, dut.luminance, dut.saturation)
            results.append(colour)

    simulate(dut, testbench, clocks=len(colours) + 100)
    for axis, late in enumerate((dut.latency, dut.luminance_latency, dut.latency)):
        got = [result[axis] for result in results[late : late + len(colours)]]
        np.testing.assert_array_equal(got, expected[axis])
