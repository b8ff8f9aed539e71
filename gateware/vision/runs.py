"""Runs of lit pixels, each with its zero crossing."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.reference import find_runs
from magtrak.reference.fir import DERIVATIVE_MAX, INTENSITY_MAX

from ..layouts import FrameSettings
from .fir import Fir
from .lookahead import Column

SLOPE_BITS = DERIVATIVE_MAX.bit_length()


class Crossing(data.Struct):
    """A zero crossing of the derivative: see :class:`magtrak.reference.fir.Crossings`.

    ``chord`` is the sum of ``rise`` and ``fall``, ``zeros`` the columns between that are exactly zero.
    """

    before: 12
    after: 12
    zeros: 12
    rise: SLOPE_BITS
    chord: SLOPE_BITS + 1


class Run(data.Struct):
    """A run of lit pixels: see :class:`magtrak.reference.Runs`.

    ``crossed``: ``crossing`` holds one. ``coloured``: gated pixels lie near it. ``plain``: none lie near the one of
    the greatest intensity. See :func:`magtrak.reference.measure`.
    """

    first: 12
    last: 12
    width: 12
    sum: 20
    peak: 8
    gated: 12
    clipped: 12
    crossed: 1
    coloured: 1
    plain: 1
    crossing: Crossing


class Runs(wiring.Component):
    """Finds the runs of a row as :func:`magtrak.reference.find_runs` does, and the crossing of each.

    Takes a column a clock. A run is out at most :attr:`latency` clocks after the column that ends it: the one after the
    gap that may be bridged, or the row's last. Runs are out at least two clocks apart. Nothing overflows: 2048 columns
    of weight 255 sum up to less than 2**19.

    Members
    -------
    settings : ``run_bridge`` and ``run_gated`` are used
    column : stream of :class:`~gateware.vision.lookahead.Column`, always ready
    falls, distance, rise, fall, intensity : crossing at that column, from :class:`~gateware.vision.fir.Fir`
    o : stream of :class:`Run`, always ready; whether the run counts is not decided here
    """

    settings: In(FrameSettings)
    column: In(stream.Signature(Column, always_ready=True))
    falls: In(1)
    distance: In(12)
    rise: In(SLOPE_BITS)
    fall: In(SLOPE_BITS)
    intensity: In(signed(INTENSITY_MAX.bit_length() + 1))
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
        near, coloured = Signal(5), Signal(reset_less=True)
        m.d.comb += near.eq(i.ahead[:5] - i.behind[:5])
        best_intensity = Signal(self.intensity.shape(), reset_less=True)
        top_intensity = Signal(self.intensity.shape(), reset_less=True)
        higher, highest = Signal(reset_less=True), Signal(reset_less=True)
        starts, extends, closed, crosses = Signal(), Signal(), Signal(), Signal()
        at, weight, saturated = Signal(12, reset_less=True), Signal(8, reset_less=True), Signal(reset_less=True)
        ahead, behind = Signal(12, reset_less=True), Signal(12, reset_less=True)
        crossing = Signal(Crossing, reset_less=True)
        intensity = Signal(self.intensity.shape(), reset_less=True)
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
            crossing.zeros.eq(self.distance - 1),
            crossing.rise.eq(self.rise),
            crossing.chord.eq(self.rise + self.fall),
            intensity.eq(self.intensity),
            # Crossings are at least two columns apart, so the one before has been taken by now.
            higher.eq(self.intensity > best_intensity),
            highest.eq(self.intensity > top_intensity),
            coloured.eq(near >= self.settings.run_gated),
        ]

        # 2: add up
        run = Signal(Run, reset_less=True)
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
                m.d.sync += run.crossed.eq(1)
        first_one = starts | ~run.crossed
        with m.If(crosses & (first_one | (coloured & ~run.coloured) | ((coloured == run.coloured) & higher))):
            m.d.sync += [run.crossing.eq(crossing), run.coloured.eq(coloured), best_intensity.eq(intensity)]
        with m.If(crosses & (first_one | highest)):
            m.d.sync += [run.plain.eq(~coloured), top_intensity.eq(intensity)]
        ended, waited = Signal(), Signal()
        m.d.sync += [waited.eq(closed_lit), ended.eq(closed | waited)]

        # 3: hold, while the next run adds up
        m.d.sync += self.o.valid.eq(ended)
        with m.If(ended):
            m.d.sync += [
                self.o.p.eq(run),
                self.o.p.width.eq(run.last - run.first + 1),
                self.o.p.gated.eq(high - low),
            ]
        return m


def connect_fir(m: Module, fir: Fir, runs: Runs) -> None:
    """The crossing beside each column."""
    for name in ("falls", "distance", "rise", "fall", "intensity"):
        m.d.comb += getattr(runs, name).eq(getattr(fir, name))
