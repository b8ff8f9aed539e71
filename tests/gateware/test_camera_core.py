"""Frames through a camera's bus give the rows that the same pictures give directly, in the whole card's packets."""

from types import SimpleNamespace

import pytest
from amaranth.hdl import Module
from amaranth.lib import io, wiring
from amaranth.lib.wiring import connect

from gateware.camera.dvp import Dvp
from gateware.camera.pins import camera_dvp
from gateware.camera.rgb import Interlace, Rgb
from gateware.camera.sensor import Check, Control, Part, SensorTable
from gateware.core import Core
from gateware.features import Features
from magtrak.protocol import CAMERA_STATE, Deframer, Sensor
from sim.quantise import rgb565
from tests.gateware.test_camera_sources import dvp, rgb
from tests.gateware.test_core import Rig, expected, line_image, open_gate
from tests.support.sensors import RgbTiming, dvp_frame, ov7670, rgb565_bytes, rgb_frame
from tests.support.simulation import PERIOD_S, simulate


class Seeing(wiring.Component):
    """A core with a source."""

    def __init__(self, source: Dvp | Rgb) -> None:
        self.source = source
        own_clock = isinstance(source, Rgb) and source.own_clock
        self.core = Core(Features(max_columns=64, max_rows=16), "camera" if own_clock else "sync")
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


PICTURES = [line_image(rows=4, columns=32, seed=seed) for seed in range(2)]


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
    check(frames_of(Dvp(), clocks, 2, 1.83), [rgb565(picture) for picture in PICTURES])


def test_fields_are_told_in_the_frames():
    timings = [RgbTiming(back=24, half_line=half) for half in (False, True)]
    clocks = rgb([rgb_frame(picture, timing) for picture, timing in zip(PICTURES, timings, strict=True)])
    found = frames_of(Rgb(interlace=Interlace.PHASE), clocks, 2, 0.97)
    check(found, PICTURES)
    assert [header["row_step"] for header, _ in found] == [2, 2]
    assert [header["first_row"] for header, _ in found] == [0, 1]


@pytest.mark.parametrize("ratio", [0.41, 2.47])
def test_video_is_measured_in_its_own_clock(ratio):
    clocks = rgb([rgb_frame(picture, RgbTiming(lines_back=4)) for picture in PICTURES])
    check(frames_of(Rgb(own_clock=True), clocks, 2, ratio), PICTURES)


class ClockPort(io.SimulationPort):
    """A simulation's port has no pin to constrain; this stands for it."""

    io = "pclk"


class Pins:
    """A board of which a simulation holds the pins of ``camera``."""

    def __init__(self) -> None:
        widths = {"href": 1, "vsync": 1, "d": 8}
        self.camera = SimpleNamespace(
            pclk=ClockPort("i", 1),
            **{name: io.SimulationPort("i", width) for name, width in widths.items()},
            **{name: io.SimulationPort("io", 1) for name in ("scl", "sda")},
            **{name: io.SimulationPort("o", 1) for name in ("xclk", "reset")},
        )
        self.constraints: list[tuple[str, float]] = []

    def request(self, name, number, *, dir):
        assert (name, number, dir) == ("camera", 0, "-")
        return self.camera

    def add_clock_constraint(self, clock, hz) -> None:
        self.constraints.append((clock, hz))


TABLE = SensorTable(
    Sensor.OV7670, 0x21, 1, True, (Check(0x0A, 0x76),), (Control(0x10, Part("exposure", 2, 8)),), gain_doublings=6
)
"""As short as can be: the whole card is slow to simulate."""


class OnPins(wiring.Component):
    """A core with a camera on the pins of a board, as a card has it."""

    def __init__(self, pins: Pins) -> None:
        self.pins = pins
        self.core = Core(Features(max_columns=64, max_rows=16))
        super().__init__({})

    def elaborate(self, platform):
        m = Module()
        m.submodules.core = self.core
        m.submodules.source = source = camera_dvp(TABLE)(m, self.pins, self.core, 2000)  # set up soon: 2 clocks a ms
        connect(m, source.video, self.core.video)
        return m


def test_a_camera_on_pins_is_set_up_obeys_the_host_and_gives_its_pictures():
    """Pictures that it sends before it is set up do not count; then the host's registers tell all there is to tell."""
    pins, camera = Pins(), ov7670()
    dut = OnPins(pins)
    rigs = []

    async def test(ctx):
        rig = Rig(ctx, dut.core)
        rigs.append(rig)
        state = CAMERA_STATE.unpack((await rig.read("camera_state")).to_bytes(4, "little"))
        assert (state["sensor"], state["ready"], state["clock_missing"]) == (Sensor.OV7670, 0, 0)
        await rig.write("run", 1)
        await open_gate(rig)
        await rig.write("commit", 1)
        ready = 0
        while not ready:
            await rig.ctx.tick().repeat(200)
            ready = CAMERA_STATE.unpack((await rig.read("camera_state")).to_bytes(4, "little"))["ready"]
        assert camera.written == [(0, 0x10, 200 >> 2)]
        await rig.write("camera_exposure", 0x345)
        for picture in PICTURES:
            header, rows = await rig.frame()
            while header["generation"] == 0:  # one may come before the commit
                header, rows = await rig.frame()
            assert (header["columns"], header["rows"], header["camera_errors"]) == (32, 4, 0)
            assert rows in [expected(rgb565(one)) for one in PICTURES], picture
        assert (await rig.read("camera_row"), await rig.read("camera_rows")) == (32 << 16 | 32, 4)
        assert abs(await rig.read("camera_rate") - 512 * 0.9) < 2
        assert camera.written == [(0, 0x10, 200 >> 2), (0, 0x10, 0x345 >> 2 & 0xFF)]
        state = CAMERA_STATE.unpack((await rig.read("camera_state")).to_bytes(4, "little"))
        assert (state["cut"], state["broken"], state["unsteady"], state["unacknowledged"]) == (0, 0, 0, 0)

    async def listen(ctx):
        deframer = Deframer()
        ctx.set(dut.core.tx.ready, 1)
        while True:
            _, _, valid, byte = await ctx.tick().sample(dut.core.tx.valid, dut.core.tx.payload)
            if valid:
                rigs[0].packets += deframer.feed(bytes([byte]))

    async def bus(ctx):
        port = pins.camera
        while True:
            _, _, scl_low, sda_low = await ctx.tick().sample(port.scl.oe, port.sda.oe)
            assert not (ctx.get(port.scl.o) or ctx.get(port.sda.o))
            pulls = camera.step(1 - scl_low, 1 - sda_low)
            ctx.set(port.sda.i, not (sda_low or pulls))

    async def pictures(ctx):
        """PCLK and the pictures in turn, for ever; the bus changes at the falling edge. Noise until it is set up."""
        port, number = pins.camera, 0
        while True:
            data = rgb565_bytes(PICTURES[number % 2])
            for href, vsync, byte in dvp_frame(data if camera.written else [data[0], data[1][:9]]):
                ctx.set(port.pclk.i, 0)
                ctx.set(port.href.i, href)
                ctx.set(port.vsync.i, vsync)
                ctx.set(port.d.i, byte)
                await ctx.delay(PERIOD_S / 1.8)
                ctx.set(port.pclk.i, 1)
                await ctx.delay(PERIOD_S / 1.8)
            number += 1

    simulate(dut, test, listen, bus, pictures, clocks=30_000)
    assert pins.constraints == [("pclk", 50e6)]
    assert camera.faults == []
