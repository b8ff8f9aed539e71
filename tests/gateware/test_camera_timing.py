"""What is measured of a camera's clock."""

import pytest

from gateware.camera.timing import MISSING_CLOCKS, Timing
from tests.support.simulation import PERIOD_S, simulate


@pytest.mark.parametrize("ratio", [0.13, 0.96, 2.97])
def test_the_pixel_clock_is_measured(ratio):
    dut = Timing()

    async def drive(ctx):
        assert ctx.get(dut.clock_missing)
        await ctx.tick("sync").repeat(100)
        assert not ctx.get(dut.clock_missing)
        await ctx.tick("sync").repeat(2 * 4096 + 10)
        assert abs(ctx.get(dut.rate) - 512 * ratio) <= 1.5
        assert not ctx.get(dut.clock_missing)

    simulate(dut, drive, clocks=10_000, camera_s=PERIOD_S / ratio)


def test_a_clock_that_stops_is_missing_and_comes_back():
    """Within a millisecond for any clock of the card from 8.2 MHz on."""
    assert MISSING_CLOCKS / 8.2e6 < 1e-3
    dut = Timing()
    stopped = []

    async def drive(ctx):
        await ctx.tick().repeat(5000)
        assert not ctx.get(dut.clock_missing)
        stopped.append(True)
        clocks = 0
        while not ctx.get(dut.clock_missing):
            await ctx.tick()
            clocks += 1
        assert clocks <= MISSING_CLOCKS + 10
        await ctx.tick().repeat(4096)
        assert ctx.get(dut.rate) == 0
        stopped.clear()
        await ctx.tick().repeat(40)
        assert not ctx.get(dut.clock_missing)

    async def camera(ctx):
        while True:
            await ctx.delay(PERIOD_S / 2)
            if not stopped:
                ctx.set(clock, 1 - ctx.get(clock))

    from amaranth.hdl import ClockDomain, Module

    m = Module()
    m.domains.camera = domain = ClockDomain(reset_less=True)
    m.submodules.timing = dut
    clock = domain.clk
    simulate(m, drive, camera, clocks=30_000)
