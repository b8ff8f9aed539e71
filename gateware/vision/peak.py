"""The row's record, made from what was found in it."""

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal, signed
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import Detector
from magtrak.reference import measure
from magtrak.reference.fir import BEND, FRACTION, REACH

from ..arithmetic import SerialDivider, delayed
from ..layouts import FrameSettings, Row, RowResult
from .choose import Chosen
from .spread import Gated

FRACTION_BITS = (FRACTION - 1).bit_length()


class Peak(wiring.Component):
    """Divides, and writes the record, as :func:`magtrak.reference.measure` defines it.

    Two serial dividers work at once, one on the position (in 1/512 px, then rounded), one on the runner-up's ratio. A
    row that ends while they are at work waits, up to 9 clocks; it can only be shorter than the one before, which breaks
    the camera's contract.

    Parameters
    ----------
    max_columns : columns of an image, 2 to 2048

    Members
    -------
    settings : the detector, and what cut and ambiguous depend on, are used
    end : strobe, ``chosen`` and ``gated`` hold the whole row
    chosen, gated : what was found; they have to stand until ``taken``
    taken : strobe
    o : stream of :class:`~gateware.layouts.RowResult`, always ready, :attr:`latency` clocks after ``end``
    """

    def __init__(self, max_columns: int = 2048) -> None:
        if not 2 <= max_columns <= 2048:
            raise ValueError(f"max_columns is {max_columns}; 2 to 2048 are possible")
        self.max_columns = max_columns
        self._position = SerialDivider(16, (max_columns - 1).bit_length() + FRACTION_BITS)
        super().__init__(
            {
                "settings": In(FrameSettings),
                "end": In(1),
                "chosen": In(Chosen),
                "gated": In(Gated),
                "taken": Out(1),
                "o": Out(stream.Signature(RowResult, always_ready=True)),
            }
        )

    reference = staticmethod(measure)

    @property
    def latency(self) -> int:
        """Clocks from ``end`` to the record: divide, straighten, write."""
        return self._position.latency + 2

    def elaborate(self, platform):
        m = Module()
        m.submodules.position = position = self._position
        m.submodules.ratio = ratio = SerialDivider(20, 9)

        waiting = Signal()
        # Free again in time for the next row's take to find the record written.
        busy = Signal()
        m.d.comb += self.taken.eq((self.end | waiting) & ~busy)
        m.d.sync += waiting.eq((self.end | waiting) & busy)
        with m.If(self.taken):
            m.d.sync += busy.eq(1)
        with m.Elif(self.o.valid):
            m.d.sync += busy.eq(0)

        chosen, gated = Signal(Chosen, reset_less=True), Signal(Gated, reset_less=True)
        with m.If(self.taken):
            m.d.sync += [chosen.eq(self.chosen), gated.eq(self.gated)]
        run, crossing = chosen.run, chosen.run.crossing
        binary = Signal()
        m.d.comb += binary.eq(self.settings.detector == Detector.BINARY)

        # Divide. A crossing's rise is less than its contrast, a mean column less than max_columns: both quotients fit.
        numerator = Signal(gated.columns.shape())
        taken = self.chosen.run.crossing
        m.d.comb += [
            numerator.eq(Mux(binary, self.gated.columns, taken.rise)),
            position.dividend.eq(numerator << FRACTION_BITS),
            position.divisor.eq(Mux(binary, self.gated.total, taken.contrast)),
            position.start.eq(self.taken),
            ratio.dividend.eq(self.chosen.second_strength << 8),
            ratio.divisor.eq(self.chosen.run.strength),
            ratio.start.eq(self.taken),
        ]

        # Straighten: half columns and a share in 1/512 px, 1 more to round half up.
        halves = Signal(13)
        share = Signal(position.quotient_bits)
        straight, single = Signal(), Signal()
        m.d.sync += [straight.eq(crossing.straight), single.eq(crossing.single)]
        bend = Array(Const(1 - value, signed(4)) for value in BEND)[
            position.quotient[FRACTION_BITS - 5 : FRACTION_BITS]
        ]
        with m.If(binary):
            m.d.sync += [halves.eq(0), share.eq(position.quotient + 1)]
        with m.Elif(~run.crossed):
            m.d.sync += [halves.eq(run.halves), share.eq(1)]
        with m.Else():
            m.d.sync += halves.eq(run.halves - 1)
            with m.If(straight):
                m.d.sync += share.eq(position.quotient[:FRACTION_BITS] + bend)
            with m.Elif(single):
                m.d.sync += share.eq(FRACTION // 2 + 1)
            with m.Else():
                m.d.sync += share.eq(position.quotient[:FRACTION_BITS] + 1)

        # Flags, while the dividers work.
        touched = Signal(Gated)  # whose first and last column count
        m.d.comb += [
            touched.first.eq(Mux(binary, gated.first, run.first)),
            touched.last.eq(Mux(binary, gated.last, run.last)),
        ]
        touches = Signal(4)
        over, uncrossed = Signal(2), Signal()
        seen = Signal(13)  # last column that the filter saw at the crossing
        m.d.sync += [
            touches.eq(
                Cat(
                    touched.first == 0,
                    touched.first == self.settings.column_first,
                    touched.last == gated.last_column,
                    touched.last == self.settings.column_last,
                )
            ),
            seen.eq(crossing.after + REACH),
            over.eq(Cat(crossing.before < REACH, seen > gated.last_column)),
            uncrossed.eq(~binary & ~run.crossed),
        ]
        span, enough = Signal(12), Signal()
        m.d.sync += [
            span.eq(gated.last - gated.first + 1),
            enough.eq((gated.total >= self.settings.run_gated) & gated.total.any()),
        ]
        stray, doubtful = Signal(), Signal()
        m.d.sync += [
            stray.eq(chosen.found & (gated.total > (run.gated << 1))),
            doubtful.eq(Mux(binary, span > self.settings.run_width_max, run.crossed & ~crossing.coloured)),
        ]
        # The quotient is at most 256 and 8 bits hold up to 255. Where the best has no contrast, all are equal.
        runner_up, rival = Signal(8), Signal()
        m.d.comb += runner_up.eq(Mux(ratio.quotient[8] | uncrossed, 255, ratio.quotient))
        m.d.sync += rival.eq(chosen.second_found & (runner_up >= self.settings.ambiguous_ratio))
        valid = Signal()
        m.d.sync += valid.eq(Mux(binary, enough, chosen.found))

        # Write.
        fine = Signal(21)
        m.d.comb += fine.eq((halves << (FRACTION_BITS - 1)) + share)
        record = Signal(Row)
        with m.If(valid):
            m.d.comb += [
                record.valid.eq(1),
                record.position.eq(fine >> 1),
                record.cut.eq(touches.any() | (~binary & over.any()) | uncrossed),
                record.ambiguous.eq(stray | doubtful | rival),
                record.width.eq(Mux(chosen.found, run.width, span)),
                record.gated.eq(Mux(chosen.found, run.gated, gated.total)),
            ]
            with m.If(chosen.found):
                m.d.comb += [
                    record.saturated.eq(run.clipped.any()),
                    record.sum.eq(run.sum),
                    record.peak.eq(run.peak),
                    record.clipped.eq(run.clipped),
                    record.second_valid.eq(chosen.second_found),
                ]
            with m.If(chosen.found & chosen.second_found):
                m.d.comb += [
                    record.second_position.eq(chosen.second_halves << 7),
                    record.runner_up.eq(runner_up),
                ]
        m.d.comb += record.overflow.eq(gated.fault)
        m.d.sync += [
            self.o.p.row.eq(gated.row),
            self.o.p.record.eq(record),
            self.o.valid.eq(delayed(m, position.done, 1, "straightened")),
        ]
        return m
