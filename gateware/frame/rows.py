"""The rows of two frames."""

from amaranth.hdl import C, Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import COMPACT_ROW, FULL_ROW, RowForm

from ..features import ROW_WORDS, compact_rows
from ..layouts import Row, Rows, struct
from ..memory import BlockRam
from ..select import Picked
from .facts import RowFacts, VisionFacts

CompactRow = struct(COMPACT_ROW)


class RowStore(wiring.Component):
    """Writes the rows of images that were accepted into one of two banks, in the form in which they are sent.

    A bank holds ``max_rows`` rows in the full form; word k of row r is at ``k * max_rows + r``. In the compact form it
    holds four times as many, up to 2048, row r at r.

    Results may come after the next image has begun: images are matched to results by their order. Rows beyond those
    that a bank holds are left out.

    Every row before the last result of an image is written. One without a result of its own, and one whose result comes
    while those before are being written, has no line and ``overflow`` set: both happen only to rows that broke the
    contract of the camera, and such results say no more. Of a full row without a line the first word matters only.

    Latency of writing: 6 clocks, and one for every row without a result; of reading 2 clocks.

    Parameters
    ----------
    max_rows : full rows of a bank, a power of two
    close_images : without it ``facts`` are kept of one image: they are those of the last accepted one in either bank,
        and ``vision`` is not kept at all, which then has to stay until the next ``rows.frame_end``
    fast_clock : the word goes through a register behind the memory; without it, it comes a clock sooner

    Members
    -------
    frame_first, accepted, into : strobe of each image's first pixel, whether its rows are to be kept, and in which
        bank; at most two images are between their first pixel and ``rows.frame_end``
    forms : of each bank, a ``RowForm``; of an image from the clock after its ``frame_first`` on, while it is there
    rows, vision : results; ``vision`` as of ``rows.frame_end``, which comes when the last result is written; what is
        not written by then is left out, and ``lost`` is set
    filled, filled_bank : strobe: the rows of an accepted image are complete in this bank
    facts : of each bank, since ``filled``
    bank, index : word to read
    word : that word

    Raises
    ------
    ValueError
        ``max_rows`` is no power of two.
    """

    def __init__(self, max_rows: int, *, close_images: bool = True, fast_clock: bool = True) -> None:
        if max_rows < 2 or max_rows & (max_rows - 1):
            raise ValueError(f"max_rows is {max_rows}; a power of two is needed, at least 2")
        self.max_rows = max_rows
        self.close_images = close_images
        self.fast_clock = fast_clock
        super().__init__(
            {
                "frame_first": In(1),
                "accepted": In(1),
                "into": In(1),
                "forms": In(2),
                "rows": In(Rows()),
                "vision": In(VisionFacts),
                "filled": Out(1),
                "filled_bank": Out(1),
                "facts": Out(RowFacts).array(2),
                "bank": In(1),
                "index": In(range(ROW_WORDS * max_rows)),
                "word": Out(32),
            }
        )

    def elaborate(self, platform):
        m = Module()
        # A bank is either written or read, but for clocks in which the word that is read does not matter.
        m.submodules.memory = memory = BlockRam(32, 2 * ROW_WORDS * self.max_rows)
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
        full = Signal()
        m.d.comb += full.eq(self.forms.bit_select(filling, 1) == RowForm.FULL.value)

        # The next row that is written, and the one of the last result, which comes after all before it.
        low = (self.max_rows - 1).bit_length()
        most = compact_rows(self.max_rows)
        row = Signal(range(2 * most))
        last = Signal(range(2 * most))
        kept = Signal(Row, reset_less=True)
        due = Signal()  # there are rows to be written
        bare = Signal()  # nothing is kept of the last one
        hot = Signal(ROW_WORDS)  # the word of `kept` that is written
        room = Signal()
        reached = Signal()
        comes = Signal()
        fills = Signal()
        lost = Signal()
        unwritten = Signal()
        m.d.comb += [
            unwritten.eq(due | hot.any()),
            room.eq(~Mux(full, row[low:].any(), row[(most - 1).bit_length()])),
            reached.eq(row == last),
            comes.eq(due & ~hot.any() & reached & ~bare),
            fills.eq(due & ~hot.any() & ~comes),
        ]
        with m.If((hot[-1] | (hot[0] & ~full)) | comes):
            m.d.sync += hot.eq(comes)
        with m.Else():
            m.d.sync += hot.eq(hot << 1)
        with m.If(due & ~hot.any()):
            m.d.sync += [due.eq(~reached & room), lost.eq(lost | ~room)]
        with m.If((hot[-1] | (hot[0] & ~full) | fills) & room):
            m.d.sync += row.eq(row + 1)
        with m.If(self.rows.row.valid & (waiting != 0) & queue[0].accepted):
            m.d.sync += [due.eq(1), last.eq(self.rows.row.payload.row), bare.eq(due | hot.any())]
            with m.If(~due & ~hot.any()):
                m.d.sync += kept.eq(self.rows.row.payload.record)

        words = Value.cast(kept)
        compact = Signal(CompactRow)
        for field in COMPACT_ROW.fields:
            m.d.comb += compact[field.name].eq(kept[field.name])
        m.d.comb += [compact.peak.eq(kept.peak[4:]), compact.width.eq(Mux(kept.width > 15, 15, kept.width))]
        number = Cat(hot[1] | hot[3], hot[2:].any())
        common = next(at for at, field in COMPACT_ROW if field.name == "valid")  # of both forms, the lowest bits
        parts = [words[:common], words[common:32], words[32:64], words[64:96], words[96:], compact.as_value()[common:]]
        whole, short = hot[0] & full, hot[0] & ~full
        aligned = [Cat(Const(0, common), part) if part is parts[1] or part is parts[-1] else part for part in parts]
        empties = [C(1 << _overflow(layout), 32) for layout in (FULL_ROW, COMPACT_ROW)]
        m.submodules.word = word = Picked(32, len(parts) + len(empties))
        m.d.comb += [
            *(one.eq(part) for one, part in zip(word.i, [*aligned, *empties], strict=True)),
            word.which.eq(Cat(hot[0], whole, hot[1:], short, fills & full, fills & ~full)),
            word.enable.eq(hot.any() | fills),
            write.data.eq(word.o),
        ]
        m.d.sync += [
            write.addr.eq(Cat(row[:low], Mux(full, number, row[low:])[:2], filling)),
            write.en.eq((hot.any() | fills) & room),
        ]
        m.d.sync += [self.filled.eq(finished & queue[0].accepted), self.filled_bank.eq(filling)]

        with m.If(finished):
            m.d.sync += [row.eq(0), lost.eq(0), due.eq(0), hot.eq(0)]
            with m.If(queue[0].accepted):
                for bank, facts in enumerate(self.facts if self.close_images else self.facts[:1]):
                    with m.If((filling == bank) | (not self.close_images)):
                        m.d.sync += [facts.rows.eq(row), facts.lost.eq(lost | unwritten | self.vision.errors.rows)]
                        if self.close_images:
                            m.d.sync += facts.vision.eq(self.vision)
        if not self.close_images:
            m.d.comb += [self.facts[0].vision.eq(self.vision), self.facts[1].eq(self.facts[0])]

        m.d.comb += [read.addr.eq(Cat(self.index, self.bank)), read.en.eq(1)]
        if self.fast_clock:
            m.d.sync += self.word.eq(read.data)
        else:
            m.d.comb += self.word.eq(read.data)
        return m


def _overflow(layout) -> int:
    """The bit of the flag."""
    return next(at for at, field in layout if field.name == "overflow")
