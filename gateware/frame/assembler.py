"""Frames as payloads."""

from collections.abc import Mapping

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import enum, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import COMPACT_ROW, FULL_ROW, RowForm

from ..layouts import Packets, struct
from .facts import EDGE_BASE, EDGE_WORDS, HEADER_WORDS, FrameReader

CompactRow = struct(COMPACT_ROW)


class _Part(enum.Enum, shape=2):
    HEADER = 0
    EDGES = 1
    ROWS = 2


class FrameAssembler(wiring.Component):
    """Sends frames: header, edge log, rows in the form that the header tells.

    Throughput: a byte a clock, and 3 clocks more for each row and for every 4 bytes of header and edges.

    Parameters
    ----------
    max_rows : as in the buffer

    Members
    -------
    i : complete frames
    o : payloads of ``PacketType.FRAME``
    """

    def __init__(self, max_rows: int) -> None:
        self.max_rows = max_rows
        super().__init__({"i": In(FrameReader(max_rows)), "o": Out(Packets)})

    @staticmethod
    def reference(row: Mapping[str, int]) -> dict[str, int]:
        """The definition: the compact form of a full row.

        Positions stay below 2048 px = 2**19 / 256, since no card takes more columns.
        """
        compact = {field.name: row[field.name] for field in COMPACT_ROW.fields}
        return compact | {"peak": row["peak"] >> 4, "width": min(row["width"], 15)}

    def elaborate(self, platform):
        m = Module()
        contents = self.i.contents

        part = Signal(_Part)
        index = Signal(range(max(self.max_rows, EDGE_BASE)))  # word or row of this part
        # Whether this is the last of its part, of the frame: registered, the packet's end has a long way from here.
        part_ends, part_ended = Signal(), Signal()
        ends, ended = Signal(), Signal()
        m.d.sync += [part_ended.eq(part_ends), ended.eq(ends)]
        no_edges = contents.edges == 0
        no_rows = contents.rows == 0
        with m.Switch(part):
            with m.Case(_Part.HEADER):
                m.d.comb += [part_ends.eq(index == HEADER_WORDS - 1), ends.eq(part_ends & no_edges & no_rows)]
            with m.Case(_Part.EDGES):
                m.d.comb += [part_ends.eq(index + 1 == contents.edges * EDGE_WORDS), ends.eq(part_ends & no_rows)]
            with m.Case(_Part.ROWS):
                m.d.comb += [part_ends.eq(index + 1 == contents.rows), ends.eq(part_ends)]

        compact = Signal(CompactRow)
        for field in COMPACT_ROW.fields:
            m.d.comb += compact[field.name].eq(self.i.row[field.name])
        m.d.comb += [
            compact.peak.eq(self.i.row.peak[4:]),
            compact.width.eq(Mux(self.i.row.width > 15, 15, self.i.row.width)),
            self.i.word_index.eq(Cat(index[: EDGE_BASE.bit_length() - 1], part == _Part.EDGES)),
            self.i.row_index.eq(index),
        ]

        record = Signal(FULL_ROW.bits)  # the byte that is next is the lowest
        left = Signal(range(FULL_ROW.size + 1))
        m.d.comb += [
            self.o.payload.data.eq(record),
            self.o.payload.last.eq((left == 1) & ended),
        ]
        with m.FSM():
            with m.State("Wait"):
                m.d.sync += [part.eq(_Part.HEADER), index.eq(0)]
                with m.If(self.i.ready):
                    m.next = "Fetch"
            with m.State("Fetch"):
                m.next = "Settle"
            with m.State("Settle"):
                m.next = "Load"
            with m.State("Load"):
                with m.If(part != _Part.ROWS):
                    m.d.sync += [record.eq(self.i.word), left.eq(4)]
                with m.Elif(contents.form == RowForm.FULL):
                    m.d.sync += [record.eq(self.i.row), left.eq(FULL_ROW.size)]
                with m.Else():
                    m.d.sync += [record.eq(compact), left.eq(COMPACT_ROW.size)]
                m.next = "Send"
            with m.State("Send"):
                m.d.comb += self.o.valid.eq(1)
                with m.If(self.o.ready):
                    m.d.sync += [record.eq(record >> 8), left.eq(left - 1)]
                    with m.If(left == 1):
                        m.d.sync += index.eq(index + 1)
                        with m.If(part_ended):
                            m.d.sync += index.eq(0)
                            with m.If((part == _Part.HEADER) & ~no_edges):
                                m.d.sync += part.eq(_Part.EDGES)
                            with m.Else():
                                m.d.sync += part.eq(_Part.ROWS)
                        m.next = "Fetch"
                        with m.If(ended):
                            m.d.comb += self.i.done.eq(1)
                            m.next = "Release"
            # The buffer tells in the next clock whether there is another frame.
            with m.State("Release"):
                m.next = "Wait"

        return m
