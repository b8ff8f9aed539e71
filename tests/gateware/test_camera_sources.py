"""Images over a camera's bus, whole, across unrelated clocks, and with the faults that a bus can have."""

import numpy as np
import pytest
from amaranth.hdl import ClockDomain, Module
from amaranth.lib import wiring
from amaranth.lib.wiring import connect

from gateware.camera.dvp import Dvp
from gateware.camera.monitor import Monitor
from gateware.camera.rgb import Interlace, Rgb
from gateware.camera.timing import MISSING_CLOCKS, Timing
from gateware.layouts import Field
from sim.quantise import rgb565
from tests.support.sensors import DvpTiming, RgbTiming, dvp_frame, rgb565_bytes, rgb_frame
from tests.support.simulation import PERIOD_S, simulate

ERRORS = ("blanking", "row_period", "frame_gap", "row_length", "columns", "rows", "framing")


class Watched(wiring.Component):
    """A source, and what watches its video."""

    def __init__(self, source: Dvp | Rgb) -> None:
        self.source = source
        self.monitor = Monitor(64, 64)
        self.timing = Timing()
        super().__init__({})

    def elaborate(self, platform):
        m = Module()
        m.submodules.source = self.source
        m.submodules.monitor = self.monitor
        m.submodules.timing = self.timing
        connect(m, self.source.video, self.monitor.video)
        m.d.comb += [
            self.timing.video.pixel.valid.eq(self.source.video.pixel.valid),
            self.timing.video.pixel.payload.eq(self.source.video.pixel.payload),
            self.timing.video.frame_end.eq(self.source.video.frame_end),
        ]
        return m


class Seen:
    """What came out of a source: images as rows of pixels, errors of each image that ended, the state at the end."""

    def __init__(self) -> None:
        self.images: list[list[list]] = []
        self.fields: list[Field] = []
        self.starts: list[int] = []
        self.errors: list[set[str]] = []
        self.state: dict[str, int] = {}

    def picture(self, number: int) -> np.ndarray:
        return np.array(self.images[number], np.uint8)


def watch(source, clocks, ratio: float, *, limit: int = 60_000) -> Seen:
    """Drive the bus of ``source`` with ``clocks``, its members by name, at ``ratio`` camera clocks to the card's."""
    dut = Watched(source)
    seen = Seen()

    async def drive(ctx):
        for values in clocks:
            for name, value in values.items():
                ctx.set(getattr(source, name), value)
            await ctx.tick("camera")
        await ctx.tick("sync").repeat(200)
        seen.state = {"cut": ctx.get(source.cut), "broken": ctx.get(source.broken)}
        seen.state |= {name: ctx.get(getattr(dut.timing, name)) for name in ("row_count", "unsteady", "clock_missing")}
        seen.state |= {name: ctx.get(dut.timing.row[name]) for name in ("shortest", "longest")}

    async def look(ctx):
        video, clock, ends = source.video, 0, [0, 0]
        in_row = False
        while True:
            _, _, valid, pixel, end, field = await ctx.tick("sync").sample(
                video.pixel.valid, video.pixel.p, video.frame_end, video.field
            )
            clock += 1
            if ends.pop(0):  # the Monitor's word is there by now
                errors = ctx.get(dut.monitor.errors)
                seen.errors.append({name for name in ERRORS if errors[name]})
            ends.append(end)
            if valid and pixel.frame_first:
                seen.images.append([])
                seen.fields.append(Field(field))
            if valid and pixel.row_first:
                seen.starts.append(clock)
                seen.images[-1].append([])
                in_row = True
            if valid and in_row:
                seen.images[-1][-1].append((pixel.r, pixel.g, pixel.b))
                in_row = not pixel.row_last

    simulate(dut, drive, look, clocks=limit, camera_s=PERIOD_S / ratio)
    return seen


def dvp(frames):
    """Frames, and the vertical sync after the last."""
    for frame in frames:
        yield from ({"href": h, "vsync": v, "d": d} for h, v, d in frame)
    yield from ({"href": 0, "vsync": 1, "d": 0} for _ in range(40))


def rgb(frames, **more):
    """Likewise; ``more`` are members that stay."""
    for frame in frames:
        for hs, vs, de, (r, g, b) in frame:
            yield {"hs": hs, "vs": vs, "de": de, "r": r, "g": g, "b": b, **more}
    yield from ({"hs": n < 8, "vs": 1, "de": 0, **more} for n in range(40))


