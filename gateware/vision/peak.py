"""The row's record, made from what was found in it."""

from amaranth.hdl import Array, C, Cat, Const, Module, Mux, Signal, signed
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import Detector
from magtrak.protocol import Window as Span
from magtrak.reference import measure
from magtrak.reference.fir import BEND, FRACTION

from ..arithmetic import SerialDivider, below
from ..layouts import FrameSettings, RowResult
from .choose import Rival
from .runs import Crossing, Run, assign
from .spread import Gated

FRACTION_BITS = (FRACTION - 1).bit_length()


class Peak(wiring.Component):
    """Divides, and writes the record, as :func:`magtrak.reference.measure` defines it.

    Two serial dividers work at once, one on the position (in 1/512 px, then rounded), one on the runner-up: its ratio
    first, then its place. A row that ends while they are at work breaks the camera's contract: its record comes after
    that of the one before, without a position, and with ``overflow``. (Of two such rows only the last has one.)

    Parameters
    ----------
    max_columns : columns of an image, 2 to 2048
    window_latency : clocks from ``taken`` to ``window_position``; 0: there is no window, all is of the run

    Members
    -------
    settings : the detector, and what cut and ambiguous depend on, are used
    ends : strobe, the row is whole in the next clock, ``end``
    found, chosen, numerator, divisor, other_found, other, gated : what was found in it, valid with ``end``; of the
        quotients of ``gated`` and of what is chosen, one is 0
    taken : strobe: the row is measured
    window_position, window_some, window_whole : of the window that was begun at ``taken``
    o : stream of :class:`~gateware.layouts.RowResult`, always ready, :attr:`latency` clocks after ``end``
    """

    def __init__(self, max_columns: int, window_latency: int) -> None:
        if not 2 <= max_columns <= 2048:
            raise ValueError(f"max_columns is {max_columns}; 2 to 2048 are possible")
        self.max_columns = max_columns
        self.window_latency = window_latency
        self._position = SerialDivider(20, (max_columns - 1).bit_length() + FRACTION_BITS)
        self._rival = SerialDivider(20, FRACTION_BITS)
        super().__init__(
            {
                "settings": In(FrameSettings),
                "ends": In(1),
                "found": In(1),
                "chosen": In(Run()),
                "numerator": In(30),
                "divisor": In(20),
                "other_found": In(1),
                "other": In(Rival()),
                "gated": In(Gated),
                "taken": Out(1),
                "window_position": In(20),
                "window_some": In(1),
                "window_whole": In(1),
                "o": Out(stream.Signature(RowResult, always_ready=True)),
            }
        )

    reference = staticmethod(measure)

    @property
    def latency(self) -> int:
        """Clocks from ``end`` to the record: the longest way and one to write. Dividing comes first on the one way;
        choosing the runner-up and two quotients on the other; then both are placed, one after the other.
        """
        return self._place_clock + 5

    @property
    def _place_clock(self) -> int:
        """Clocks from ``end`` to the position's quotient, and to one before the runner-up's."""
        return max(self._position.latency, 2 + 2 * self._rival.latency - 1)

    def elaborate(self, platform):
        assert self.window_latency < self.latency
        m = Module()
        m.submodules.position = position = self._position
        m.submodules.rival = rival_divider = self._rival

        # A row that ends while the one before is at work is not measured: its record only says so.
        busy = Signal()
        written = Signal()
        late = Signal()
        late_row = Signal(12)
        end = Signal()
        m.d.sync += [end.eq(self.ends), self.taken.eq(self.ends & ~self.taken & (~busy | written))]
        with m.If(self.taken):
            m.d.sync += busy.eq(1)
        with m.Elif(written):
            m.d.sync += busy.eq(0)
        with m.If(end & ~self.taken):
            m.d.sync += [late.eq(1), late_row.eq(self.gated.row)]
        with m.Elif(~busy):
            m.d.sync += late.eq(0)
        steps = Signal(self.latency - 1)
        m.d.sync += steps.eq(Cat(self.taken, steps))

        found = Signal()
        own = Signal()
        other_found = Signal()
        run = Run().create(path=("run",))
        other = Rival().create(path=("other",))
        gated = Signal(Gated, reset_less=True)
        with m.If(self.taken):
            m.d.sync += [
                found.eq(self.found),
                other_found.eq(self.found & self.other_found),
                own.eq(
                    self.chosen.second_found
                    & (~self.other_found | ~below(self.chosen.second_contrast, self.other.strength))
                ),
                *assign(run, self.chosen, Run()),
                *assign(other, self.other, Rival()),
                gated.eq(self.gated),
            ]
        detector = self.settings.detector
        binary = Signal()
        by_run = Signal()
        by_window = Signal()
        maximum = Signal()
        centroid = detector == Detector.CENTROID
        of_run = (self.settings.centroid_window == Span.RUN) if self.window_latency else C(1, 1)
        m.d.sync += [
            binary.eq(detector == Detector.BINARY),
            by_run.eq(centroid & of_run),
            by_window.eq(centroid & ~of_run),
            maximum.eq(detector == Detector.MAXIMUM),
        ]

        # The position's quotient fits: a mean is less than max_columns, a rise less than its contrast.
        m.d.comb += [
            position.start.eq(self.taken),
            position.dividend.eq((self.numerator | self.gated.numerator) << FRACTION_BITS),
            position.divisor.eq(self.divisor | self.gated.divisor),
        ]
        # The runner-up: chosen, compared, placed.
        rival = Rival().create(path=("rival",))
        rivals = Signal()
        as_strong = Signal()
        ratio = Signal(8, init=255)
        with m.If(steps[0]):
            m.d.sync += rivals.eq(own | other_found)
            with m.If(own):
                m.d.sync += [
                    rival.crossed.eq(1),
                    rival.strength.eq(run.second_contrast),
                    *assign(rival.crossing, run.second, Crossing()),
                ]
            with m.Else():
                m.d.sync += assign(rival, other, Rival())
        with m.If(steps[1]):
            m.d.sync += as_strong.eq(~below(rival.strength, run.strength))
        compared = steps[1 + rival_divider.latency]
        with m.If(compared):
            m.d.sync += ratio.eq(Mux(as_strong, 255, rival_divider.quotient >> 1))
        m.d.comb += [
            rival_divider.start.eq(steps[1] | compared),
            rival_divider.dividend.eq(Mux(steps[1], rival.strength, rival.crossing.rise) << FRACTION_BITS),
            rival_divider.divisor.eq(Mux(steps[1], run.strength, rival.strength)),
        ]
        # The position, then the runner-up a clock later: pick, straighten, add. Nothing here moves but while a row is
        # at work, which spares a simulation the rest of the time.
        of_rival = Signal()
        tops = Signal(13, reset_less=True)  # of the run's greatest weights, in halves
        base = Signal(13, reset_less=True)
        base_held = Signal(13, reset_less=True)
        part = Signal(FRACTION_BITS, reset_less=True)
        whole = Signal()
        # No share of a column counts: the line is in the middle, or it is not the crossing's.
        middle, rival_middle = Signal(), Signal()
        run_bends, rival_bends = Signal(), Signal()
        addend = Signal(signed(position.quotient_bits + 2), reset_less=True)
        fine = Signal(21, reset_less=True)
        fine_before = Signal(21, reset_less=True)
        # How far a share is bent is looked up with its last bit still to come.
        bends = Array(Const(-value, signed(4)) for value in BEND)
        bend = Signal(signed(4), reset_less=True)
        bend_of = []
        for name, divider in (("position", position), ("rival", rival_divider)):
            looked_up = Signal(signed(4), name=f"bend_{name}", reset_less=True)
            with m.If(divider.busy):
                m.d.sync += looked_up.eq(bends[divider.quotient[FRACTION_BITS - 6 : FRACTION_BITS - 1]])
            bend_of.append(looked_up)
        with m.If(busy):
            m.d.sync += [
                of_rival.eq(steps[self._place_clock - 1]),
                tops.eq(run.peak_first + run.peak_last),
                middle.eq(run.crossing.single | ~run.crossed | by_window | maximum),
                run_bends.eq(run.crossing.straight & run.crossed & ~by_window & ~maximum),
                rival_middle.eq(rival.crossing.single | ~rival.crossed),
                rival_bends.eq(rival.crossing.straight & rival.crossed),
            ]
            with m.If(of_rival):
                m.d.sync += [
                    base.eq(rival.crossing.halves),
                    part.eq(Mux(rival_middle, FRACTION // 2, rival_divider.quotient)),
                    whole.eq(0),
                    bend.eq(Mux(rival_bends, bend_of[1], 0)),
                ]
            with m.Else():
                m.d.sync += [
                    part.eq(Mux(middle, FRACTION // 2, position.quotient)),
                    whole.eq(binary | by_run),
                    bend.eq(Mux(run_bends, bend_of[0], 0)),
                ]
                with m.If(binary):
                    m.d.sync += base.eq(0)
                with m.Elif(by_run):
                    m.d.sync += base.eq(run.last << 1)
                with m.Elif(maximum):
                    m.d.sync += base.eq(tops)
                with m.Else():  # with a window where nothing rose above its base
                    m.d.sync += base.eq(run.crossing.halves)
            with m.If(whole):  # -quotient - 1 with the run's centroid: a unit is added below
                m.d.sync += addend.eq((Cat(position.quotient, C(0, 1)) ^ by_run.replicate(len(addend))).as_signed())
            with m.Else():
                m.d.sync += addend.eq(_straighten(part, bend))
            m.d.sync += [
                base_held.eq(base),
                # And one unit more, to round half up.
                fine.eq((Cat(C(1, 1), base_held << (FRACTION_BITS - 1)) + Cat(C(1, 1), addend).as_signed()) >> 1),
                fine_before.eq(fine),
            ]

        # Flags, while the dividers work.
        cut = Signal()
        span = Signal(12)
        enough = Signal()
        stray = Signal()
        doubtful = Signal()
        competed = Signal()
        valid = Signal()
        with m.If(busy):
            m.d.sync += [
                cut.eq(Mux(binary, gated.first_touches | gated.last_touches, run.touches | run.over | ~run.crossed)),
                span.eq(gated.last - gated.before),
                enough.eq((gated.total >= self.settings.run_gated) & gated.total.any()),
                stray.eq(found & (gated.total > (run.gated << 1))),
                doubtful.eq(Mux(binary, span > self.settings.run_width_max, run.crossed & ~run.coloured)),
                competed.eq(found & rivals & (ratio >= self.settings.ambiguous_ratio)),
                valid.eq(Mux(binary, enough, found)),
            ]
        in_window = Signal()
        no_window = Signal()
        clipped_window = Signal()
        m.d.comb += [
            in_window.eq(by_window & self.window_some),
            no_window.eq(by_window & ~self.window_some),
            clipped_window.eq(by_window & ~self.window_whole),
        ]

        # Write.
        record = self.o.p.record
        writes = Signal()
        writes_run = Signal()
        writes_rival = Signal()
        m.d.sync += [
            writes.eq(steps[-2] & valid),
            writes_run.eq(steps[-2] & valid & found),
            writes_rival.eq(steps[-2] & valid & found & rivals),
        ]
        m.d.sync += [written.eq(steps[-1]), self.o.valid.eq(steps[-1] | (late & ~busy))]
        # All is 0 a clock before, by the registers' reset, which spares an AND at each bit.
        with m.If((late & ~busy) | steps[-2]):
            m.d.sync += record.eq(0)
        with m.Elif(writes):
            m.d.sync += [
                record.valid.eq(1),
                record.position.eq(Mux(in_window, self.window_position, fine_before >> 1)),
                record.cut.eq(cut | clipped_window),
                record.ambiguous.eq(stray | doubtful | competed | no_window),
                record.width.eq(Mux(found, run.width, span)),
                record.gated.eq(Mux(found, run.gated, gated.total)),
            ]
            with m.If(writes_run):
                m.d.sync += [
                    record.saturated.eq(run.clipped.any()),
                    record.sum.eq(run.sum),
                    record.peak.eq(run.peak),
                    record.clipped.eq(run.clipped),
                    record.second_valid.eq(rivals),
                ]
            with m.If(writes_rival):
                m.d.sync += [record.second_position.eq(fine >> 1), record.runner_up.eq(ratio)]
        with m.If(late & ~busy):
            m.d.sync += [self.o.p.row.eq(late_row), record.overflow.eq(1)]
        with m.If(steps[-1]):
            m.d.sync += [self.o.p.row.eq(gated.row), record.overflow.eq(gated.fault)]
        return m


def _straighten(part, bend):
    """What a crossing adds to the middle between its columns, in 1/512 px.

    See :func:`magtrak.reference.fir.position`; ``part`` is the share on a straight line, or a half where there is none,
    ``bend`` what is added to it.
    """
    share = (part + bend)[:FRACTION_BITS]
    # Half a column less, the middle's.
    return Cat(share[:-1], ~share[-1], ~share[-1]).as_signed()
