"""Frames that the link can read are of one image each: for every sequence of inputs, for ever, by induction."""

import pytest
from amaranth.hdl import Assert, Assume, Cat, Const, Cover, Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In

from gateware.features import compact_rows
from gateware.frame.buffer import FrameBuffer
from gateware.frame.header import HeaderStore
from gateware.frame.rows import RowStore
from gateware.layouts import Row
from gateware.memory import BlockRam
from magtrak.protocol import RowForm
from tests.support.formal import Opened, prove

IMAGE = 8
"""Bits of an image's number."""


class AnyHeaderStore(wiring.Component):
    """Stands for the store of headers: one is complete some time after its image is over and its rows are there.

    ``now`` : a header is complete, if it can be, and in which bank
    """

    def __init__(self) -> None:
        super().__init__({**HeaderStore().signature.members, "now": In(2)})
        self.open = Signal(2)

    def elaborate(self, platform):
        m = Module()
        bank = self.now[0]
        m.d.comb += [
            self.complete_bank.eq(bank),
            self.complete.eq(self.now[1] & (self.open & self.filled).bit_select(bank, 1)),
        ]
        for number in range(2):
            with m.If(self.take & (self.ends == number)):
                m.d.sync += self.open[number].eq(1)
            with m.If(self.complete & (bank == number)):
                m.d.sync += self.open[number].eq(0)
        return m


class NoMemory(BlockRam):
    """Stands for a memory of which only the writes are looked at."""

    def elaborate(self, platform):
        return Module()


