"""The gated pixels of a row, runs or not: what the paper's own detector measures."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import Detector

from ..layouts import FrameSettings
from .lookahead import Column


class Gated(data.Struct):
    """Gated pixels of a row: how many, the last and the one before the first (modulo 4096), whether first and last lie
    at the border of the image or of the region; what ends with the row; and the quotient that is their mean column,
    the sum of columns by how many, if the detector is ``BINARY``, else both 0.

    2048 columns: the sum is at most 2047 * 1024 < 2**21.
    """

    row: 12
    last_column: 12
    fault: 1
    total: 12
    numerator: 21
    divisor: 12
    before: 12
    last: 12
    first_touches: 1
    last_touches: 1


class Spread(wiring.Component):
    """Adds up the gated pixels of each row.

    Members
    -------
    settings : ``detector`` is used
    column : stream of :class:`~gateware.vision.lookahead.Column`, always ready
    before, left_edge, right_edge : of that column, from :class:`~gateware.vision.lookahead.Lookahead`
    o : stream of :class:`Gated`, always ready, one per row, :attr:`latency` clocks after its last column; until the
        next row's last column, but ``row``, ``last_column`` and ``fault`` until its first

    Two clocks without a column follow each row.
    """

    settings: In(FrameSettings)
    column: In(stream.Signature(Column, always_ready=True))
    before: In(12)
    left_edge: In(1)
    right_edge: In(1)
    o: Out(stream.Signature(Gated, always_ready=True))

    latency = 3
    """Clocks from the row's last column to the result: take, add, hold, while the sums begin anew."""

    def elaborate(self, platform):
        m = Module()
        i, o = self.column.p, self.o.p
        total = Signal(12)
        columns = Signal(21)
        some = Signal()
        before = Signal(12, reset_less=True)
        last = Signal(12, reset_less=True)
        first_touches = Signal(reset_less=True)
        last_touches = Signal(reset_less=True)
        over = Signal()
        binary = Signal()
        # A register before the sums: what they take comes from afar.
        gated = Signal()
        column = Signal(12, reset_less=True)
        column_before = Signal(12, reset_less=True)
        left_edge = Signal(reset_less=True)
        right_edge = Signal(reset_less=True)
        ends = Signal()
        m.d.sync += [
            gated.eq(self.column.valid & i.gate),
            column.eq(i.column),
            column_before.eq(self.before),
            left_edge.eq(self.left_edge),
            right_edge.eq(self.right_edge),
            ends.eq(self.column.valid & i.row_last),
            over.eq(ends),
            binary.eq(self.settings.detector == Detector.BINARY),
            self.o.valid.eq(over),
        ]
        with m.If(self.column.valid):
            m.d.sync += [
                o.row.eq(i.row),
                o.last_column.eq(i.column),
                o.fault.eq(i.fault | (o.fault & ~i.row_first)),
            ]
        with m.If(gated):
            m.d.sync += [
                total.eq(total + 1),
                columns.eq(columns + column),
                some.eq(1),
                last.eq(column),
                last_touches.eq(right_edge),
            ]
            with m.If(~some):
                m.d.sync += [before.eq(column_before), first_touches.eq(left_edge)]
        with m.If(over):
            m.d.sync += [
                o.total.eq(total),
                o.numerator.eq(Mux(binary, columns, 0)),
                o.divisor.eq(Mux(binary, total, 0)),
                o.before.eq(before),
                o.last.eq(last),
                o.first_touches.eq(first_touches),
                o.last_touches.eq(last_touches),
                *(value.eq(0) for value in (total, columns, some)),
            ]
        return m