def random_images(seed: int, count: int, rows: int = 4, columns: int = 24) -> list[np.ndarray]:
    return list(np.random.default_rng(seed).integers(0, 256, (count, rows, columns, 3)).astype(np.uint8))


@pytest.mark.parametrize(
    ("ratio", "high_byte_first"), [(0.11, True), (0.5, True), (0.97, True), (0.97, False), (1.03, True), (1.9, True)]
)
def test_dvp_images_arrive_whole_at_unrelated_clocks(ratio, high_byte_first):
    """Up to almost two camera clocks to one of the card: two bytes are a pixel."""
    images = random_images(1, 3)
    frames = [dvp_frame(rgb565_bytes(image, high_byte_first=high_byte_first)) for image in images]
    source = Dvp(high_byte_first=high_byte_first, depth=16)
    seen = watch(source, dvp(frames), ratio)
    assert_same(seen, [rgb565(image) for image in images])


def assert_same(seen: Seen, images) -> None:
    """All images, whole, in order, and nothing to complain of."""
    assert len(seen.images) == len(images)
    for number, image in enumerate(images):
        assert (seen.picture(number) == image).all(), number
    assert seen.errors == [set()] * len(images)
    rows, columns = images[0].shape[:2]
    expected = {"cut": 0, "broken": 0, "row_count": rows, "unsteady": 0, "shortest": columns, "longest": columns}
    assert expected.items() <= seen.state.items(), seen.state


def test_dvp_with_the_data_sheets_own_blanking():
    """Rows come a line apart to within a clock or two: the crossing adds no more."""
    image = random_images(2, 1, rows=3, columns=16)[0]
    timing = DvpTiming(sync_lines=3, lines_before=17, lines_after=10)
    seen = watch(Dvp(), dvp([dvp_frame(rgb565_bytes(image), timing)]), 0.96)
    assert (seen.picture(0) == rgb565(image)).all()
    assert np.abs(np.diff(seen.starts) - 2 * 160 / 0.96).max() <= 1.5


def test_the_polarities_of_dvp():
    image = random_images(3, 1)[0]
    clocks = dvp([dvp_frame(rgb565_bytes(image))])
    inverted = [{**one, "href": 1 - one["href"], "vsync": 1 - one["vsync"]} for one in clocks]
    assert_same(watch(Dvp(href_low=True, vsync_low=True), inverted, 0.9), [rgb565(image)])


@pytest.mark.parametrize("ratio", [0.21, 0.94, 1.07])
def test_rgb_images_arrive_whole_at_unrelated_clocks(ratio):
    """Also from a pixel clock faster than the card's: blanking makes up for it."""
    images = random_images(4, 3)
    frames = [rgb_frame(image, RgbTiming(back=24)) for image in images]
    assert_same(watch(Rgb(depth=16), rgb(frames), ratio), images)


@pytest.mark.parametrize("polarity", range(8))
def test_the_polarities_of_rgb(polarity):
    low = {name: bool(polarity >> n & 1) for n, name in enumerate(("hs", "vs", "de"))}
    image = random_images(5, 1)[0]
    clocks = [{**one, **{name: one[name] ^ low[name] for name in low}} for one in rgb([rgb_frame(image)])]
    assert_same(watch(Rgb(**{f"{name}_low": value for name, value in low.items()}), clocks, 0.9), [image])


def test_pauses_that_are_too_short_are_made_longer():
    """Rows of 12 pixels with 4 clocks between them: a row needs 48, and the FIFO has room for all of this image."""
    images = random_images(6, 2, rows=4, columns=12)
    timing = RgbTiming(front=1, sync=2, back=1, lines_front=1, lines_sync=4, lines_back=12)
    seen = watch(Rgb(depth=64), rgb([rgb_frame(image, timing) for image in images]), 0.98)
    assert_same(seen, images)
    assert np.diff(seen.starts)[:3].tolist() == [48, 48, 48]


@pytest.mark.parametrize("at_line", [Field.EVEN, Field.ODD])
def test_fields_by_the_phase_of_the_vertical_sync(at_line):
    """Both fields in turn, and one twice."""
    other = Field.ODD if at_line is Field.EVEN else Field.EVEN
    images = random_images(7, 5)
    halves = [False, True, False, True, True]
    frames = [rgb_frame(image, RgbTiming(half_line=half)) for image, half in zip(images, halves, strict=True)]
    seen = watch(Rgb(interlace=Interlace.PHASE, at_line=at_line), rgb(frames), 0.9)
    assert_same(seen, images)
    assert seen.fields == [other if half else at_line for half in halves]


