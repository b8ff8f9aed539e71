"""The whole vision against its reference."""

import numpy as np
import pytest

from gateware.features import Features
from gateware.vision.vision import Vision
from magtrak.protocol import CAMERA_ERRORS, AmbientMode, Choice, Detector, Window
from magtrak.reference import ROW_DTYPE
from tests.support.simulation import simulate
from tests.support.vision import (
    BLANKING,
    default_settings,
    load_luts,
    random_image,
    random_luts,
    random_settings,
    send_image,
)

SEED = 20240611
SMALL = Features(64, 64)


def run(frames, *, gap: float = 0.0, seed: int = SEED, features: Features = SMALL):
    """Records (frames of rows), and (errors, rows, columns) per frame, of (image, settings, luts) each."""
    dut = Vision(features)
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
            if settings["isolate"]:
                await ctx.tick().repeat(image.shape[1])
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
    for _ in range(40):
        rows, columns = int(rng.integers(1, 8)), int(rng.integers(32, 65))
        frames.append((random_image(rng, rows, columns), random_settings(rng, columns, rows), random_luts(rng)))
    check(frames, gap=gap)


@pytest.mark.parametrize("kept", [None, "isolate", "window"])
def test_built_without(kept):
    """What is not built is not done, whatever the settings say; the rest is as ever."""
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    options = {name: name == kept for name in ("isolate", "window")}
    frames, expected = [], []
    for _ in range(15):
        rows, columns = int(rng.integers(1, 6)), int(rng.integers(32, 65))
        settings = random_settings(rng, columns, rows) | {"ambient_mode": AmbientMode.ALTERNATE}
        done = settings if kept == "isolate" else settings | {"isolate": 0}
        done |= {} if kept == "window" else {"centroid_window": Window.RUN}
        frames.append((random_image(rng, rows, columns), settings, random_luts(rng)))
        expected.append(Vision.reference(frames[-1][0], done, frames[-1][2]).tolist())
    records, _ = run(frames, features=Features(64, 64, 0, **options))
    assert [record.tolist() for record in records] == expected


def line_image(rows: int, columns: int, centres, amplitude: float = 180, sigma: float = 1.5) -> np.ndarray:
    """A red line on black; a white core where it is over-exposed."""
    x = np.arange(columns)
    light = amplitude * np.exp(-((x - np.asarray(centres, float)[:, None]) ** 2) / (2 * sigma**2))
    return np.clip(light[..., None] * [1.0, 0.15, 0.1], 0, 255).astype(np.uint8).reshape(rows, columns, 3)


ALL = np.ones((3, 256), bool)
RED = np.zeros((3, 256), bool)
RED[0, :12] = RED[0, 244:] = RED[1, 10:] = RED[2, 60:] = True


def test_line_at_every_column():
    """Within the borders to 0.02 px; at them flagged."""
    columns = 48
    centres = np.linspace(-2, columns + 1, 37)
    image = line_image(37, columns, centres)
    for detector in Detector:
        (record,) = check([(image, default_settings(detector=detector), RED)])
        inner = (centres > 9) & (centres < columns - 10)
        assert record["valid"][inner].all() and not record["cut"][inner].any() and not record["ambiguous"].any()
        limit = {Detector.FIR: 0.02, Detector.CENTROID: 0.02}.get(detector, 0.6)
        np.testing.assert_allclose(record["position"][inner] / 256, centres[inner], atol=limit)
        outer = (centres < 2) | (centres > columns - 3)
        assert record["cut"][outer & (record["valid"] == 1)].all()


def test_white_core():
    """Over-exposed eight times: the colour is left in the rim only, and still finds the run."""
    centres = np.linspace(20, 28, 16)
    image = line_image(16, 48, centres, amplitude=1440)
    (record,) = check([(image, default_settings(), RED)])
    assert record["valid"].all() and record["saturated"].all() and not record["ambiguous"].any()
    np.testing.assert_allclose(record["position"] / 256, centres, atol=0.1)


def test_flat_images():
    shape = (2, 40, 3)
    white, black = np.full(shape, 255, np.uint8), np.zeros(shape, np.uint8)
    grey = np.full(shape, 100, np.uint8)
    settings = [default_settings(detector=detector, run_bridge=15) for detector in Detector]
    frames = [(image, values, ALL) for image in (white, black, grey) for values in settings]
    records = check(frames)
    for (image, values, _), record in zip(frames, records, strict=True):
        if image is black:  # the binary detector asks for colour only
            assert record["valid"].all() == (values["detector"] == Detector.BINARY)
        else:
            assert record["valid"].all() and record["cut"].all()
            assert (record["position"] == int(19.5 * 256)).all() and (record["width"] == 40).all()


