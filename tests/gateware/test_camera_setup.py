"""Cameras are set up as their tables have it, over a bus that is modelled bit by bit, and with all that can fail."""

from collections.abc import Awaitable, Callable

import pytest

from gateware.camera.ov2640 import OV2640
from gateware.camera.ov5640 import OV5640
from gateware.camera.ov7670 import OV7670
from gateware.camera.sccb import Sccb
from gateware.camera.sensor import Check, Control, Part, SensorTable, Write
from gateware.camera.setup import ATTEMPTS, RESTART_MS, Setup
from magtrak.protocol import Sensor, SetupCause
from tests.support.sensors import SccbCamera, ov2640, ov5640, ov7670
from tests.support.simulation import simulate

CLOCK_HZ = 2000  # so that a millisecond is two clocks
BUS_HZ = 125

SHORT = SensorTable(
    sensor=Sensor.OV5640,
    device=0x3C,
    address_bytes=2,
    acknowledges=True,
    steps=(
        Check(0x300A, 0x56),
        Write(0x3008, 0x80, mask=0, wait=True),
        Write(0x4300, 0x61),
        Write(0x501F, 0x09, mask=1),
    ),
    controls=(Control(0x3501, Part("exposure", 4, 8)), Control(0x350B, Part("gain", 0, 8), data=0x01)),
)
"""A short table, for what does not depend on the kind of camera."""


def set_up(
    table: SensorTable,
    camera: SccbCamera | None,
    test: Callable[..., Awaitable[None]],
    *,
    exposure: int = 200,
    gain: int = 16,
    clocks: int = 200_000,
) -> Setup:
    """Run ``test(ctx, dut)`` beside a set-up and a camera, or none."""
    dut = Setup(table, CLOCK_HZ, BUS_HZ)

    async def drive(ctx):
        ctx.set(dut.exposure, exposure)
        ctx.set(dut.gain, gain)
        await test(ctx, dut)

    async def bus(ctx):
        while True:
            _, _, scl_low, sda_low = await ctx.tick().sample(dut.scl_low, dut.sda_low)
            pulls = camera.step(1 - scl_low, 1 - sda_low) if camera else False
            ctx.set(dut.sda, not (sda_low or pulls))

    simulate(dut, drive, bus, clocks=clocks)
    if camera:
        assert camera.faults == []
    return dut


async def until(ctx, signal) -> None:
    while not ctx.get(signal):
        await ctx.tick()


@pytest.mark.parametrize(
    ("table", "make", "acknowledges"),
    [(OV7670, ov7670, True), (OV7670, ov7670, False), (OV2640, ov2640, True), (OV5640, ov5640, True)],
)
def test_a_camera_has_all_that_its_table_says(table, make, acknowledges):
    """In order, once each, and then exposure and gain. A camera that leaves the ninth bit open is told of, no more."""
    camera = make(acknowledges=acknowledges)

    async def test(ctx, dut):
        await until(ctx, dut.ready)
        assert ctx.get(dut.setup.failures) == 0
        assert ctx.get(dut.unacknowledged) == (not acknowledges)

    set_up(table, camera, test, exposure=0x1234, gain=0x155)
    expected = [(s.address, s.data) for s in table.steps if isinstance(s, Write)]
    expected += table.control_values(0x1234, 0x155)
    assert [(address, data) for _, address, data in camera.written] == expected


def test_exposure_and_gain_can_be_changed():
    camera = ov5640()

    async def test(ctx, dut):
        await until(ctx, dut.ready)
        for exposure, gain in ((0x50, 40), (0x50, 41), (0xFFF, 41)):
            camera.written.clear()
            ctx.set(dut.exposure, exposure)
            ctx.set(dut.gain, gain)
            await ctx.tick().repeat(2 * 4 * (156 + 204) + 100)
            assert [(a, d) for _, a, d in camera.written] == SHORT.control_values(exposure, gain)
        camera.written.clear()
        await ctx.tick().repeat(2000)
        assert camera.written == [] and ctx.get(dut.ready)

    set_up(SHORT, camera, test)


