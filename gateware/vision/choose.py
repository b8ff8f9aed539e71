"""The best run of a row, and the next best."""

from amaranth.hdl import Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ..layouts import FrameSettings
from .runs import Run


class Chosen(data.Struct):
    """The row's run and its runner-up: its sum, and the sum of its first and last column, twice its middle."""

    found: 1
    run: Run
    second_found: 1
    second_sum: 20
    second_ends: 13


class Choose(wiring.Component):
    """Keeps the strongest of the runs that count: the greatest sum, the first on ties; and the next by the same rule.

    A run counts if it has enough gated pixels within reach and a width that is allowed: see
    :func:`magtrak.reference.find_runs`.

    Members
    -------
    settings : ``run_gated``, ``run_width_min`` and ``run_width_max`` are used
    run : stream of :class:`~gateware.vision.runs.Run`, always ready; at most one in two clocks
    clear : strobe that forgets all runs, to begin a row
    o : the choice among the runs since, :attr:`latency` clocks after the last
    """

    settings: In(FrameSettings)
    run: In(stream.Signature(Run, always_ready=True))
    clear: In(1)
    o: Out(Chosen)

    latency = 2
    """Clocks from a run to the choice: compare, take."""

    def elaborate(self, platform):
        m = Module()
        run, best = self.run.p, self.o
        # Runs come at least two clocks apart, so the run still stands while it is taken, and the one before has been.
        enough, wide, narrow, better, second = Signal(), Signal(), Signal(), Signal(), Signal()
        compared = Signal()
        m.d.sync += [
            compared.eq(self.run.valid),
            enough.eq(run.gated >= self.settings.run_gated),
            wide.eq(run.width >= self.settings.run_width_min),
            narrow.eq(run.width <= self.settings.run_width_max),
            better.eq(run.sum > best.run.sum),
            second.eq(run.sum > best.second_sum),
        ]
        with m.If(self.clear):
            m.d.sync += [best.found.eq(0), best.second_found.eq(0)]
        with m.Elif(compared & enough & wide & narrow):
            with m.If(better | ~best.found):
                m.d.sync += [
                    best.found.eq(1),
                    best.run.eq(run),
                    best.second_found.eq(best.found),
                    best.second_sum.eq(best.run.sum),
                    best.second_ends.eq(best.run.first + best.run.last),
                ]
            with m.Elif(second | ~best.second_found):
                m.d.sync += [
                    best.second_found.eq(1),
                    best.second_sum.eq(run.sum),
                    best.second_ends.eq(run.first + run.last),
                ]
        return m