def test_two_lines_are_ambiguous():
    one, two = (line_image(1, 64, [centre], amplitude) for centre, amplitude in ((20, 180), (44, 100)))
    for ratio, ambiguous in ((255, 0), (64, 1)):
        (record,) = check([(np.maximum(one, two), default_settings(ambiguous_ratio=ratio), RED)])
        assert record["second_valid"][0] and record["ambiguous"][0] == ambiguous
        assert abs(record["position"][0] / 256 - 20) < 0.02
        assert abs(record["second_position"][0] / 256 - 44) <= 0.5


def test_choices():
    """A thin bright line, a wide one, a thin faint one; the row above it had its line near the third."""
    image = np.zeros((2, 96, 3), np.uint8)
    image[0] = line_image(1, 96, [70])[0]
    for centre, amplitude, sigma in ((20, 200, 1.2), (45, 150, 4), (75, 120, 1.2)):
        image[1] = np.maximum(image[1], line_image(1, 96, [centre], amplitude, sigma)[0])
    expected = {Choice.STRONGEST: 20, Choice.FIRST: 20, Choice.LAST: 75, Choice.WIDEST: 45, Choice.NEAREST: 75}
    for choice, column in expected.items():
        (record,) = check([(image, default_settings(choice=choice), ALL)], features=Features(96, 64))
        assert abs(record["position"][1] / 256 - column) < 0.1, choice
        rival = max((c for c in (20, 45, 75) if c != column), key={20: 3, 45: 1, 75: 2}.get)
        assert abs(record["second_position"][1] / 256 - rival) < 0.1, choice
        assert (record["runner_up"][1] == 255) == (column != 20), "a stronger one was not chosen"


def test_nearest_begins_anew_with_each_image():
    pair = np.maximum(line_image(1, 64, [20], 150), line_image(1, 64, [44], 200))
    image = np.concatenate((line_image(1, 64, [20]), np.zeros((1, 64, 3), np.uint8), pair))
    settings = default_settings(choice=Choice.NEAREST)
    first, second = check([(image, settings, ALL), (pair, settings, ALL)])
    assert abs(first["position"][2] / 256 - 20) < 0.1, "the last row that had a line counts"
    assert abs(second["position"][0] / 256 - 44) < 0.1, "the first row of an image takes the strongest"


def test_window_by_hand():
    """Ends at 10, a triangle of 20, 60, 20 above that about column 20, another bright pixel inside the window."""
    image = np.full((1, 64, 3), 10, np.uint8)
    image[0, 19:22] = np.array([30, 70, 30])[:, None]
    image[0, 23] = 40
    settings = {"detector": Detector.CENTROID, "floor": 15, "centroid_window": Window.HALF_7}
    settings |= {"column_first": 8, "column_last": 34}  # all of it has the colour
    for base, weights in ((0, {19: 20, 20: 60, 21: 20, 23: 30}), (4, {19: 7, 20: 47, 21: 7, 23: 17})):
        # 55, the run's greatest weight, times 4 / 16 is 13.
        (record,) = check([(image, default_settings(**settings, centroid_base=base, ambiguous_ratio=255), ALL)])
        mean = sum(column * weight for column, weight in weights.items()) / sum(weights.values())
        assert abs(record["position"][0] / 256 - mean) <= 1 / 256
        assert record["valid"][0] and not record["cut"][0] and not record["ambiguous"][0]
    dim = default_settings(**settings | {"floor": 0}, centroid_base=15)
    (record,) = check([(np.full((1, 64, 3), 10, np.uint8), dim, ALL)])
    assert record["ambiguous"][0] and record["cut"][0], "nothing rises above the base of a flat row"


def test_centroid_of_the_run_and_maximum_by_hand():
    image = np.zeros((1, 64, 3), np.uint8)
    image[0, 30:34] = np.array([40, 90, 90, 30])[:, None]
    settings = {"floor": 20, "centroid_window": Window.RUN}
    mean = (30 * 20 + 31 * 70 + 32 * 70 + 33 * 10) / 170
    for detector, column in ((Detector.CENTROID, mean), (Detector.MAXIMUM, 31.5)):
        (record,) = check([(image, default_settings(detector=detector, **settings), ALL)])
        assert abs(record["position"][0] / 256 - column) <= 1 / 256