@pytest.mark.parametrize("invert", [False, True])
def test_fields_by_their_pin(invert):
    images = random_images(8, 3)
    pins = (1, 0, 1)
    clocks = [
        one
        for image, pin in zip(images, pins, strict=True)
        for one in list(rgb([rgb_frame(image)], field_pin=pin))[:-40]
    ]
    seen = watch(Rgb(interlace=Interlace.PIN, field_invert=invert), [*clocks, *rgb([])], 0.9)
    assert_same(seen, images)
    assert seen.fields == [Field.ODD if pin != invert else Field.EVEN for pin in pins]


def test_a_card_that_is_too_slow_cuts_images_and_counts_them():
    """No pixel ever stands elsewhere than in the camera; each image is cut, and is said to be."""
    images = random_images(9, 4, rows=4, columns=40)
    seen = watch(Rgb(depth=16), rgb([rgb_frame(image) for image in images]), 2.9)
    assert seen.state["cut"] == 4
    assert len(seen.errors) == len(seen.images) == 4
    for image, got, errors in zip(images, seen.images, seen.errors, strict=True):
        assert "framing" in errors
        pixels = sum(map(len, got))
        assert pixels < image.size // 3
        for y, row in enumerate(got):
            for x, pixel in enumerate(row):
                last = y == len(got) - 1 and x == len(row) - 1  # the mark is black
                assert pixel == tuple(image[y, x]) or (last and pixel == (0, 0, 0)), (y, x)
    assert seen.state["unsteady"] or seen.state["row_count"] < 4


def test_after_an_overflow_the_next_image_is_whole():
    """One image with rows twice as long as the FIFO takes, then good ones."""
    good = random_images(10, 2, rows=3, columns=16)
    bad = random_images(11, 1, rows=3, columns=60)[0]
    wide = RgbTiming(back=60)
    frames = [rgb_frame(good[0], wide), rgb_frame(bad, RgbTiming(lines_front=6)), rgb_frame(good[1], wide)]
    seen = watch(Rgb(depth=16), rgb(frames), 1.7)
    assert [seen.picture(n).tolist() for n in (0, -1)] == [image.tolist() for image in good]
    assert seen.state["cut"] == 1
    assert [errors & {"framing"} for errors in seen.errors] == [set(), {"framing"}, set()]


def bytes_of(image: np.ndarray) -> list[list[int]]:
    return [row.tolist() for row in rgb565_bytes(image)]


def test_a_lost_byte_is_seen_and_stays_in_its_row():
    images = random_images(12, 3)
    data = [bytes_of(image) for image in images]
    del data[1][2][7]
    seen = watch(Dvp(), dvp([dvp_frame(one) for one in data]), 0.9)
    assert seen.state["broken"] == 1
    assert [bool(errors) for errors in seen.errors] == [False, True, False]
    assert {"framing", "row_length"} <= seen.errors[1]
    assert len(seen.images[1][2]) == images[1].shape[1] - 1
    for number, image in enumerate(images):
        for y, row in enumerate(rgb565(image)):
            if (number, y) != (1, 2):
                assert (np.array(seen.images[number][y]) == row).all()


def test_a_short_row_and_a_glitch_within_a_row_are_seen():
    images = random_images(13, 3)
    data = [bytes_of(image) for image in images]
    data[0][1] = data[0][1][:20]
    clocks = list(dvp([dvp_frame(one) for one in data]))
    starts = [n for n, one in enumerate(clocks) if one["href"] and not clocks[n - 1]["href"]]
    clocks[starts[9] + 12]["href"] = 0  # two rows of it: 6 pixels, and the rest from an odd byte on
    seen = watch(Dvp(), clocks, 0.9)
    assert "row_length" in seen.errors[0] and not seen.errors[1]
    assert {"row_length", "framing"} <= seen.errors[2]
    assert [len(image) for image in seen.images] == [4, 4, 5]
    assert (seen.state["shortest"], seen.state["longest"], seen.state["row_count"]) == (6, 24, 5)
    assert (seen.state["broken"], seen.state["unsteady"]) == (1, 2)


