"""Backgrounds through the whole vision, against the reference."""

import numpy as np
import pytest

from gateware.features import Features
from gateware.vision.background import Background
from gateware.vision.vision import Vision
from magtrak.protocol import AmbientMode
from magtrak.reference import ROW_DTYPE, BackgroundStore, measure, mix
from magtrak.reference import Background as Blocks
from tests.support.simulation import simulate
from tests.support.vision import (
    FRAME_GAP,
    default_settings,
    load_luts,
    random_image,
    random_luts,
    random_settings,
    send_image,
)

SEED = 5
CELLS = 256


def run(steps, *, gap: float = 0.0):
    """Records of each image of (image, take, settings or None, luts) each: the settings change with it."""
    dut = Vision(Features(64, 64, CELLS))
    records, subtracted = [[]], []

    async def collect(ctx):
        async for _, _, valid, payload, end in ctx.tick().sample(
            dut.rows.row.valid, dut.rows.row.p, dut.rows.frame_end
        ):
            if valid:
                records[-1].append(tuple(payload.record[name] for name in ROW_DTYPE.names))
            if end:
                records.append([])

    async def testbench(ctx):
        rng = np.random.default_rng(SEED)
        for image, take, settings, luts in steps:
            if settings is not None:
                await load_luts(ctx, dut.lut, luts)
                ctx.set(dut.settings, settings)
            ctx.set(dut.background, take)
            await send_image(ctx, dut.video, image, gap=gap, rng=rng)
            subtracted.append(bool(ctx.get(dut.subtracted)))
            if ctx.get(dut.settings.isolate):
                await ctx.tick().repeat(image.shape[1])
        await ctx.tick().repeat(dut.latency + 32)

    simulate(dut, testbench, collect, clocks=400_000)
    assert records.pop() == []
    return [np.array(rows, dtype=ROW_DTYPE) for rows in records], subtracted


def check(steps, **options):
    """Compares all images with the reference; tells which had something subtracted, in blocks of which shift."""
    records, subtracted = run(steps, **options)
    store = BackgroundStore(CELLS)
    shifts = []
    now = None
    assert len(records) == len(steps)
    for number, (got, (image, take, settings, luts)) in enumerate(zip(records, steps, strict=True)):
        if settings is not None:
            now = (settings, luts)
            store.settings_change()
        used = store.background if now[0]["ambient_mode"] != AmbientMode.OFF and not take else None
        assert subtracted[number] == (used is not None), f"image {number}"
        shifts.append(None if used is None else used.shift)
        expected = measure(image, *now, used)
        for row, (a, b) in enumerate(zip(got, expected, strict=True)):
            wrong = {name: (int(a[name]), int(b[name])) for name in ROW_DTYPE.names if a[name] != b[name]}
            assert not wrong, f"image {number}, row {row}: {wrong}"
        store.push(mix(image, now[0]), take=take)
    return shifts


def noise(rng, rows, columns):
    return rng.integers(0, 120, (rows, columns, 3)).astype(np.uint8)


ALL = np.ones((3, 256), bool)
ON = default_settings(ambient_mode=AmbientMode.ALTERNATE)


def test_blocks_by_hand():
    mixed = np.array([[1, 5, 2], [3, 4, 9], [7, 0, 6]], np.int32)
    assert Blocks.of(mixed, 1).cells.tolist() == [[5, 9], [7, 6]]
    assert Blocks.of(mixed, 1).spread(3, 3).tolist() == [[5, 5, 9], [5, 5, 9], [7, 7, 6]]
    assert Blocks.of(mixed, 0).cells.tolist() == mixed.tolist()


@pytest.mark.parametrize(
    ("rows", "columns", "shift", "gap"),
    [(4, 64, 0, 0.0), (5, 52, 1, 0.3), (16, 17, 1, 0.0), (35, 34, 2, 0.0), (1, 33, 0, 0.3)],
)
def test_blocks_are_as_fine_as_fits(rows, columns, shift, gap):
    """Learning size and shift takes an image each; borders that fill no block are right as well."""
    rng = np.random.default_rng(SEED)
    lit, dark = random_image(rng, rows, columns), noise(rng, rows, columns)
    steps = [(lit, False, ON, ALL), *[(dark, True, None, None), (lit, False, None, None)] * 2]
    assert check(steps, gap=gap)[-1] == shift