class FramesAreWhole(wiring.Component):
    """A frame's rows are of the image that its buffer was claimed for, and stay so until it was sent.

    Images come in any rhythm, in the form they like, their results as late as the next image but one. Results have any
    row numbers, come as close together as they like, and their end as soon as it likes. The link pauses as it likes
    and stands still as long as it likes.

    One word of the memory is followed, any one. What is proved: where a frame can be read that has the word's row,
    either the row has no line (its first word says so), or the word was written for this very image, from the
    result with this row's number; and nothing is written to a buffer that can be read. All else follows from what
    stands under "what it follows from".

    Members
    -------
    begin, end, over : an image begins, ends, its results end, where it can be
    row, number : a result comes, of this row
    moving, done : the link took a byte; it took the frame that is ready
    form : of the image that begins
    refused : an image was not let in
    now : see :class:`AnyHeaderStore`
    place : the word that is followed
    """

    def __init__(self, max_rows: int) -> None:
        self.max_rows = max_rows
        self.word_bits = (4 * max_rows - 1).bit_length()  # of its address within a bank
        self.row_bits = (2 * compact_rows(max_rows) - 1).bit_length()
        strobes = ("begin", "end", "over", "row", "moving", "done", "form", "refused")
        wide = {"number": In(self.row_bits), "now": In(2), "place": In(self.word_bits + 1)}
        super().__init__({name: In(1) for name in strobes} | wide)

    def elaborate(self, platform):
        m = Module()
        dut = FrameBuffer(self.max_rows)
        dut.row_store = rows = Opened(RowStore(self.max_rows))
        dut.header_store = header = AnyHeaderStore()
        m.submodules.dut = buffer = Opened(dut)

        # Images: begun, ended, and results given, in this order for each.
        begun, results, between = Signal(IMAGE), Signal(IMAGE), Signal(IMAGE)
        within, first, end, result_end = Signal(), Signal(), Signal(), Signal()
        result = dut.rows.row
        m.d.comb += [
            between.eq(begun - results),
            end.eq(self.end & within),
            first.eq(self.begin & ~within & (between < 2)),
            result_end.eq(self.over & (between > within)),
            dut.frame_first.eq(first),
            dut.frame_end.eq(end),
            dut.refused.eq(self.refused),
            dut.form.eq(self.form),
            dut.moving.eq(self.moving),
            dut.reader.done.eq(self.done & dut.reader.ready),
            result.valid.eq(self.row & (between != 0)),
            result.payload.row.eq(self.number),
            result.payload.record.peak.eq(results),
            result.payload.record.width.eq(self.number),
            dut.rows.frame_end.eq(result_end),
            header.now.eq(self.now),
        ]
        m.d.sync += [within.eq((within | first) & ~end), begun.eq(begun + first), results.eq(results + result_end)]

        # The parts of the design that are looked at.
        busy, filled, complete, forms = buffer["busy"], header.filled, buffer["complete"], rows.forms
        claiming, sending, accepted, into = buffer["claiming"], rows.bank, rows.accepted, rows.into
        begun_ago = rows.frame_first
        waiting, row, last, due, bare, hot = (rows[name] for name in ("waiting", "row", "last", "due", "bare", "hot"))
        lined, lineless = Signal(), Signal()  # which of the two the word is that is written
        m.d.sync += [lined.eq(hot.any()), lineless.eq(rows["fills"])]
        accepted0, bank0, accepted1, bank1 = Value.cast(rows["queue"])
        writes, address = rows["write__en"], rows["write__addr"]
        low, wide = (self.max_rows - 1).bit_length(), self.word_bits

        def full(bank):
            return forms.bit_select(bank, 1) == RowForm.FULL.value

        def row_of(address):
            return Mux(full(address[wide]), address[:low], address[:wide])

        # Which image each bank was claimed for; of which image and row the result that waits to be written says it is.
        claims = [Signal(IMAGE, name=f"claim{bank}") for bank in range(2)]
        kept = data.View(Row, rows["kept"])
        kept_image, kept_row = kept.peak, kept.width[: self.row_bits]
        for bank in range(2):
            with m.If(header.begin & (header.into == bank)):
                m.d.sync += claims[bank].eq(begun)

        def image(bank):
            return Mux(bank, claims[1], claims[0])

        # The word that is followed: its bank and row, what was written there since the bank was claimed, and into the
        # first word of its row.
        place, early = Signal.like(self.place), Signal(init=1)
        m.d.sync += [early.eq(0), place.eq(self.place)]
        m.d.comb += Assume(early | (place == self.place))
        bank, its_row, word = self.place[wide], Signal(wide), self.place[low:wide]
        m.d.comb += its_row.eq(row_of(self.place))
        head = Cat(self.place[:low], Mux(full(bank), 0, word), bank)
        there, there_image, there_row = _tracked(m, writes & lined & (address == self.place), kept_image, kept_row)
        headed, without = _tracked(m, writes & (address == head), lineless)
        with m.If(header.begin & (header.into == bank)):
            m.d.sync += [there.held.eq(0), headed.held.eq(0)]
        right, whole = Signal(), Signal()
        m.d.comb += [
            right.eq(there.now & (there_image.now == image(bank)) & (there_row.now == its_row)),
            whole.eq(headed.now & (without.now | right)),
        ]

        # What is to be proved.
        facts = dut.row_store.facts
        stored = Mux(bank, facts[1].rows, facts[0].rows)
        with m.If(dut.reader.ready):
            m.d.comb += Assert(~(writes & (address[wide] == sending)))
            with m.If((bank == sending) & (its_row < stored)):
                m.d.comb += [Assert(whole), Cover(full(bank) & (its_row == 1) & right)]

        # What it follows from. Images whose results are to come have banks of their own, which are not to be read.
        def claimed(accepted, bank, number):
            unread = ~(filled | complete).bit_select(bank, 1) & ~(rows.filled & (rows.filled_bank == bank))
            return ~accepted | (busy.bit_select(bank, 1) & unread & (image(bank) == number[:IMAGE]))

        def apart(accepted, bank, other_accepted, other_bank):
            return ~(accepted & other_accepted) | (bank != other_bank)

        def same(accepted0, bank0):
            return (accepted0 == accepted) & (~accepted | (bank0 == into))

        m.d.comb += [
            Assert((between <= 2) & (between >= within) & (waiting + begun_ago == between)),
            Assert((waiting == 0) | claimed(accepted0, bank0, results)),
            Assert((waiting != 2) | (claimed(accepted1, bank1, results + 1) & same(accepted1, bank1))),
            Assert((waiting != 2) | (apart(accepted0, bank0, accepted1, bank1) & ~begun_ago)),
            Assert((waiting != 1) | begun_ago | same(accepted0, bank0)),
            Assert(~begun_ago | (waiting == 0) | apart(accepted0, bank0, accepted, into)),
            Assert(~(begun_ago | within) | claimed(accepted, into, begun - 1)),
        ]
        # Banks take turns.
        strobed = Mux(rows.filled, 1 << rows.filled_bank, 0)
        m.d.comb += [
            Assert(claiming == (sending ^ busy[0] ^ busy[1])),
            Assert((busy == 0) | busy.bit_select(sending, 1)),
            Assert(((complete & ~filled) == 0) & ((filled & ~busy) == 0)),
            Assert((header.open & (~busy | complete)) == 0),
            Assert(~(within & accepted) | ~header.open.bit_select(into, 1)),
            Assert((strobed & (~busy | filled | complete)) == 0),
        ]
        # Rows are written one by one, each from the result that is kept.
        writing = (waiting != 0) & accepted0
        here = writing & (bank0 == bank)
        m.d.comb += [
            Assert((hot & (hot - 1)) == 0),
            Assert(~(hot[1:].any() & ~full(bank0))),
            Assert(writing | (~due & ~hot.any() & (row == 0))),
            Assert(~(due & hot.any()) | bare),
            Assert(~hot.any() | ((kept_image == results) & (kept_row == row))),
            Assert(~(due & ~hot.any() & ~bare) | ((kept_image == results) & (kept_row == last))),
            Assert(row <= Mux(full(bank0), self.max_rows, compact_rows(self.max_rows))),
            Assert(~writes | (writing & (bank0 == address[wide])) | (strobed.bit_select(address[wide], 1))),
            Assert(~writes | (lined ^ lineless)),
            Assert(~(writes & lined) | ((kept_row == row_of(address)) & (kept_image == image(address[wide])))),
            Assert(~(writes & lineless & full(address[wide])) | (address[low:wide] == 0)),
            Assert(~(here & (its_row < row)) | whole),
            Assert(~((strobed | filled).bit_select(bank, 1) & (its_row < stored)) | whole),
        ]
        with m.If(here & full(bank) & (its_row == row) & hot[1:].any()):
            m.d.comb += Assert(headed.now & ~without.now)
            m.d.comb += Assert(right | ~Cat(hot[at] & (word < at) for at in range(1, 4)).any())
        return m


class _Tracked:
    """``held`` in a register, and ``now``, with what is written in this clock."""

    def __init__(self, m: Module, strobe, value) -> None:
        self.held, self.now = Signal.like(Value.cast(value)), Signal.like(Value.cast(value))
        m.d.comb += self.now.eq(Mux(strobe, value, self.held))
        m.d.sync += self.held.eq(self.now)


def _tracked(m: Module, strobe, *values):
    """Whether ``strobe`` ever was, and the values at the last one."""
    return [_Tracked(m, strobe, value) for value in (Const(1), *values)]


@pytest.mark.parametrize("max_rows", [2, 512, 1024, 2048])
def test_frames_are_never_torn(max_rows, monkeypatch):
    monkeypatch.setattr("gateware.frame.rows.BlockRam", NoMemory)
    prove(FramesAreWhole(max_rows), "prove", 2)


def test_the_proof_speaks_of_frames_that_there_are(monkeypatch):
    monkeypatch.setattr("gateware.frame.rows.BlockRam", NoMemory)
    prove(FramesAreWhole(2), "cover", 20)
