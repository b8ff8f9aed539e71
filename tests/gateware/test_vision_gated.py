"""The vision of a small card against the reference, in which nothing is lit then."""

import numpy as np
import pytest

from gateware.features import Features
from gateware.vision.gated import GatedVision
from magtrak.protocol import CAMERA_ERRORS, Detector
from magtrak.reference import ROW_DTYPE
from tests.gateware.test_vision_block_gate import swap, write
from tests.support.simulation import simulate
from tests.support.vision import default_settings, random_image, random_luts, random_settings, send_image

SEED = 20240612
SMALL = Features(64, 64, 0, isolate=False, window=False, runs=False, snapshot=False)
ALL = np.ones((3, 256), bool)
FIXED = {"detector": Detector.BINARY, "floor": 255, "isolate": 0}


class Camera:
    """Sends images to a vision, and keeps what it says."""

    def __init__(self, features: Features = SMALL) -> None:
        self.dut = GatedVision(features)
        self.records: list[list[tuple]] = [[]]
        self.reports: list[tuple[dict, int, int]] = []
        self.delays: list[int] = []
        self.clock = self.last = 0

    def run(self, testbench, clocks: int = 200_000) -> None:
        async def finish(ctx):
            await testbench(ctx)
            await ctx.tick().repeat(2 * self.dut.latency + 8)

        simulate(self.dut, finish, self._collect, clocks=clocks)
        assert self.records.pop() == []

    async def _collect(self, ctx):
        dut, pixel = self.dut, self.dut.video.pixel
        async for _, _, last, valid, payload, end, errors, rows, columns in ctx.tick().sample(
            pixel.valid & pixel.p.row_last,
            *(dut.rows.row.valid, dut.rows.row.p, dut.rows.frame_end, dut.errors, dut.image_rows, dut.image_columns),
        ):
            self.clock += 1
            assert not (valid and end)
            if valid:
                assert payload.row == len(self.records[-1])
                self.records[-1].append(tuple(payload.record[name] for name in ROW_DTYPE.names))
                self.delays.append(self.clock - self.last)
            if last:
                self.last = self.clock
            if end:
                self.records.append([])
                named = {field.name: errors[field.name] for field in CAMERA_ERRORS.fields if not field.reserved}
                self.reports.append((named, rows, columns))


def check(frames, *, gap: float = 0.0, features: Features = SMALL):
    """Images (image, settings, luts), of which nothing but the gate and the places count."""
    camera = Camera(features)

    async def testbench(ctx):
        rng = np.random.default_rng(SEED)
        for image, settings, luts in frames:
            await write(ctx, camera.dut, luts)
            await swap(ctx, camera.dut)
            ctx.set(camera.dut.settings, settings)
            await send_image(ctx, camera.dut.video, image, gap=gap, rng=rng)

    camera.run(testbench)
    records = [np.array(rows, dtype=ROW_DTYPE) for rows in camera.records]
    assert len(records) == len(frames)
    for got, (errors, rows, columns), (image, settings, luts) in zip(records, camera.reports, frames, strict=True):
        assert not any(errors.values()), errors
        assert (rows, columns) == image.shape[:2]
        expected = GatedVision.reference(image, settings | FIXED, luts)
        for row, (a, b) in enumerate(zip(got, expected, strict=True)):
            wrong = {name: (int(a[name]), int(b[name])) for name in ROW_DTYPE.names if a[name] != b[name]}
            assert not wrong, f"row {row} with {settings}: {wrong}"
    return records, camera


@pytest.mark.parametrize("gap", [0.0, 0.3])
def test_random(gap):
    """Whatever detector, floor, weights and runs are set to."""
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    frames = []
    for _ in range(40):
        rows, columns = int(rng.integers(1, 8)), int(rng.integers(32, 65))
        luts = random_luts(rng, rng.choice([0.4, 0.7, 0.9]))
        settings = random_settings(rng, columns, rows) | {"run_width_max": int(rng.integers(1, columns + 2))}
        frames.append((random_image(rng, rows, columns), settings, luts))
    records, camera = check(frames, gap=gap)
    everything = np.concatenate(records)
    for name in ("valid", "cut", "ambiguous"):
        assert 0.02 < everything[name].mean() < 0.98, f"{name} is always the same"
    assert set(camera.delays) == {camera.dut.latency}


def row_of(columns: int, *lit: int) -> np.ndarray:
    image = np.zeros((1, columns, 3), np.uint8)
    image[0, list(lit)] = (0, 200, 0)
    return image


GREEN = np.ones((3, 256), bool)
GREEN[0, 0] = False  # the hue of greys