def test_glitches_of_the_vertical_sync_do_nothing_and_an_early_one_cuts_a_row():
    images = random_images(14, 3)
    clocks = list(dvp([dvp_frame(bytes_of(image)) for image in images]))
    starts = [n for n, one in enumerate(clocks) if one["href"] and not clocks[n - 1]["href"]]
    for n in range(7):  # too short
        clocks[starts[1] + 3 + n]["vsync"] = 1
    for n in range(30):
        clocks[starts[6] + 10 + n]["vsync"] = 1
    seen = watch(Dvp(), clocks, 0.9)
    assert (seen.picture(0) == rgb565(images[0])).all() and not seen.errors[0]
    assert "framing" in seen.errors[1] and seen.state["broken"] == 1
    assert len(seen.images) == 4  # the early sync begins one, whose first row is the next
    assert (seen.picture(2) == rgb565(images[1])[3:]).all()
    assert (seen.picture(3) == rgb565(images[2])).all() and not seen.errors[-1]


def test_a_clock_that_stops_within_a_row_loses_nothing():
    """It is missed meanwhile; and when the camera goes on, so does the image."""
    image = random_images(16, 1)[0]
    clocks = list(dvp([dvp_frame(bytes_of(image))]))
    stop = [n for n, one in enumerate(clocks) if one["href"]][60]
    source = Dvp()
    m = Module()
    m.domains.camera = domain = ClockDomain(reset_less=True)
    m.submodules.watched = dut = Watched(source)
    pixels, errors = [], []

    async def drive(ctx):
        for n, values in enumerate(clocks):
            ctx.set(domain.clk, 0)
            for name, value in values.items():
                ctx.set(getattr(source, name), value)
            await ctx.delay(PERIOD_S * 0.57)
            ctx.set(domain.clk, 1)
            await ctx.delay(PERIOD_S * 0.57)
            if n == stop:
                assert not ctx.get(dut.timing.clock_missing)
                await ctx.delay(PERIOD_S * (MISSING_CLOCKS + 10))
                assert ctx.get(dut.timing.clock_missing)
        await ctx.tick("sync").repeat(20)
        assert not ctx.get(dut.timing.clock_missing)
        errors.append(ctx.get(dut.monitor.errors.as_value()))

    async def look(ctx):
        while True:
            _, _, valid, pixel = await ctx.tick("sync").sample(source.video.pixel.valid, source.video.pixel.p)
            if valid:
                pixels.append((pixel.r, pixel.g, pixel.b))

    simulate(m, drive, look, clocks=20_000)
    assert (np.array(pixels, np.uint8).reshape(image.shape) == rgb565(image)).all()
    assert errors == [0]


def test_a_camera_that_begins_anew_cuts_its_image():
    """As after its supply failed: in the middle of a row the vertical sync comes on."""
    images = random_images(17, 3)
    frames = [list(dvp_frame(bytes_of(image))) for image in images]
    rows = [n for n, (href, _, _) in enumerate(frames[1]) if href]
    seen = watch(Dvp(), dvp([frames[0], frames[1][: rows[60]], frames[2]]), 0.9)
    assert [len(image) for image in seen.images] == [4, 2, 4]
    assert (seen.picture(2) == rgb565(images[2])).all()
    assert "row_length" in seen.errors[1] and not seen.errors[2]
    assert seen.state["unsteady"] == 2  # the one that was cut, and the next, which has more rows


def test_images_pass_while_they_may():
    """One that has begun is completed."""
    images = random_images(15, 4)
    clocks = list(dvp([dvp_frame(bytes_of(image)) for image in images]))
    starts = [n for n, one in enumerate(clocks) if one["href"] and not clocks[n - 1]["href"]]
    for n, one in enumerate(clocks):
        one["enable"] = starts[2] < n < starts[9]
    seen = watch(Dvp(), clocks, 0.9)
    assert_same(seen, [rgb565(image) for image in images[1:3]])


@pytest.mark.parametrize("depth", [8, 48])
def test_depths_that_are_not_possible_are_refused(depth):
    with pytest.raises(ValueError, match=f"depth is {depth};"):
        Dvp(depth=depth)


def test_a_picture_that_is_not_interlaced_has_no_first_field():
    with pytest.raises(ValueError, match="at_line is"):
        Rgb(at_line=Field.PROGRESSIVE)
