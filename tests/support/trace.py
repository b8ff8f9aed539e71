"""Drives a component clock by clock, and writes down what comes out."""

from collections.abc import Iterable, Mapping, Sequence

from amaranth.lib import data, wiring

from tests.support.simulation import simulate


def trace(dut: wiring.Component, stimulus: Iterable[Mapping[str, int]], outputs: Sequence[str]) -> dict[str, list[int]]:
    """What ``outputs`` are in each clock, with the inputs of that clock in force.

    Parameters
    ----------
    dut : component in the ``sync`` domain
    stimulus : for each clock from reset on, values of inputs by name (``settings.field`` for a field); an
        input that is not named keeps its value
    outputs : names likewise

    Returns
    -------
    the values, by name, one for each clock
    """

    def find(name: str):
        signal, *fields = name.split(".")
        value = getattr(dut, signal)
        for field in fields:
            value = getattr(value, field)
        return value.as_value() if isinstance(value, data.View) else value

    stimulus = list(stimulus)
    inputs = {name: find(name) for values in stimulus for name in values}
    signals = [find(name) for name in outputs]
    rows = []

    async def testbench(ctx):
        for values in stimulus:
            for name, value in values.items():
                ctx.set(inputs[name], value)
            rows.append((await ctx.tick().sample(*signals))[2:])

    simulate(dut, testbench, clocks=len(stimulus) + 1)
    return dict(zip(outputs, map(list, zip(*rows, strict=True)), strict=True))
