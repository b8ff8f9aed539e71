"""The whole vision against its reference."""

import numpy as np
import pytest

from gateware.vision.vision import Vision
from magtrak.protocol import CAMERA_ERRORS
from magtrak.reference import ROW_DTYPE
from tests.support.simulation import simulate
from tests.support.vision import load_luts, random_image, random_luts, random_settings, send_image

SEED = 20240611


def run(frames, *, gap: float = 0.0, seed: int = SEED):
    """Records (frames of rows), and (errors, rows, columns) per frame, of (image, settings, luts) each."""
    dut = Vision(max_columns=64, max_rows=64)
    records, reports = [[]], []

    async def collect(ctx):
        async for _, _, valid, payload, end, errors, rows, columns in ctx.tick().sample(
            dut.rows.row.valid, dut.rows.row.p, dut.rows.frame_end, dut.errors, dut.image_rows, dut.image_columns
        ):
            if valid:
                assert payload.row == len(records[-1])
                records[-1].append(tuple(payload.record[name] for name in ROW_DTYPE.names))
            if end:
                records.append([])
                named = {field.name: errors[field.name] for field in CAMERA_ERRORS.fields if not field.reserved}
                reports.append((named, rows, columns))

    async def testbench(ctx):
        rng = np.random.default_rng(seed)
        for image, settings, luts in frames:
            await load_luts(ctx, dut.lut, luts)
            ctx.set(dut.settings, settings)
            await send_image(ctx, dut.video, image, gap=gap, rng=rng)
        await ctx.tick().repeat(dut.latency + 32)

    simulate(dut, testbench, collect, clocks=200_000)
    assert records.pop() == []
    return [np.array(rows, dtype=ROW_DTYPE) for rows in records], reports


def check(frames, **options):
    records, reports = run(frames, **options)
    assert len(records) == len(frames)
    for got, (errors, rows, columns), (image, settings, luts) in zip(records, reports, frames, strict=True):
        assert not any(errors.values()), errors
        assert (rows, columns) == image.shape[:2]
        expected = Vision.reference(image, settings, luts)
        for row, (a, b) in enumerate(zip(got, expected, strict=True)):
            wrong = {name: (int(a[name]), int(b[name])) for name in ROW_DTYPE.names if a[name] != b[name]}
            assert not wrong, f"row {row} with {settings}: {wrong}"
    return records


@pytest.mark.parametrize("gap", [0.0, 0.3])
def test_random(gap):
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    frames = []
    for _ in range(60):
        rows, columns = int(rng.integers(1, 8)), int(rng.integers(32, 65))
        frames.append((random_image(rng, rows, columns), random_settings(rng, columns, rows), random_luts(rng)))
    check(frames, gap=gap)
