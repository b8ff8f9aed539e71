"""The gated pixels of a row, runs or not: what the paper's own detector measures."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from .lookahead import Column


class Gated(data.Struct):
    """Gated pixels of a row: how many, the sum of their columns, the first and the last, whether they lie at the border
    of the image or of the region; and what ends with the row.

    2048 columns: the sum is at most 2047 * 1024 < 2**21.
    """

    row: 12
    last_column: 12
    fault: 1
    total: 12
    columns: 21
    first: 12
    last: 12
    first_touches: 1
    last_touches: 1


class Spread(wiring.Component):
    """Adds up the gated pixels of each row.

    Members
    -------
    column : stream of :class:`~gateware.vision.lookahead.Column`, always ready
    o : stream of :class:`Gated`, always ready, one per row, :attr:`latency` clocks after its last column; the
        payload stays until the next row's first column has come
    """

    column: In(stream.Signature(Column, always_ready=True))
    o: Out(stream.Signature(Gated, always_ready=True))

    latency = 1
    """Clocks from the row's last column to the result."""

    def elaborate(self, platform):
        m = Module()
        i, o = self.column.p, self.o.p
        total, columns = Signal(12), Signal(21)
        m.d.comb += [total.eq(Mux(i.row_first, 0, o.total)), columns.eq(Mux(i.row_first, 0, o.columns))]
        m.d.sync += self.o.valid.eq(self.column.valid & i.row_last)
        with m.If(self.column.valid):
            m.d.sync += [
                o.row.eq(i.row),
                o.last_column.eq(i.column),
                o.fault.eq(i.fault | (o.fault & ~i.row_first)),
                o.total.eq(total + i.gate),
                o.columns.eq(columns + Mux(i.gate, i.column, 0)),
            ]
            with m.If(i.gate):
                m.d.sync += [o.last.eq(i.column), o.last_touches.eq(i.right_edge)]
                with m.If(total == 0):
                    m.d.sync += [o.first.eq(i.column), o.first_touches.eq(i.left_edge)]
        return m