def test_random():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    steps = []
    for _ in range(5):
        rows, columns = int(rng.integers(1, 14)), int(rng.integers(32, 65))
        settings = random_settings(rng, columns, rows) | {"ambient_mode": int(rng.integers(1, 3))}
        steps.append((random_image(rng, rows, columns), False, settings, random_luts(rng)))
        for _ in range(5):
            take = bool(rng.random() < 0.6)
            image = noise(rng, rows, columns) if take else random_image(rng, rows, columns)
            steps.append((image, take, None, None))
    shifts = check(steps)
    assert {0, 1} <= set(shifts)


def test_settings_and_sizes_make_a_background_useless():
    rng = np.random.default_rng(SEED)
    small, large = random_image(rng, 3, 40), random_image(rng, 4, 60)
    keep = (None, None)
    steps = [
        (small, False, ON, ALL),
        (small, True, *keep),
        (small, False, *keep),  # subtracted
        (small, False, ON | {"floor": 3}, ALL),  # new settings
        (small, True, *keep),
        (small, False, *keep),  # subtracted
        (large, False, *keep),  # another size, which is known at the end only: as before
        (large, False, *keep),
        (large, True, *keep),
        (large, False, *keep),  # subtracted
        (large, False, ON | {"ambient_mode": 0}, ALL),
        (large, True, *keep),
        (large, False, *keep),  # off
    ]
    _, subtracted = run(steps)
    assert [number for number, some in enumerate(subtracted) if some] == [2, 5, 6, 9]


def test_capacity_that_cannot_be_is_refused():
    for cells in (255, 2048 * 2048 + 1):
        with pytest.raises(ValueError, match=f"is {cells};"):
            Background(cells)


def test_broken_images():
    """A background that broke the camera's contract is not used; another image that did changes nothing."""
    dut = Vision(Features(64, 64, CELLS))
    image = random_image(np.random.default_rng(SEED), 3, 50)
    seen = []

    async def testbench(ctx):
        ctx.set(dut.settings, ON)
        await load_luts(ctx, dut.lut, ALL)
        for name in ("good", "GOOD", "good", "bad", "good", "BAD", "good", "GOOD", "good"):
            ctx.set(dut.background, name.isupper())
            await send_image(ctx, dut.video, image, blanking=16 if name.lower() == "good" else 9)
            seen.append(ctx.get(dut.subtracted))

    simulate(dut, testbench)
    assert seen == [0, 0, 1, 1, 1, 0, 0, 0, 1]


def test_next_image_too_early():
    """Where the next image cuts off the background's end, the background is not used."""
    dut = Vision(Features(64, 64, CELLS))
    image = random_image(np.random.default_rng(SEED), 3, 40)
    seen = []

    async def show(ctx, take, rows):
        ctx.set(dut.background, take)
        await send_image(ctx, dut.video, image[:rows])
        seen.append(ctx.get(dut.subtracted))

    async def testbench(ctx):
        ctx.set(dut.settings, ON)
        await load_luts(ctx, dut.lut, ALL)
        await show(ctx, 0, 3)
        await show(ctx, 1, 3)
        await show(ctx, 0, 3)
        assert FRAME_GAP > 8
        ctx.set(dut.background, 1)
        for clock in range(40):  # one row, then the next image at once
            ctx.set(dut.video.pixel.p, {"r": 9, "row_first": clock == 0, "frame_first": clock == 0})
            ctx.set(dut.video.pixel.valid, 1)
            await ctx.tick()
        await show(ctx, 0, 3)
        await show(ctx, 0, 3)

    simulate(dut, testbench)
    assert seen == [0, 0, 1, 0, 0]
