"""Frames through a camera's bus give the rows that the same pictures give directly, in the whole card's packets."""

from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import connect

from gateware.camera.dvp import Dvp
from gateware.camera.rgb import Interlace, Rgb
from gateware.core import Core
from magtrak.protocol import Deframer
from sim.quantise import rgb565
from tests.gateware.test_camera_sources import dvp, rgb
from tests.gateware.test_core import Rig, expected, line_image, open_gate
from tests.support.sensors import RgbTiming, dvp_frame, rgb565_bytes, rgb_frame
from tests.support.simulation import PERIOD_S, simulate


class Seeing(wiring.Component):
    """A core with a source."""

    def __init__(self, source: Dvp | Rgb) -> None:
        self.source = source
        self.core = Core(64, 16)
        super().__init__({})

    def elaborate(self, platform):
        m = Module()
        m.submodules.source = self.source
        m.submodules.core = self.core
        connect(m, self.source.video, self.core.video)
        return m


def frames_of(source, clocks, count: int, ratio: float) -> list[tuple[dict, list]]:
    """Headers and rows of ``count`` frames from the bus."""
    found: list[tuple[dict, list]] = []
    dut = Seeing(source)
    rigs = []

    async def test(ctx):
        rig = Rig(ctx, dut.core)
        rigs.append(rig)
        await open_gate(rig)
        await rig.write("commit", 1)
        await rig.write("run", 1)
        for values in clocks:
            for name, value in values.items():
                ctx.set(getattr(source, name), value)
            await ctx.tick("camera")
        for _ in range(count):
            found.append(await rig.frame())

    async def listen(ctx):
        deframer = Deframer()
        ctx.set(dut.core.tx.ready, 1)
        while True:
            _, _, valid, byte = await ctx.tick().sample(dut.core.tx.valid, dut.core.tx.payload)
            if valid:
                rigs[0].packets += deframer.feed(bytes([byte]))

    simulate(dut, test, listen, clocks=40_000, camera_s=PERIOD_S / ratio)
    return found


PICTURES = [line_image(rows=4, columns=32, seed=seed) for seed in range(3)]


def check(found, pictures) -> None:
    """All rows are those of the pictures: ``test_core.py`` has the same of pixels given to the core directly."""
    assert len(found) == len(pictures)
    for number, ((header, rows), picture) in enumerate(zip(found, pictures, strict=True)):
        assert (header["frame"], header["columns"], header["rows"]) == (number, 32, 4)
        assert header["camera_errors"] == 0
        assert rows == expected(picture)
        assert any(row["valid"] for row in rows)


def test_dvp_gives_the_rows_of_its_pictures():
    clocks = dvp([dvp_frame(rgb565_bytes(picture)) for picture in PICTURES])
    check(frames_of(Dvp(), clocks, 3, 1.83), [rgb565(picture) for picture in PICTURES])


def test_fields_are_told_in_the_frames():
    timings = [RgbTiming(back=24, half_line=half) for half in (False, True, False)]
    clocks = rgb([rgb_frame(picture, timing) for picture, timing in zip(PICTURES, timings, strict=True)])
    found = frames_of(Rgb(interlace=Interlace.PHASE), clocks, 3, 0.97)
    check(found, PICTURES)
    assert [header["row_step"] for header, _ in found] == [2, 2, 2]
    assert [header["first_row"] for header, _ in found] == [0, 1, 0]
