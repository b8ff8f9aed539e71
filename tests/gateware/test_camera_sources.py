"""Images over a camera's bus, whole, across unrelated clocks, and with the faults that a bus can have."""

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import connect

from gateware.camera.dvp import Dvp
from gateware.camera.monitor import Monitor
from gateware.camera.rgb import Rgb
from gateware.layouts import Field
from sim.quantise import rgb565
from tests.support.sensors import DvpTiming, dvp_frame, rgb565_bytes
from tests.support.simulation import PERIOD_S, simulate


class Watched(wiring.Component):
    """A source, and the Monitor that watches its video."""

    def __init__(self, source: Dvp | Rgb) -> None:
        self.source = source
        self.monitor = Monitor(64, 64)
        super().__init__({})

    def elaborate(self, platform):
        m = Module()
        m.submodules.source = self.source
        m.submodules.monitor = self.monitor
        connect(m, self.source.video, self.monitor.video)
        return m


class Seen:
    """What came out of a source."""

    def __init__(self) -> None:
        self.images: list[list[list]] = []  # rows of pixels, as the source has them
        self.fields: list[Field] = []
        self.starts: list[int] = []
        self.errors: list[dict[str, int]] = []
        self.cut = self.broken = 0

    def picture(self, number: int) -> np.ndarray:
        return np.array(self.images[number], np.uint8)


def watch(source, clocks, ratio: float, *, limit: int = 60_000) -> Seen:
    """Drive the bus of ``source`` with ``clocks`` (each a dict of its members), at ``ratio`` camera clocks to the card's."""
    dut = Watched(source)
    seen = Seen()
    camera_s = PERIOD_S / ratio

    async def drive(ctx):
        for values in clocks:
            for name, value in values.items():
                ctx.set(getattr(source, name), value)
            await ctx.tick("camera")
        await ctx.tick("sync").repeat(200)
        seen.cut, seen.broken = ctx.get(source.cut), ctx.get(source.broken)

    async def look(ctx):
        video, clock, ended = source.video, 0, False
        while True:
            _, _, valid, pixel, end, field = await ctx.tick("sync").sample(
                video.pixel.valid, video.pixel.p, video.frame_end, video.field
            )
            clock += 1
            if ended:
                seen.errors.append({name: ctx.get(dut.monitor.errors[name]) for name in ERRORS})
            if valid and pixel.frame_first:
                seen.images.append([])
                seen.fields.append(Field(field))
            if valid and pixel.row_first:
                seen.starts.append(clock)
                seen.images[-1].append([])
            if valid and (pixel.row_first or seen.images[-1][-1] is not None):
                seen.images[-1][-1].append((pixel.r, pixel.g, pixel.b))
            ended, pending = pending_end(end)

    last = [False]

    def pending_end(end):
        """The Monitor's word on an image is there two clocks after its end."""
        was, last[0] = last[0], bool(end)
        return was, last[0]

    simulate(dut, drive, look, clocks=limit, camera_s=camera_s)
    return seen


ERRORS = ("blanking", "row_period", "frame_gap", "row_length", "columns", "rows", "framing")


def dvp(frames):
    """A stream of frames, and the vertical sync after the last."""
    for frame in frames:
        yield from ({"href": h, "vsync": v, "d": d} for h, v, d in frame)
    yield from ({"href": 0, "vsync": 1, "d": 0} for _ in range(40))


def random_images(seed: int, count: int, rows: int = 4, columns: int = 24) -> list[np.ndarray]:
    return list(np.random.default_rng(seed).integers(0, 256, (count, rows, columns, 3)).astype(np.uint8))


@pytest.mark.parametrize("ratio", [0.11, 0.5, 0.97, 1.03, 1.9])
@pytest.mark.parametrize("high_byte_first", [True, False])
def test_dvp_images_arrive_whole_at_unrelated_clocks(ratio, high_byte_first):
    """Up to almost two camera clocks to one of the card: two bytes are a pixel."""
    images = random_images(1, 3)
    frames = [dvp_frame(rgb565_bytes(image, high_byte_first=high_byte_first)) for image in images]
    source = Dvp(high_byte_first=high_byte_first, depth=16)
    seen = watch(source, dvp(frames), ratio)
    assert len(seen.images) == 3
    for number, image in enumerate(images):
        assert (seen.picture(number) == rgb565(image)).all(), number
    assert (seen.cut, seen.broken) == (0, 0)
    assert not any(any(errors.values()) for errors in seen.errors), seen.errors
    assert len(seen.errors) == 3


def test_dvp_with_the_data_sheets_own_blanking():
    """Rows come a line apart to within a clock or two: the crossing adds no more."""
    image = random_images(2, 1, rows=3, columns=16)[0]
    timing = DvpTiming(sync_lines=3, lines_before=17, lines_after=10)
    seen = watch(Dvp(), dvp([dvp_frame(rgb565_bytes(image), timing)]), 0.96)
    assert (seen.picture(0) == rgb565(image)).all()
    assert np.abs(np.diff(seen.starts) - 2 * 160 / 0.96).max() <= 1.5


def test_the_polarities_of_dvp():
    image = random_images(3, 1)[0]
    inverted = [
        {**one, "href": 1 - one["href"], "vsync": 1 - one["vsync"]} for one in dvp([dvp_frame(rgb565_bytes(image))])
    ]
    seen = watch(Dvp(href_low=True, vsync_low=True), inverted, 0.9)
    assert (seen.picture(0) == rgb565(image)).all()
