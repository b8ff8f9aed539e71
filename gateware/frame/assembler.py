"""Frames as payloads."""

from collections.abc import Mapping

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import enum, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import COMPACT_ROW, FRAME, FULL_ROW, MAX_EDGES, RowForm

from ..features import ROW_WORDS, compact_rows
from ..layouts import Packets
from ..select import Picked
from .facts import EDGE_BASE, EDGE_WORDS, HEADER_WORDS, FrameReader

_VALID = next(at for at, field in FULL_ROW if field.name == "valid")


class _Part(enum.Enum, shape=2):
    HEADER = 0
    EDGES = 1
    ROWS = 2


class FrameAssembler(wiring.Component):
    """Sends frames: header, edge log, rows.

    What the frame has is read in the header as it passes. Of a full row without a line only the first word is read;
    the others are 0.

    Throughput: a byte a clock, and 2 clocks more for every 4 bytes.

    Parameters
    ----------
    max_rows : as in the buffer
    edge_log : without it no frame has edges

    Members
    -------
    i : complete frames
    o : payloads of ``PacketType.FRAME``
    """

    def __init__(self, max_rows: int, *, edge_log: bool = True) -> None:
        self.max_rows = max_rows
        self.edge_log = edge_log
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
        edges = Signal(range(MAX_EDGES + 1)) if self.edge_log else Const(0, range(MAX_EDGES + 1))
        rows = Signal(range(compact_rows(self.max_rows) + 1))

        # Word or row of this part, and the next; all stands still while the bytes of one word are sent.
        part = Signal(_Part)
        index = Signal(range(max(compact_rows(self.max_rows), EDGE_BASE)))
        following = Signal(len(index) + 1, init=1)
        of_row = Signal(ROW_WORDS, init=1)  # which word of a full row
        low = (self.max_rows - 1).bit_length()
        full = form == RowForm.FULL
        m.d.comb += [
            self.i.word_index.eq(Cat(index[: EDGE_BASE.bit_length() - 1], part == _Part.EDGES)),
            self.i.row_index.eq(
                Cat(index[:low], Mux(full, Cat(of_row[1] | of_row[3], of_row[2:].any()), index[low : low + 2]))
            ),
        ]

        # Whether this is the last of its part, of the frame: registered, there are clocks before it is used.
        of_rows = part == _Part.ROWS
        part_ended = Signal()
        ended = Signal()
        no_edges = Signal(init=not self.edge_log)
        no_rows = Signal()
        m.d.sync += [no_edges.eq(edges == 0), no_rows.eq(rows == 0)]
        m.d.sync += ended.eq(of_rows | (no_rows & ((part == _Part.EDGES) | no_edges)))
        with m.Switch(part):
            with m.Case(_Part.HEADER):
                m.d.sync += part_ended.eq(index == HEADER_WORDS - 1)
            if self.edge_log:
                with m.Case(_Part.EDGES):
                    m.d.sync += part_ended.eq(following == edges * EDGE_WORDS)
            with m.Default():
                m.d.sync += part_ended.eq((following == rows) & (of_row[-1] | ~full))

        # The byte that is next, of a row's word or another.
        words = [self.i.row, self.i.word]
        number = Signal(range(4))
        hot = Signal(8)
        m.submodules.byte = byte = Picked(8, len(hot))
        m.d.comb += [
            *(byte.i[4 * at + n].eq(word.word_select(n, 8)) for at, word in enumerate(words) for n in range(4)),
            byte.which.eq(hot),
            self.o.payload.data.eq(byte.o),
        ]
        last = number == 3
        empty = Signal()  # the row has no line

        free = Signal()  # for another byte
        m.d.comb += free.eq(self.o.ready | ~self.o.valid)
        with m.If(self.o.ready):
            m.d.sync += self.o.valid.eq(0)
        with m.FSM():
            with m.State("Wait"):
                m.d.sync += [part.eq(_Part.HEADER), index.eq(0), following.eq(1), of_row.eq(1)]
                with m.If(self.i.ready):
                    m.next = "Fetch"
            with m.State("Fetch"):
                m.d.sync += [hot.eq(0), hot[0].eq(of_rows & ~(empty & full & ~of_row[0])), hot[4].eq(~of_rows)]
                m.next = "Settle"
            with m.State("Settle"):
                m.next = "Send"
            with m.State("Send"):
                with m.If(part == _Part.HEADER):
                    read = {"form": form, "rows": rows} | ({"edges": edges} if self.edge_log else {})
                    for name, kept in read.items():
                        place = next(at for at, field in FRAME if field.name == name)
                        with m.If(index == place // 32):
                            m.d.sync += kept.eq(self.i.word[place % 32 :])
                with m.If(of_row[0]):
                    m.d.sync += empty.eq(~self.i.row[_VALID])
                with m.If(free):
                    m.d.comb += byte.enable.eq(1)
                    m.d.sync += [
                        self.o.valid.eq(1),
                        self.o.payload.last.eq(last & part_ended & ended),
                        number.eq(number + 1),
                        hot.eq(hot << 1),
                    ]
                    with m.If(last):
                        m.next = "Fetch"
                        with m.If(of_rows & full & ~of_row[-1]):
                            m.d.sync += of_row.eq(of_row << 1)
                        with m.Else():
                            m.d.sync += [index.eq(following), following.eq(following + 1), of_row.eq(1)]
                        with m.If(part_ended):
                            m.d.sync += [index.eq(0), following.eq(1)]
                            m.d.sync += part.eq(_Part.ROWS)
                            if self.edge_log:
                                with m.If((part == _Part.HEADER) & ~no_edges):
                                    m.d.sync += part.eq(_Part.EDGES)
                            with m.If(ended):
                                m.d.comb += self.i.done.eq(1)
                                m.next = "Wait"

        return m
