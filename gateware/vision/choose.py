"""The best candidate of a row for its peak, and the next best."""

from amaranth.hdl import Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ..layouts import FrameSettings
from .runs import Run


class Chosen(data.Struct):
    """The run that holds the row's peak, and the runner-up: its strength, and its column in halves."""

    found: 1
    run: Run
    second_found: 1
    second_strength: 20
    second_halves: 13


class Choose(wiring.Component):
    """Keeps the strongest candidate of the runs that count, the first on ties; and the next by the same rule.

    A run counts if it has enough gated pixels within reach and a width that is allowed: see
    :func:`magtrak.reference.find_runs`. Each brings its two best candidates: either may be the row's.

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
        enough, wide, narrow = Signal(), Signal(), Signal()
        better, second, both = Signal(), Signal(), Signal()
        compared = Signal()
        m.d.sync += [
            compared.eq(self.run.valid),
            enough.eq(run.gated >= self.settings.run_gated),
            wide.eq(run.width >= self.settings.run_width_min),
            narrow.eq(run.width <= self.settings.run_width_max),
            better.eq(run.strength > best.run.strength),
            second.eq(run.strength > best.second_strength),
            both.eq(run.second_found & (run.second_strength > best.run.strength)),
        ]
        with m.If(self.clear):
            m.d.sync += [best.found.eq(0), best.second_found.eq(0)]
        with m.Elif(compared & enough & wide & narrow):
            with m.If(better | ~best.found):
                m.d.sync += [
                    best.found.eq(1),
                    best.run.eq(run),
                    best.second_found.eq(best.found | run.second_found),
                ]
                with m.If(best.found & ~both):
                    m.d.sync += [
                        best.second_strength.eq(best.run.strength),
                        best.second_halves.eq(best.run.halves),
                    ]
                with m.Else():
                    m.d.sync += [
                        best.second_strength.eq(run.second_strength),
                        best.second_halves.eq(run.second_halves),
                    ]
            with m.Elif(second | ~best.second_found):
                m.d.sync += [
                    best.second_found.eq(1),
                    best.second_strength.eq(run.strength),
                    best.second_halves.eq(run.halves),
                ]
        return m