@pytest.mark.parametrize(
    ("lit", "changes", "expected"),
    [
        ((10,), {}, {"valid": 1, "position": 10 << 8, "width": 1, "gated": 1}),
        ((10, 11), {}, {"valid": 1, "position": 10 << 8 | 128, "width": 2, "gated": 2}),
        ((10, 11, 13), {}, {"valid": 1, "position": round(256 * 34 / 3), "width": 4, "gated": 3}),
        ((0, 4), {}, {"valid": 1, "position": 2 << 8, "cut": 1, "width": 5, "gated": 2}),
        ((47,), {}, {"valid": 1, "position": 47 << 8, "cut": 1, "width": 1, "gated": 1}),
        ((10, 30), {"run_width_max": 20}, {"valid": 1, "position": 20 << 8, "ambiguous": 1, "width": 21, "gated": 2}),
        ((10, 30), {"run_width_max": 21}, {"valid": 1, "position": 20 << 8, "width": 21, "gated": 2}),
        ((10, 30), {"run_gated": 3}, {}),
        ((10, 30), {"run_gated": 2}, {"valid": 1, "position": 20 << 8, "width": 21, "gated": 2}),
        ((), {"run_gated": 0}, {}),
        ((9, 10, 30, 31), {"column_first": 10}, {"valid": 1, "position": 6059, "cut": 1, "width": 22, "gated": 3}),
        ((9, 10, 30, 31), {"column_last": 30}, {"valid": 1, "position": 4181, "cut": 1, "width": 22, "gated": 3}),
        ((9, 10), {"column_first": 10, "column_last": 10}, {"valid": 1, "position": 2560, "cut": 1, "width": 1}),
        ((9, 10), {"column_first": 10, "column_last": 9}, {}),
        ((9, 10), {"row_first": 1}, {}),
        ((9, 10), {"row_first": 0, "row_last": 0}, {"valid": 1, "position": 9 << 8 | 128, "width": 2, "gated": 2}),
    ],
)
def test_by_hand(lit, changes, expected):
    ((record,), _) = check([(row_of(48, *lit), default_settings(**changes), GREEN)])
    told = {name: int(record[name][0]) for name in ROW_DTYPE.names if record[name][0]}
    assert told | {"gated": told.get("gated", 0)} == {"gated": told.get("gated", 0)} | expected


def test_the_widest_row():
    """Every pixel of 2048 gated: the greatest sums."""
    features = Features(2048, 2, 0, isolate=False, window=False, runs=False, snapshot=False)
    image = np.full((1, 2048, 3), (0, 200, 0), np.uint8)
    ((record,), _) = check([(image, default_settings(), GREEN)], features=features)
    assert record["position"][0] == 1023 << 8 | 128
    assert record["gated"][0] == record["width"][0] == 2048


def test_every_image_has_its_rows_and_its_end_however_broken():
    """Pixels of a camera that keeps no contract: what comes out is counted as what the monitor says, and flagged."""
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    camera = Camera()

    async def testbench(ctx):
        await write(ctx, camera.dut, ALL)
        await swap(ctx, camera.dut)
        ctx.set(camera.dut.settings, default_settings())
        pixel = camera.dut.video.pixel
        for clocks in range(20_000):
            # The stage before lets no image begin within 112 clocks of the one before.
            first = clocks % 700 == 0
            ctx.set(pixel.valid, first or rng.random() < 0.8)
            flags = {"r": 0, "g": 200, "b": 0, "frame_first": first, "row_last": rng.random() < 0.06}
            ctx.set(pixel.p, flags | {"row_first": first or rng.random() < 0.06})
            ctx.set(camera.dut.video.frame_end, not first and rng.random() < 0.0005)
            await ctx.tick()
        ctx.set(pixel.valid, 0)
        ctx.set(camera.dut.video.frame_end, 1)
        await ctx.tick()
        ctx.set(camera.dut.video.frame_end, 0)

    camera.run(testbench)
    assert len(camera.reports) > 25
    for rows, (errors, told, _) in zip(camera.records, camera.reports, strict=True):
        assert len(rows) == told
        assert any(errors.values())
    flagged = np.concatenate([np.array(rows, dtype=ROW_DTYPE) for rows in camera.records])
    assert flagged["overflow"].mean() > 0.3


def test_a_row_that_ends_during_the_division_is_only_told():
    """A row of 40 pixels, and as soon as may be one of a single pixel: shorter than a division."""
    camera = Camera()

    async def testbench(ctx):
        await write(ctx, camera.dut, ALL)
        await swap(ctx, camera.dut)
        ctx.set(camera.dut.settings, default_settings())
        for row, columns in enumerate((40, 1)):
            await send_image_row(ctx, camera.dut.video, columns, row)
            await ctx.tick().repeat(15)
        await ctx.tick().repeat(64)

    camera.run(testbench)
    ((errors, rows, columns),) = camera.reports
    first, second = (dict(zip(ROW_DTYPE.names, record, strict=True)) for record in camera.records[0])
    assert (rows, columns) == (2, 40)
    assert errors["row_length"]
    assert (first["valid"], first["gated"], first["overflow"]) == (1, 40, 0)
    assert second == dict.fromkeys(ROW_DTYPE.names, 0) | {"overflow": 1}


async def send_image_row(ctx, video, columns: int, row: int) -> None:
    for column in range(columns):
        first, last = column == 0, column == columns - 1
        flags = {"row_first": first, "row_last": last, "frame_first": first and row == 0}
        ctx.set(video.pixel.p, {"r": 0, "g": 200, "b": 0, **flags})
        ctx.set(video.pixel.valid, 1)
        ctx.set(video.frame_end, last and row == 1)
        await ctx.tick()
    ctx.set(video.pixel.valid, 0)
    ctx.set(video.frame_end, 0)


def test_settings_that_come_too_early_flag_the_record_that_is_not_there_yet():
    """The next image begins 20 clocks after the last pixel."""
    camera = Camera()

    async def testbench(ctx):
        await write(ctx, camera.dut, ALL)
        await swap(ctx, camera.dut)
        ctx.set(camera.dut.settings, default_settings())
        for _ in range(2):
            await send_image_row(ctx, camera.dut.video, 40, 0)
            ctx.set(camera.dut.video.frame_end, 1)
            await ctx.tick()
            ctx.set(camera.dut.video.frame_end, 0)
            await ctx.tick().repeat(19)
        await ctx.tick().repeat(100)

    camera.run(testbench)
    ((first,), (second,)) = camera.records
    overflow = ROW_DTYPE.names.index("overflow")
    assert (first[overflow], second[overflow]) == (1, 0)
