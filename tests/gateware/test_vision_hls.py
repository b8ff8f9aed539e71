"""RGB to HLS: the reference against ``colorsys``, the gateware against the reference."""

import colorsys

import numpy as np

from gateware.vision.hls import (
    HLS,
    HUE_BITS,
    OFFSET_BITS,
    SATURATION_BITS,
    SATURATIONS,
    SEXTANTS,
    factors,
    hue_offset,
    shift,
)
from magtrak.reference import hls
from tests.support.simulation import simulate

SEED = 77


def exact(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``colorsys.rgb_to_hls`` on arrays."""
    r, g, b = (rgb[..., axis] / 255.0 for axis in range(3))
    high, low = rgb.max(axis=-1) / 255.0, rgb.min(axis=-1) / 255.0
    light, delta = (high + low) / 2, high - low
    grey = delta == 0
    some = np.where(grey, 1, delta)
    saturation = delta / np.where(grey, 1, np.where(light <= 0.5, high + low, 2 - high - low))
    rc, gc, bc = (high - r) / some, (high - g) / some, (high - b) / some
    hue = np.where(r == high, bc - gc, np.where(g == high, 2 + rc - bc, 4 + gc - rc)) / 6 % 1.0
    return np.where(grey, 0, hue), light, np.where(grey, 0, saturation)


def test_exact_is_colorsys():
    print("seed", SEED)
    colours = np.random.default_rng(SEED).integers(0, 256, (2000, 3), dtype=np.uint8)
    for colour, *ours in zip(colours, *exact(colours), strict=True):
        np.testing.assert_allclose(ours, colorsys.rgb_to_hls(*(int(value) / 255 for value in colour)), atol=1e-12)


def test_reference_over_all_colours():
    """At most half a step off in each of 2**24 colours; what is half way is rounded up."""
    green, blue = np.meshgrid(np.arange(256), np.arange(256), indexing="ij")
    for red in range(256):
        rgb = np.stack((np.full_like(green, red), green, blue), axis=-1).astype(np.uint8)
        hue, luminance, saturation = hls(rgb)
        h, light, s = exact(rgb)
        turn = (hue - 256 * h + 128) % 256 - 128
        assert np.abs(turn).max() <= 0.5 + 1e-9
        assert np.abs(luminance - 255 * light).max() <= 0.5 + 1e-9
        assert (luminance - 255 * light).min() >= -0.5 + 1e-9
        assert np.abs(saturation - 255 * s).max() <= 0.5 + 1e-9
        assert (saturation - 255 * s).min() >= -0.5 + 1e-9
        grey = (rgb == rgb[..., :1]).all(axis=-1)
        assert not hue[grey].any() and not saturation[grey].any()


def test_reference_by_hand():
    colours = np.array(
        [(0, 0, 0), (255, 255, 255), (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0), (255, 0, 1), (1, 0, 0)],
        dtype=np.uint8,
    )
    hue, luminance, saturation = hls(colours)
    assert hue.tolist() == [0, 0, 0, 85, 171, 43, 0, 0]  # 255.83 of (255, 0, 1) closes the circle
    assert luminance.tolist() == [0, 255, 128, 128, 128, 128, 128, 1]
    assert saturation.tolist() == [0, 0, 255, 255, 255, 255, 255, 255]


def test_factors_are_exact():
    """Every difference and every sum, and all numbers that they can divide."""
    table = np.array(factors())
    for delta in range(1, 256):
        way = np.arange(delta + 1)
        product = (way << shift(delta)) * table[delta]
        for start, offset in SEXTANTS:
            exact = start + (256 * way + offset * delta) // (6 * delta)
            added = (start << OFFSET_BITS) + hue_offset(offset)
            assert (((product >> (HUE_BITS - OFFSET_BITS)) + added) >> OFFSET_BITS == exact).all(), (delta, start)
    for total in range(1, 510):
        span = min(total, 510 - total)
        delta = np.arange(span + 1)
        product = (delta << shift(span)) * table[SATURATIONS + total]
        rounded = (product >> SATURATION_BITS) + (product >> (SATURATION_BITS - 1) & 1)
        assert (rounded == (510 * delta + span) // (2 * span)).all(), total
    assert not table[0] and not table[SATURATIONS] and not table[SATURATIONS + 510], "greys"


def test_gateware():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    steps = np.array([0, 1, 2, 127, 128, 129, 253, 254, 255])
    corners = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    greys = np.repeat(np.arange(256)[:, None], 3, axis=1)
    near_greys = np.clip(rng.integers(0, 256, (4000, 1)) + rng.integers(-3, 4, (4000, 3)), 0, 255)
    colours = np.concatenate((corners, greys, near_greys, rng.integers(0, 256, (15500, 3)))).astype(np.uint8)
    assert len(colours) > 20_000
    expected = np.stack(hls(colours), axis=-1)
    dut = HLS()
    results = []

    async def testbench(ctx):
        for r, g, b in colours.tolist() + [[0, 0, 0]] * dut.latency:
            ctx.set(dut.r, r)
            ctx.set(dut.g, g)
            ctx.set(dut.b, b)
            _, _, colour = await ctx.tick().sample(dut.o)
            results.append((colour.hue, colour.luminance, colour.saturation))

    simulate(dut, testbench, clocks=len(colours) + 100)
    np.testing.assert_array_equal(results[dut.latency :], expected)