@pytest.mark.parametrize("doublings", [None, 4, 6])
def test_gains_are_coded_as_the_camera_has_them(doublings):
    parts = (Control(0x00, Part("gain", 0, 8)), Control(0x03, Part("gain", 8, 2, at=6)))
    table = SensorTable(Sensor.OV7670, 0x21, 1, True, (Check(0x0A, 0x76),), parts, gain_doublings=doublings)
    camera = ov7670()

    async def test(ctx, dut):
        await until(ctx, dut.ready)
        for gain in (17, 31, 32, 63, 100, 255, 256, 496, 511, 512, 1023):
            ctx.set(dut.gain, gain)
            await ctx.tick().repeat(2 * 4 * (120 + 168) + 100)
            code = camera.registers[0, 0x00] | camera.registers[0, 0x03] << 2
            assert code == table.gain_code(gain), gain
            if doublings:
                # The data sheet's formula, for what the camera has of it.
                found = 1 + (code & 15) / 16
                for bit in range(4, 10):
                    found *= 1 + (code >> bit & 1)
                most = (1 << doublings) * 31 / 16
                assert found == most if gain / 16 > most else 0 <= gain / 16 - found < found / 16

    set_up(table, camera, test)


def test_a_byte_that_is_not_acknowledged_is_sent_again():
    camera = ov5640(deaf={3, 9, 10})

    async def test(ctx, dut):
        await until(ctx, dut.ready)
        assert ctx.get(dut.setup.failures) == 0
        assert ctx.get(dut.unacknowledged)

    set_up(SHORT, camera, test)
    assert camera.registers[0, 0x4300] == 0x61


def test_a_camera_that_comes_late_is_set_up_late():
    """It does not acknowledge at first; the failure stays to be read."""
    camera = ov5640(deaf=range(ATTEMPTS + 2))

    async def test(ctx, dut):
        await until(ctx, dut.setup.failures == 1)
        assert not ctx.get(dut.ready)
        assert ctx.get(dut.setup.cause) == SetupCause.ACKNOWLEDGE
        assert ctx.get(dut.setup.address) == 0x300A
        await ctx.tick().repeat((RESTART_MS - 10) * CLOCK_HZ // 1000)
        assert not ctx.get(dut.ready)
        await until(ctx, dut.ready)
        assert ctx.get(dut.setup.failures) == 1

    set_up(SHORT, camera, test)


@pytest.mark.parametrize(
    ("camera", "cause", "address", "read"),
    [
        (SccbCamera(0x3C, 2, {0x300A: 0x26}, (0x3008, 0x80)), SetupCause.IDENTITY, 0x300A, 0x26),
        (ov5640(stuck={0x4300}), SetupCause.READ_BACK, 0x4300, 0),
        (ov5640(stuck={0x350B}), SetupCause.READ_BACK, 0x350B, 0),  # a control
        (SccbCamera(0x21, 2, {}, (0x3008, 0x80)), SetupCause.ACKNOWLEDGE, 0x300A, None),  # another device
        (None, SetupCause.ACKNOWLEDGE, 0x300A, None),
    ],
)
def test_failures_say_where_and_why(camera, cause, address, read):
    async def test(ctx, dut):
        await until(ctx, dut.setup.failures == 1)
        assert not ctx.get(dut.ready)
        assert ctx.get(dut.setup.cause) == cause
        assert ctx.get(dut.setup.address) == address
        assert read is None or ctx.get(dut.setup.read) == read
        await until(ctx, dut.setup.failures == 2)  # it goes on trying

    set_up(SHORT, camera, test)


def test_without_a_camera_that_need_not_acknowledge_the_identity_fails():
    async def test(ctx, dut):
        await until(ctx, dut.setup.failures == 1)
        assert ctx.get(dut.setup.cause) == SetupCause.IDENTITY
        assert ctx.get(dut.setup.read) == 0xFF
        assert ctx.get(dut.unacknowledged)

    set_up(OV7670, None, test)


@pytest.mark.parametrize(("address_bytes", "read", "quarters"), [(1, 0, 120), (2, 0, 156), (1, 1, 168), (2, 1, 204)])
def test_a_transmission_takes_so_long(address_bytes, read, quarters):
    """As the docstring says; the clock is high and low for half of each bit."""
    dut = Sccb(0x21, address_bytes, 5)

    async def drive(ctx):
        ctx.set(dut.i.p.read, read)
        ctx.set(dut.i.valid, 1)
        await ctx.tick()
        ctx.set(dut.i.valid, 0)
        taken, levels = 0, []
        while not ctx.get(dut.done):
            await ctx.tick()
            taken += 1
            levels.append(1 - ctx.get(dut.scl_low))
        assert taken == 5 * quarters
        runs, last = [], 0
        for clock, level in enumerate(levels):
            if clock and level != levels[clock - 1]:
                runs.append(clock - last)
                last = clock
        assert min(runs[1:]) == 2 * 5

    simulate(dut, drive)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [((128, 1, 4), "device is 128"), ((1, 3, 4), "address_bytes is 3"), ((1, 1, 3), "quarter_clocks is 3")],
)
def test_what_a_bus_cannot_have_is_refused(parameters, text):
    with pytest.raises(ValueError, match=text):
        Sccb(*parameters)