def test_colour_elsewhere_is_ambiguous():
    """A white lamp of more contrast in one run with the red line: its colour tells that it is another thing."""
    line, lamp = line_image(1, 64, [20]), line_image(1, 64, [44], 250, 2)[..., :1] * np.ones(3, np.uint8)
    image = np.maximum(np.maximum(line, lamp), np.uint8(40))
    settings = default_settings(floor=10, ambiguous_ratio=255)
    (record,) = check([(image, settings, RED)])
    assert abs(record["position"][0] / 256 - 44) < 0.1 and record["ambiguous"][0]
    (record,) = check([(image, settings, ALL)])
    assert abs(record["position"][0] / 256 - 44) < 0.1 and not record["ambiguous"][0]


def test_wide_lamp():
    """A red lamp has the greater sum, the line the greater contrast; in one run with it, or each in its own.

    Most of the colour lies elsewhere in the second case, which makes the row ambiguous.
    """
    lamp = line_image(1, 96, [62], 220, 10)
    image = np.maximum(line_image(1, 96, [20], 200), np.maximum(lamp, np.uint8(20)))
    for floor, ambiguous in ((5, 0), (60, 1)):
        (record,) = check([(image, default_settings(floor=floor, ambiguous_ratio=128), RED)], features=Features(96, 64))
        assert abs(record["position"][0] / 256 - 20) < 0.1 and record["ambiguous"][0] == ambiguous
        assert record["second_valid"][0] and abs(record["second_position"][0] / 256 - 62) <= 1


def test_two_lines_in_one_run():
    """The run's second peak is the row's runner-up, before another run's weaker one, and after its stronger."""
    for weaker, expected in ((40, 34), (140, 60)):
        pair = np.maximum(line_image(1, 80, [20], 200), line_image(1, 80, [34], 100))
        image = np.maximum(pair, line_image(1, 80, [60], weaker))
        image[0, 10:45] = np.maximum(image[0, 10:45], 12)
        (record,) = check([(image, default_settings(floor=5), ALL)], features=Features(80, 64))
        assert abs(record["position"][0] / 256 - 20) < 0.1
        assert abs(record["second_position"][0] / 256 - expected) <= 0.5


def test_no_crossing():
    """Flat runs stand in their middles and are cut; two of them are as good as each other."""
    image = np.zeros((1, 64, 3), np.uint8)
    image[0, :9] = image[0, 55:] = 200
    (record,) = check([(image, default_settings(ambiguous_ratio=255), ALL)])
    assert record["cut"][0] and record["ambiguous"][0] and record["runner_up"][0] == 255
    assert (record["position"][0], record["second_position"][0]) == (4 * 256, 59 * 256)


def test_one_pixel_wide_and_high():
    rng = np.random.default_rng(SEED)
    frames = [(random_image(rng, rows, columns), default_settings(floor=0), ALL) for rows, columns in ((4, 1), (1, 2))]
    check(frames)


def test_region():
    image = line_image(6, 48, [10, 10, 10, 30, 30, 30])
    settings = default_settings(column_first=20, column_last=40, row_first=1, row_last=4)
    (record,) = check([(image, settings, RED)])
    assert record["valid"].tolist() == [0, 0, 0, 1, 1, 0]


def test_latency():
    """The record comes ``latency`` clocks after the row's last pixel, whatever is in the row; at most 64."""
    dut = Vision()
    assert dut.latency <= 64
    clocks = {"last": [], "record": []}

    async def watch(ctx):
        clock = 0
        async for _, _, valid, last, record in ctx.tick().sample(
            dut.video.pixel.valid, dut.video.pixel.p.row_last, dut.rows.row.valid
        ):
            clock += 1
            if valid and last:
                clocks["last"].append(clock)
            if record:
                clocks["record"].append(clock)

    async def testbench(ctx):
        rng = np.random.default_rng(SEED)
        for detector in Detector:
            ctx.set(dut.settings, default_settings(detector=detector))
            await load_luts(ctx, dut.lut, ALL)
            await send_image(ctx, dut.video, random_image(rng, 6, 33))
        await ctx.tick().repeat(64)

    simulate(dut, testbench, watch)
    assert clocks["record"] == [clock + dut.latency for clock in clocks["last"]]
    assert len(clocks["record"]) == 6 * len(Detector)


