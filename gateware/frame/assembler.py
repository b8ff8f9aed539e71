"""Frames as payloads."""

from collections.abc import Mapping

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import enum, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import COMPACT_ROW, FRAME, MAX_EDGES, RowForm

from ..layouts import Packets, struct
from ..select import one_of
from .facts import EDGE_BASE, EDGE_WORDS, HEADER_WORDS, FrameReader

CompactRow = struct(COMPACT_ROW)


class _Part(enum.Enum, shape=2):
    HEADER = 0
    EDGES = 1
    ROWS = 2


class FrameAssembler(wiring.Component):
    """Sends frames: header, edge log, rows in the form that the header tells.

    What the frame has is read in the header as it passes.

    Throughput: a byte a clock, and 2 clocks more for each row and for every 4 bytes of header and edges.

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
        form = Signal(RowForm)
        edges, rows = Signal(range(MAX_EDGES + 1)), Signal(range(self.max_rows + 1))
        row = self.i.row

        # Word or row of this part, and the next; both stand still while the bytes of one are sent.
        part = Signal(_Part)
        positions = max(self.max_rows, EDGE_BASE) + 1
        index, following = Signal(range(positions)), Signal(range(positions), init=1)
        m.d.comb += [
            self.i.word_index.eq(Cat(index[: EDGE_BASE.bit_length() - 1], part == _Part.EDGES)),
            self.i.row_index.eq(index),
        ]

        # Whether this is the last of its part, of the frame: registered, there are clocks before it is used.
        size = Signal(range(positions))
        part_ended, ended = Signal(), Signal()
        with m.Switch(part):
            with m.Case(_Part.HEADER):
                m.d.comb += size.eq(HEADER_WORDS)
            with m.Case(_Part.EDGES):
                m.d.comb += size.eq(edges * EDGE_WORDS)
            with m.Default():
                m.d.comb += size.eq(rows)
        no_edges, no_rows = Signal(), Signal()
        m.d.sync += [
            no_edges.eq(edges == 0),
            no_rows.eq(rows == 0),
            part_ended.eq(following == size),
            ended.eq((part == _Part.ROWS) | (no_rows & ((part == _Part.EDGES) | no_edges))),
        ]

        compact = Signal(CompactRow)
        for field in COMPACT_ROW.fields:
            m.d.comb += compact[field.name].eq(row[field.name])
        m.d.comb += [
            compact.peak.eq(row.peak[4:]),
            compact.width.eq(Mux(row.width > 15, 15, row.width)),
        ]

        # All bytes that can be next, those of a row or word from its place in `hot` on.
        choices = [Value.cast(row), Value.cast(compact), self.i.word]
        bytes_ = [value.word_select(n, 8) for value in choices for n in range(len(value) // 8)]
        ends = [sum(len(value) // 8 for value in choices[: n + 1]) for n in range(len(choices))]
        hot, last = Signal(len(bytes_)), Signal()
        byte = one_of(bytes_, hot)
        m.d.comb += last.eq(Cat(hot[end - 1] for end in ends).any())

        free = Signal()  # for another byte
        m.d.comb += free.eq(self.o.ready | ~self.o.valid)
        with m.If(self.o.ready):
            m.d.sync += self.o.valid.eq(0)
        with m.FSM():
            with m.State("Wait"):
                m.d.sync += [part.eq(_Part.HEADER), index.eq(0), following.eq(1)]
                with m.If(self.i.ready):
                    m.next = "Fetch"
            with m.State("Fetch"):
                of_rows, full = part == _Part.ROWS, form == RowForm.FULL
                m.d.sync += hot.eq(0)
                for start, kind in zip([0, *ends], (of_rows & full, of_rows & ~full, ~of_rows), strict=False):
                    m.d.sync += hot[start].eq(kind)
                m.next = "Settle"
            with m.State("Settle"):
                m.next = "Send"
            with m.State("Send"):
                with m.If(part == _Part.HEADER):
                    for name, kept in (("form", form), ("edges", edges), ("rows", rows)):
                        place = next(at for at, field in FRAME if field.name == name)
                        with m.If(index == place // 32):
                            m.d.sync += kept.eq(self.i.word[place % 32 :])
                with m.If(free):
                    m.d.sync += [
                        self.o.valid.eq(1),
                        self.o.payload.data.eq(byte),
                        self.o.payload.last.eq(last & part_ended & ended),
                        hot.eq(hot << 1),
                    ]
                    with m.If(last):
                        m.d.sync += [index.eq(following), following.eq(following + 1)]
                        m.next = "Fetch"
                        with m.If(part_ended):
                            m.d.sync += [index.eq(0), following.eq(1)]
                            with m.If((part == _Part.HEADER) & ~no_edges):
                                m.d.sync += part.eq(_Part.EDGES)
                            with m.Else():
                                m.d.sync += part.eq(_Part.ROWS)
                            with m.If(ended):
                                m.d.comb += self.i.done.eq(1)
                                m.next = "Wait"

        return m
