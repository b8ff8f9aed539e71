"""Runs of lit pixels, each with its two best zero crossings."""

from operator import ge, gt

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import Detector
from magtrak.reference import find_runs
from magtrak.reference.fir import CONTRAST_MAX, DERIVATIVE_MAX

from ..arithmetic import below
from ..layouts import FrameSettings
from .lookahead import Column

SLOPE_BITS = DERIVATIVE_MAX.bit_length()
CONTRAST_BITS = CONTRAST_MAX.bit_length()


class Crossing(wiring.Signature):
    """What is needed to place a zero crossing: see :class:`magtrak.reference.fir.Crossings`.

    Each field is a signal of its own, here and in :class:`Run`: of one record of 300 bits a simulation would move ten
    words at every change of a bit.

    Members
    -------
    halves : sum of the columns before and after
    straight, single : no column between them is exactly zero; one is
    rise : the derivative before
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "halves": Out(13),
                "straight": Out(1),
                "single": Out(1),
                "rise": Out(SLOPE_BITS),
            }
        )


class Run(wiring.Signature):
    """A run of lit pixels: see :class:`magtrak.reference.Runs`.

    Members
    -------
    first, last, width, sum, peak, moment, peak_first, peak_last, clipped, gated : as there
    crossed : there is a crossing in it; else ``crossing.halves`` is its middle
    crossing : the one of the greatest contrast: ``rise`` and the magnitude of the derivative after
    strength : its contrast, or 0; with ``binary`` the run's sum
    centre : nearest column to the crossing, or middle
    away : columns from ``centre`` to where the line was in the row before
    coloured : enough gated pixels lie within reach of the crossing
    over : the filter at the crossing reaches over the border of the image
    touches : it begins or ends at the border of the image or of the region
    second_found, second, second_contrast : the next best crossing
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "first": Out(12),
                "last": Out(12),
                "width": Out(12),
                "sum": Out(20),
                "peak": Out(8),
                "moment": Out(30),
                "peak_first": Out(12),
                "peak_last": Out(12),
                "clipped": Out(12),
                "gated": Out(12),
                "crossed": Out(1),
                "crossing": Out(Crossing()),
                "strength": Out(20),
                "centre": Out(12),
                "away": Out(12),
                "coloured": Out(1),
                "over": Out(1),
                "touches": Out(1),
                "second_found": Out(1),
                "second": Out(Crossing()),
                "second_contrast": Out(CONTRAST_BITS),
            }
        )


def assign(target, source, signature: wiring.Signature, *, leave: tuple[str, ...] = ()) -> list:
    """Statements that take all members of ``source``, nested ones as well, but those named in ``leave``."""
    statements = []
    for name, member in signature.members.items():
        if name in leave:
            continue
        inner, outer = getattr(source, name), getattr(target, name)
        statements += [outer.eq(inner)] if member.is_port else assign(outer, inner, member.signature)
    return statements