def test_latency_with_the_filter():
    """A row's record comes ``latency`` clocks after the last pixel of the row below; the image's last as if there were
    one, after the shortest blanking and as long as itself.
    """
    dut = Vision(Features(64, 64))
    columns, rows = 50, 4
    clocks = {"last": [], "record": []}

    async def watch(ctx):
        clock = 0
        async for _, _, last, record in ctx.tick().sample(
            dut.video.pixel.valid & dut.video.pixel.p.row_last, dut.rows.row.valid
        ):
            clock += 1
            if last:
                clocks["last"].append(clock)
            if record:
                clocks["record"].append(clock)

    async def testbench(ctx):
        ctx.set(dut.settings, default_settings(isolate=3))
        await send_image(ctx, dut.video, random_image(np.random.default_rng(SEED), rows, columns))
        await ctx.tick().repeat(columns + 64)

    simulate(dut, testbench, watch)
    assert clocks["record"][:-1] == [clock + dut.latency for clock in clocks["last"][1:]]
    assert 0 <= clocks["record"][-1] - clocks["last"][-1] - dut.latency - columns <= BLANKING


@pytest.mark.parametrize("seed", range(4))
def test_broken_contract(seed):
    """Blanking and lengths at random: one record per row that the report counts, in order; the rows that are not
    flagged are right, and the next image is whole.
    """
    print("seed", seed)
    rng = np.random.default_rng(seed)
    dut = Vision(Features(64, 64))
    settings = default_settings(floor=30)
    whole = random_image(rng, 3, 40)
    widths = [int(rng.integers(1, 70)) for _ in range(30)]
    rows = [random_image(rng, 1, width) for width in widths]
    records, reports = [[]], []

    async def collect(ctx):
        async for _, _, valid, payload, end, errors, count in ctx.tick().sample(
            dut.rows.row.valid, dut.rows.row.p, dut.rows.frame_end, dut.errors, dut.image_rows
        ):
            if valid:
                assert payload.row == len(records[-1])
                records[-1].append(tuple(payload.record[name] for name in ROW_DTYPE.names))
            if end:
                assert count == len(records[-1])
                records.append([])
                reports.append(any(errors[field.name] for field in CAMERA_ERRORS.fields if not field.reserved))

    async def testbench(ctx):
        ctx.set(dut.settings, settings)
        await load_luts(ctx, dut.lut, ALL)
        for number, image in enumerate(rows):
            for column in range(image.shape[1]):
                r, g, b = (int(value) for value in image[0, column])
                flags = {"row_first": column == 0, "row_last": column == image.shape[1] - 1}
                ctx.set(dut.video.pixel.p, {"r": r, "g": g, "b": b, "frame_first": number == column == 0, **flags})
                ctx.set(dut.video.pixel.valid, 1)
                await ctx.tick()
                ctx.set(dut.video.pixel.valid, 0)
            await ctx.tick().repeat(int(rng.integers(1, 50)))
        ctx.set(dut.video.frame_end, 1)
        await ctx.tick()
        ctx.set(dut.video.frame_end, 0)
        await ctx.tick().repeat(64)
        await send_image(ctx, dut.video, whole)
        await ctx.tick().repeat(dut.latency + 32)

    simulate(dut, testbench, collect, clocks=20_000)
    broken, after, _ = [np.array(frame, dtype=ROW_DTYPE) for frame in records]
    assert after.tolist() == Vision.reference(whole, settings, ALL).tolist()
    good = [Vision.reference(row, settings, ALL)[0].tolist() for row in rows]
    at = 0
    for record in broken:
        if not record["overflow"]:
            assert record.tolist() in good[at:]
            at += good[at:].index(record.tolist()) + 1
    assert at > 0
    assert broken["overflow"].any() and reports[0] and not reports[1]


def test_settings_that_change_too_early():
    """A frame that starts before the one before is measured: that row is flagged."""
    dut = Vision(Features(64, 64))
    flags, errors = [], []

    async def collect(ctx):
        async for _, _, valid, overflow, end, found in ctx.tick().sample(
            dut.rows.row.valid, dut.rows.row.p.record.overflow, dut.rows.frame_end, dut.errors.frame_gap
        ):
            if valid:
                flags.append(overflow)
            if end:
                errors.append(found)

    async def testbench(ctx):
        ctx.set(dut.settings, default_settings())
        image = line_image(1, 60, [20])
        for gap in (30, 200):
            for column in range(60):
                r, g, b = (int(value) for value in image[0, column])
                ends = {"row_first": column == 0, "frame_first": column == 0, "row_last": column == 59}
                ctx.set(dut.video.pixel.p, {"r": r, "g": g, "b": b, **ends})
                ctx.set(dut.video.pixel.valid, 1)
                ctx.set(dut.video.frame_end, column == 59)
                await ctx.tick()
                ctx.set(dut.video.pixel.valid, 0)
                ctx.set(dut.video.frame_end, 0)
            await ctx.tick().repeat(gap)

    simulate(dut, testbench, collect)
    assert flags == [1, 0]
    assert errors == [0, 1]
