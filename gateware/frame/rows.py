"""The rows of two frames."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ..layouts import Row, Rows
from ..memory import BlockRam
from .facts import RowFacts, VisionFacts


class RowStore(wiring.Component):
    """Writes the rows of images that were accepted into one of two banks.

    Results may come after the next image has begun: images are matched to results by their order.

    Rows beyond ``max_rows`` are left out. Latency of writing 1 clock, of reading 2.

    Parameters
    ----------
    max_rows : rows of a bank, a power of two

    Members
    -------
    frame_first, accepted, into : strobe of each image's first pixel, whether its rows are to be kept, and in which
        bank; at most two images are between their first pixel and ``rows.frame_end``
    rows, vision : results; ``vision`` as of ``rows.frame_end``
    filled, filled_bank : strobe: the rows of an accepted image are complete in this bank
    facts : of each bank, since ``filled``
    bank, index : row to read
    row : that row

    Raises
    ------
    ValueError
        ``max_rows`` is no power of two.
    """

    def __init__(self, max_rows: int) -> None:
        if max_rows < 2 or max_rows & (max_rows - 1):
            raise ValueError(f"max_rows is {max_rows}; a power of two is needed, at least 2")
        self.max_rows = max_rows
        super().__init__(
            {
                "frame_first": In(1),
                "accepted": In(1),
                "into": In(1),
                "rows": In(Rows()),
                "vision": In(VisionFacts),
                "filled": Out(1),
                "filled_bank": Out(1),
                "facts": Out(RowFacts).array(2),
                "bank": In(1),
                "index": In(range(max_rows)),
                "row": Out(Row),
            }
        )

    def elaborate(self, platform):
        m = Module()
        # Read and written at once only before a bank is complete, when what is read is not used: in each clock the word
        # is read again.
        m.submodules.memory = memory = BlockRam(Row, 2 * self.max_rows)
        write, read = memory.write, memory.read

        # Images whose results are to come, the oldest first: whether each was accepted, and its bank.
        expected = data.ArrayLayout(data.StructLayout({"accepted": 1, "bank": 1}), 2)
        queue = Signal(expected)
        waiting = Signal(range(3))
        finished = Signal()
        rest = Signal(expected)
        left = Signal(range(3))
        m.d.comb += [
            finished.eq(self.rows.frame_end & (waiting != 0)),
            rest.eq(Mux(finished, queue.as_value() >> 2, queue)),
            left.eq(waiting - finished),
        ]
        m.d.sync += [queue.eq(rest), waiting.eq(left + self.frame_first)]
        with m.If(self.frame_first):
            m.d.sync += [queue[left[0]].accepted.eq(self.accepted), queue[left[0]].bank.eq(self.into)]

        filling = queue[0].bank
        stored = Signal(range(self.max_rows + 1))
        lost = Signal()
        result = self.rows.row.payload
        wanted = self.rows.row.valid & (waiting != 0) & queue[0].accepted
        with m.If(wanted):
            m.d.sync += [
                write.addr.eq(Cat(result.row[: (self.max_rows - 1).bit_length()], filling)),
                write.data.eq(result.record),
            ]
        m.d.sync += [
            write.en.eq(wanted & (result.row < self.max_rows)),
            self.filled.eq(finished & queue[0].accepted),
            self.filled_bank.eq(filling),
        ]
        with m.If(wanted):
            with m.If(result.row < self.max_rows):
                m.d.sync += stored.eq(result.row + 1)
            with m.Else():
                m.d.sync += lost.eq(1)
        with m.If(finished):
            m.d.sync += [stored.eq(0), lost.eq(0)]
            with m.If(queue[0].accepted):
                for bank, facts in enumerate(self.facts):
                    with m.If(filling == bank):
                        m.d.sync += [
                            facts.vision.eq(self.vision),
                            facts.rows.eq(stored),
                            facts.lost.eq(lost | self.vision.errors.rows),
                        ]

        m.d.comb += [read.addr.eq(Cat(self.index, self.bank)), read.en.eq(1)]
        m.d.sync += self.row.eq(read.data)
        return m
