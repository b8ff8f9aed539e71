"""Runs a component in Amaranth's simulator."""

from collections.abc import Callable

from amaranth.hdl import Elaboratable
from amaranth.sim import Simulator

PERIOD_S = 10e-9


def simulate(
    dut: Elaboratable, testbench: Callable, *more: Callable, clocks: int = 10_000, camera_s: float | None = None
) -> None:
    """Run ``testbench(ctx)`` to its end, and ``more`` beside it.

    The ``sync`` domain has its clock, and with its period ``camera_s`` the ``camera`` domain, too; time in the
    simulation ends with the testbench.

    Raises
    ------
    TimeoutError
        The testbench took more than ``clocks`` clocks.
    """

    async def timeout(ctx):
        await ctx.delay(clocks * PERIOD_S)
        raise TimeoutError(f"the testbench has not ended after {clocks} clocks")

    simulator = Simulator(dut)
    simulator.add_clock(PERIOD_S)
    if camera_s is not None:
        simulator.add_clock(camera_s, domain="camera", phase=0.37 * camera_s)
    simulator.add_testbench(timeout, background=True)
    simulator.add_testbench(testbench)
    for process in more:
        simulator.add_testbench(process, background=True)
    simulator.run()
