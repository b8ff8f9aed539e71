"""Runs of lit pixels, each with its two best candidates for the row's peak."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import Detector
from magtrak.reference import find_runs
from magtrak.reference.fir import CONTRAST_MAX, DERIVATIVE_MAX

from ..layouts import FrameSettings
from .fir import Fir
from .lookahead import Column

SLOPE_BITS = DERIVATIVE_MAX.bit_length()
CONTRAST_BITS = CONTRAST_MAX.bit_length()


class Crossing(data.Struct):
    """A zero crossing of the derivative: see :class:`magtrak.reference.fir.Crossings`.

    ``halves`` is the sum of ``before`` and ``after``. ``straight``: no column between is exactly zero; ``single``: one.
    ``coloured``: enough gated pixels lie within reach of ``after``.
    """

    before: 12
    after: 12
    halves: 13
    straight: 1
    single: 1
    coloured: 1
    rise: SLOPE_BITS
    contrast: CONTRAST_BITS


class Run(data.Struct):
    """A run of lit pixels: see :class:`magtrak.reference.Runs`.

    ``crossed``: ``crossing`` holds the one of the greatest contrast. ``strength`` and ``halves`` are those of the best
    candidate for the row's peak, ``second_`` those of the next best. See :func:`magtrak.reference.measure`.
    """

    first: 12
    last: 12
    width: 12
    sum: 20
    peak: 8
    gated: 12
    clipped: 12
    crossed: 1
    crossing: Crossing
    strength: 20
    halves: 13
    second_found: 1
    second_strength: CONTRAST_BITS
    second_halves: 13


class Runs(wiring.Component):
    """Finds the runs of a row as :func:`magtrak.reference.find_runs` does, and the best crossings of each.

    Takes a column a clock. A run is out at most :attr:`latency` clocks after the column that ends it: the one after the
    gap that may be bridged, or the row's last. Runs are out at least two clocks apart. Nothing overflows: 2048 columns
    of weight 255 sum up to less than 2**19.

    Members
    -------
    settings : ``run_bridge``, ``run_gated`` and ``detector`` are used
    column : stream of :class:`~gateware.vision.lookahead.Column`, always ready
    falls, distance, rise, contrast : crossing at that column, from :class:`~gateware.vision.fir.Fir`
    o : stream of :class:`Run`, always ready; whether the run counts is not decided here
    """

    settings: In(FrameSettings)
    column: In(stream.Signature(Column, always_ready=True))
    falls: In(1)
    distance: In(12)
    rise: In(SLOPE_BITS)
    contrast: In(CONTRAST_BITS)
    o: Out(stream.Signature(Run, always_ready=True))

    reference = staticmethod(find_runs)

    latency = 4
    """Clocks from the row's last column to its last run: decide, add up, hold, and one more if that column is lit: a
    run may have ended with the column before, and runs stay two clocks apart."""

    def elaborate(self, platform):
        m = Module()
        i, valid = self.column.p, self.column.valid

        # 1: what this column is to the run
        is_open, gap = Signal(), Signal(4)
        was_open, within, closes = Signal(), Signal(), Signal()
        m.d.comb += [
            was_open.eq(is_open & ~i.row_first),
            within.eq(was_open | i.lit),
            closes.eq(within & (i.row_last | (~i.lit & (gap == self.settings.run_bridge)))),
        ]
        # At most 31 pixels lie within reach of a column: the low bits of the difference tell all.
        near = Signal(5)
        m.d.comb += near.eq(i.ahead[:5] - i.behind[:5])
        run = Signal(Run, reset_less=True)
        better, second = Signal(reset_less=True), Signal(reset_less=True)
        starts, extends, closed, crosses = Signal(), Signal(), Signal(), Signal()
        at, weight, saturated = Signal(12, reset_less=True), Signal(8, reset_less=True), Signal(reset_less=True)
        ahead, behind = Signal(12, reset_less=True), Signal(12, reset_less=True)
        crossing = Signal(Crossing, reset_less=True)
        closed_lit = Signal()
        m.d.sync += [starts.eq(0), extends.eq(0), closed.eq(0), closed_lit.eq(0), crosses.eq(0)]
        with m.If(valid):
            m.d.sync += [
                is_open.eq(within & ~closes),
                gap.eq(Mux(i.lit, 0, gap + 1)),
                starts.eq(i.lit & ~was_open),
                extends.eq(i.lit & was_open),
                closed.eq(closes & ~i.lit),
                closed_lit.eq(closes & i.lit),
                crosses.eq(within & self.falls),
            ]
        m.d.sync += [
            at.eq(i.column),
            weight.eq(i.weight),
            saturated.eq(i.saturated),
            ahead.eq(i.ahead),
            behind.eq(i.behind),
            crossing.before.eq(i.column - self.distance),
            crossing.after.eq(i.column),
            crossing.halves.eq((i.column << 1) - self.distance),
            crossing.straight.eq(self.distance == 1),
            crossing.single.eq(self.distance == 2),
            crossing.coloured.eq(near >= self.settings.run_gated),
            crossing.rise.eq(self.rise),
            crossing.contrast.eq(self.contrast),
            # Crossings are at least two columns apart, so the one before has been taken by now.
            better.eq(self.contrast > run.crossing.contrast),
            second.eq(self.contrast > run.second_strength),
        ]

        # 2: add up
        low = Signal(12, reset_less=True)
        high = Signal(12, reset_less=True)
        with m.If(starts):
            m.d.sync += [
                run.first.eq(at),
                run.last.eq(at),
                run.sum.eq(weight),
                run.peak.eq(weight),
                run.clipped.eq(saturated),
                run.crossed.eq(crosses),
                run.second_found.eq(0),
                low.eq(behind),
                high.eq(ahead),
            ]
        with m.Else():
            with m.If(extends):
                m.d.sync += [
                    run.last.eq(at),
                    run.sum.eq(run.sum + weight),
                    run.peak.eq(Mux(weight > run.peak, weight, run.peak)),
                    run.clipped.eq(run.clipped + saturated),
                    high.eq(ahead),
                ]
            with m.If(crosses):
                m.d.sync += [run.crossed.eq(1), run.second_found.eq(run.crossed)]
        with m.If(crosses & (starts | ~run.crossed | better)):
            m.d.sync += [
                run.crossing.eq(crossing),
                run.second_strength.eq(run.crossing.contrast),
                run.second_halves.eq(run.crossing.halves),
            ]
        with m.Elif(crosses & (~run.second_found | second)):
            m.d.sync += [run.second_strength.eq(crossing.contrast), run.second_halves.eq(crossing.halves)]
        ended, waited = Signal(), Signal()
        m.d.sync += [waited.eq(closed_lit), ended.eq(closed | waited)]

        # 3: hold, while the next run adds up
        binary = Signal()
        m.d.sync += [binary.eq(self.settings.detector == Detector.BINARY), self.o.valid.eq(ended)]
        with m.If(ended):
            m.d.sync += [
                self.o.p.eq(run),
                self.o.p.width.eq(run.last - run.first + 1),
                self.o.p.gated.eq(high - low),
                self.o.p.strength.eq(Mux(binary, run.sum, Mux(run.crossed, run.crossing.contrast, 0))),
                self.o.p.halves.eq(Mux(binary | ~run.crossed, run.first + run.last, run.crossing.halves)),
                self.o.p.second_found.eq(run.second_found & ~binary),
            ]
        return m


def connect_fir(m: Module, fir: Fir, runs: Runs) -> None:
    """The crossing beside each column."""
    for name in ("falls", "distance", "rise", "contrast"):
        m.d.comb += getattr(runs, name).eq(getattr(fir, name))