class Runs(wiring.Component):
    """Finds the runs of a row as :func:`magtrak.reference.find_runs` does, and the best crossings of each.

    Takes a column a clock. A run is out at most :attr:`latency` clocks after the column that ends it: the one after the
    gap that may be bridged, or the row's last. Runs are out at least two clocks apart. Nothing overflows: 2048 columns
    of weight 255 sum up to less than 2**19, their moment to less than 2**30.

    The moment comes without a multiplier: each column adds the sum so far to it, so each weight is added once for every
    column that follows (double accumulation).

    Members
    -------
    settings : ``run_bridge``, ``run_gated`` and ``detector`` are used
    column : stream of :class:`~gateware.vision.lookahead.Column`, always ready
    falls, distance, rise, contrast, near_first, late : crossing at that column, from :class:`~gateware.vision.fir.Fir`
    before, left_edge, right_edge, near_last : of that column, from :class:`~gateware.vision.lookahead.Lookahead`
    place : column of the line in the row before
    valid, o : a :class:`Run`, which stands until the next; whether it counts is not decided here
    """

    settings: In(FrameSettings)
    column: In(stream.Signature(Column, always_ready=True))
    falls: In(1)
    distance: In(12)
    rise: In(SLOPE_BITS)
    contrast: In(CONTRAST_BITS)
    near_first: In(1)
    late: In(1)
    before: In(12)
    left_edge: In(1)
    right_edge: In(1)
    near_last: In(1)
    place: In(12)
    valid: Out(1)
    o: Out(Run())

    reference = staticmethod(find_runs)

    latency = 4
    """Clocks from the row's last column to its last run: decide, add up, hold, and one more if that column is lit: a
    run may have ended with the column before, and runs stay two clocks apart."""

    def elaborate(self, platform):
        m = Module()
        i, valid = self.column.p, self.column.valid

        # 1: what this column is to the run
        is_open = Signal()
        gap = Signal(4)
        was_open = Signal()
        within = Signal()
        closes = Signal()
        m.d.comb += [
            was_open.eq(is_open & ~i.row_first),
            within.eq(was_open | i.lit),
            closes.eq(within & (i.row_last | (~i.lit & (gap == self.settings.run_bridge)))),
        ]
        # At most 31 pixels lie within reach of a column: the low bits of the difference tell all.
        near = Signal(5)
        m.d.comb += near.eq(i.ahead[:5] - i.behind[:5])
        run = Run().create(path=("run",))
        crossing = Crossing().create(path=("crossing",))
        contrast = Signal(CONTRAST_BITS, reset_less=True)
        greatest = Signal(CONTRAST_BITS, reset_less=True)
        centre = Signal(12, reset_less=True)
        coloured = Signal(reset_less=True)
        over = Signal(reset_less=True)
        at_left = Signal(reset_less=True)
        at_right = Signal(reset_less=True)
        touches_left = Signal(reset_less=True)
        touches_right = Signal(reset_less=True)
        better = Signal(reset_less=True)
        second = Signal(reset_less=True)
        starts = Signal()
        extends = Signal()
        passes = Signal()
        closed = Signal()
        closed_lit = Signal()
        crosses = Signal()
        at = Signal(12, reset_less=True)
        at_before = Signal(12, reset_less=True)
        weight = Signal(8, reset_less=True)
        saturated = Signal(reset_less=True)
        ahead = Signal(12, reset_less=True)
        behind = Signal(12, reset_less=True)
        doubled = Signal(13)
        m.d.comb += doubled.eq(Cat(self.late, i.column) - self.distance)
        m.d.sync += [
            starts.eq(valid & i.lit & ~was_open),
            extends.eq(valid & i.lit & was_open),
            passes.eq(valid & ~i.lit & was_open),
            closed.eq(valid & closes & ~i.lit),
            closed_lit.eq(valid & closes & i.lit),
            crosses.eq(valid & within & self.falls),
        ]
        with m.If(valid):
            m.d.sync += [
                is_open.eq(within & ~closes),
                gap.eq(Mux(i.lit, 0, gap + 1)),
                at.eq(i.column),
                at_before.eq(self.before),
                weight.eq(i.weight),
                saturated.eq(i.saturated),
                at_left.eq(self.left_edge),
                at_right.eq(self.right_edge),
                ahead.eq(i.ahead),
                behind.eq(i.behind),
            ]
        with m.If(self.falls):
            m.d.sync += [
                crossing.halves.eq((i.column << 1) - self.distance),
                crossing.straight.eq(self.distance == 1),
                crossing.single.eq(self.distance == 2),
                crossing.rise.eq(self.rise),
                contrast.eq(self.contrast),
                centre.eq(doubled >> 1),
                over.eq(self.near_first | self.near_last),
                coloured.eq(near >= self.settings.run_gated),
                # Crossings are at least two columns apart, so the one before has been taken by now.
                better.eq(below(greatest, self.contrast)),
                second.eq(below(run.second_contrast, self.contrast)),
            ]

        # 2: add up
        run_before = Signal(12, reset_less=True)
        low = Signal(12, reset_less=True)
        high = Signal(12, reset_less=True)
        swept = Signal(30, reset_less=True)  # the moment about the present column
        middle = Signal(13, reset_less=True)  # in halves
        # How far they stand behind the place, modulo 4096, and whether they stand before it. A run ends at the
        # earliest two clocks after its last lit column was added, so the middle has been still for a clock by then.
        middle_away = Signal(12, reset_less=True)
        centre_away = Signal(12, reset_less=True)
        middle_short = Signal(reset_less=True)
        centre_short = Signal(reset_less=True)

        def beyond_place(column, away, short):
            beyond = (column - self.place)[:13]
            return [away.eq(beyond[:12]), short.eq(beyond[12])]

        moment = Signal(30)
        m.d.comb += moment.eq(swept + run.sum)
        with m.If(starts):
            m.d.sync += [
                run.first.eq(at),
                run_before.eq(at_before),
                run.last.eq(at),
                middle.eq(at << 1),
                run.sum.eq(weight),
                run.moment.eq(0),
                swept.eq(0),
                run.clipped.eq(saturated),
                touches_left.eq(at_left),
                touches_right.eq(at_right),
                run.crossed.eq(crosses),
                run.second_found.eq(0),
                low.eq(behind),
                high.eq(ahead),
            ]
        with m.Else():
            with m.If(extends):
                m.d.sync += [
                    run.last.eq(at),
                    middle.eq(run.first + at),
                    run.sum.eq(run.sum + weight),
                    run.moment.eq(moment),
                    swept.eq(moment),
                    run.clipped.eq(run.clipped + saturated),
                    touches_right.eq(at_right),
                    high.eq(ahead),
                ]
            with m.If(passes):
                m.d.sync += swept.eq(moment)
            with m.If(crosses):
                m.d.sync += [run.crossed.eq(1), run.second_found.eq(run.crossed)]
        with m.If(crosses):
            with m.If(starts | ~run.crossed | better):
                m.d.sync += [
                    *assign(run.crossing, crossing, Crossing()),
                    greatest.eq(contrast),
                    run.centre.eq(centre),
                    *beyond_place(centre, centre_away, centre_short),
                    run.over.eq(over),
                    run.coloured.eq(coloured),
                    *assign(run.second, run.crossing, Crossing()),
                    run.second_contrast.eq(greatest),
                ]
            with m.Elif(~run.second_found | second):
                m.d.sync += [*assign(run.second, crossing, Crossing()), run.second_contrast.eq(contrast)]
        self._top(m, run, starts, extends, weight, at)
        ended = Signal()
        waited = Signal()
        m.d.sync += [waited.eq(closed_lit), ended.eq(closed | waited)]

        # 3: hold, while the next run adds up
        binary = Signal()
        between = Signal()  # `binary` or not `run.crossed`
        short = Signal()
        m.d.sync += [
            binary.eq(self.settings.detector == Detector.BINARY),
            self.valid.eq(ended),
            between.eq(binary | ~Mux(starts, crosses, run.crossed | crosses)),
        ]
        m.d.comb += [
            short.eq(Mux(between, middle_short, centre_short)),
        ]
        m.d.sync += beyond_place(middle >> 1, middle_away, middle_short)
        derived = ("width", "gated", "strength", "centre", "away", "touches", "crossing")
        with m.If(ended):
            m.d.sync += [
                *assign(self.o, run, Run(), leave=derived),
                *assign(self.o.crossing, run.crossing, Crossing(), leave=("halves",)),
                self.o.crossed.eq(~between),
                self.o.touches.eq(touches_left | touches_right),
                self.o.width.eq(run.last - run_before),
                self.o.gated.eq(high - low),
                self.o.strength.eq(Mux(binary, run.sum, Mux(between, 0, greatest))),
                self.o.crossing.halves.eq(Mux(between, middle, run.crossing.halves)),
                self.o.centre.eq(Mux(between, middle >> 1, run.centre)),
                self.o.away.eq((Mux(between, middle_away, centre_away) ^ short.replicate(12)) + short),
                self.o.second_found.eq(run.second_found & ~between),
            ]
        return m

    @staticmethod
    def _top(m: Module, run, starts, extends, weight, at) -> None:
        """The run's greatest weight, a clock later than all else of it, which is held no sooner than that.

        Each weight is compared a clock ahead, with the greatest one and with the weight before it, which may be that by
        then.
        """
        weight_before = Signal(8, reset_less=True)
        at_before = Signal(12, reset_less=True)
        replaced = Signal()
        reaches = Signal()
        exceeds = Signal()
        for result, compare in ((reaches, ge), (exceeds, gt)):
            of_greatest, of_before = Signal(), Signal()
            m.d.sync += [
                of_greatest.eq(starts | (extends & compare(weight, run.peak))),
                of_before.eq(starts | (extends & compare(weight, weight_before))),
            ]
            m.d.comb += result.eq(Mux(replaced, of_before, of_greatest))
        m.d.sync += [weight_before.eq(weight), at_before.eq(at), replaced.eq(reaches)]
        with m.If(reaches):
            m.d.sync += [run.peak.eq(weight_before), run.peak_last.eq(at_before)]
        with m.If(exceeds):
            m.d.sync += run.peak_first.eq(at_before)


def connect_fir(m: Module, fir, runs: Runs) -> None:
    """The crossing beside each column, from :class:`~gateware.vision.fir.Fir`."""
    for name in ("falls", "distance", "rise", "contrast", "near_first", "late"):
        m.d.comb += getattr(runs, name).eq(getattr(fir, name))
