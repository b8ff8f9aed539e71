"""What the link must never do, for every sequence of inputs.

``bmc``: for every sequence of the stated length from reset on. ``prove``: for ever, by induction.
"""

import pytest
from amaranth.hdl import Assert, Assume, Cat, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from gateware.frame.buffer import FrameBuffer
from gateware.frame.header import HeaderStore
from gateware.layouts import Packets
from gateware.link.cobs import CobsEncoder
from gateware.link.packet import PacketSender
from magtrak.protocol import COMPACT_ROW, PacketType, RowForm
from tests.support.formal import prove

OVERFLOW = next(at for at, field in COMPACT_ROW if field.name == "overflow")


def past(m: Module, value, init: int = 0):
    """``value`` a clock ago; ``init`` at reset."""
    register = Signal(value.shape(), init=init)
    m.d.sync += register.eq(value)
    return register


class CobsIsRight(wiring.Component):
    """The encoder's bytes have a zero at the end of each packet and nowhere else, and decode to what went in.

    Packets of any lengths, with or without pauses on both sides; zeros and three other bytes, since the encoder asks of
    a byte only whether it is zero. One byte is followed, any one: that it comes out as it went in, at its place, with a
    delimiter behind it if it is a packet's last, and none otherwise. Blocks are short, so that their limit is met.

    ``ready`` : the other end takes a byte
    ``pick`` : number of the byte that is followed
    """

    i: In(Packets)
    ready: In(1)
    pick: In(4)

    def __init__(self, block: int, *, pauses: bool) -> None:
        self.block = block
        self.pauses = pauses
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = CobsEncoder(self.block)
        connect(m, flipped(self.i), dut.i)
        first, picked = Signal(init=1), Signal(4)
        m.d.sync += [first.eq(0), picked.eq(self.pick)]
        m.d.comb += [Assume(first | (self.pick == picked)), Assume(self.i.payload.data < 4)]

        if not self.pauses:
            m.d.comb += [Assume(self.ready), Assume(self.i.valid)]

        entered, kept = Signal(5), Signal(9)
        with m.If(dut.i.valid & dut.i.ready):
            m.d.sync += entered.eq(entered + 1)
            with m.If(entered == self.pick):
                m.d.sync += kept.eq(self.i.payload.as_value())

        # What comes out, decoded by the definition: a code byte, code - 1 bytes, a zero if more follows.
        leaves, byte = Signal(), dut.o.payload
        m.d.comb += [dut.o.ready.eq(self.ready), leaves.eq(dut.o.valid & dut.o.ready)]
        greeted = Signal()  # the zero after reset is out
        inside, rest, full = Signal(), Signal(8), Signal()  # a packet; bytes of the block to come; no zero follows it
        left, followed = Signal(5), Signal()  # bytes decoded; the last of them is the one that is followed
        decoded = Signal()
        m.d.comb += decoded.eq(leaves & inside & ((rest != 0) | ((byte != 0) & ~full)))
        with m.If(leaves):
            m.d.sync += [greeted.eq(1), followed.eq(0)]
            m.d.comb += Assert((byte == 0) == (~greeted | (inside & (rest == 0) & (byte == 0))))
            with m.If(rest != 0):
                m.d.sync += rest.eq(rest - 1)
            with m.Elif(byte != 0):
                m.d.comb += Assert(byte <= self.block + 1)
                m.d.sync += [inside.eq(1), rest.eq(byte - 1), full.eq(byte == self.block + 1)]
            with m.Else():
                m.d.sync += inside.eq(0)
            # After the byte: a delimiter if it was the last; if not, none, though a code byte may come.
            with m.If(followed & kept[8]):
                m.d.comb += Assert((byte == 0) & (rest == 0))
            with m.If(followed & ~kept[8]):
                m.d.comb += Assert(byte != 0)
        with m.If(decoded):
            m.d.sync += left.eq(left + 1)
            m.d.comb += Assert(left < entered)
            with m.If(left == self.pick):
                m.d.sync += followed.eq(1)
                m.d.comb += Assert(kept[:8] == Mux(rest != 0, byte, 0))

        # A byte that waits to be taken neither goes nor changes.
        waited, before = past(m, dut.o.valid & ~dut.o.ready), past(m, byte)
        m.d.comb += Assert(~waited | (dut.o.valid & (byte == before)))
        return m


class NoCrc(wiring.Component):
    """Stands for the CRC, of which the property asks nothing."""

    start: In(1)
    valid: In(1)
    shift: In(1)
    data: In(8)
    crc: Out(32)
    match: Out(1)

    def __init__(self, bits: int) -> None:
        super().__init__()

    def elaborate(self, platform):
        return Module()


class PacketsAreWhole(wiring.Component):
    """What leaves is type, sequence number, payload and four bytes, of one payload from its first to its last byte.

    Payloads of any lengths come and pause as they like, and wait as streams have to.
    """

    def __init__(self) -> None:
        self.types = (PacketType.ANSWER, PacketType.FRAME, PacketType.SNAPSHOT)
        super().__init__({"ready": In(1), "i": In(Packets).array(len(self.types))})

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = PacketSender(self.types)
        took = Signal(len(self.types))
        for number, (inner, outer) in enumerate(zip(dut.i, self.i, strict=True)):
            connect(m, flipped(outer), inner)
            waited, before = past(m, inner.valid & ~inner.ready), past(m, outer.payload.as_value())
            m.d.comb += [
                Assume(~waited | (outer.valid & (outer.payload.as_value() == before))),
                took[number].eq(inner.valid & inner.ready),
            ]

        moved, byte = Signal(), dut.o.payload
        m.d.comb += [dut.o.ready.eq(self.ready), moved.eq(dut.o.valid & dut.o.ready)]
        at, source, sequence = Signal(3), Signal(range(len(self.types))), Signal(16)  # 3: in the payload
        with m.If(moved):
            m.d.sync += at.eq(at + 1)
            m.d.comb += Assert(byte.last == (at == 7))
            with m.Switch(at):
                with m.Case(0):
                    m.d.comb += Assert(Cat(byte.data == kind for kind in self.types).any())
                    for number, kind in enumerate(self.types):
                        with m.If(byte.data == kind):
                            m.d.sync += source.eq(number)
                with m.Case(1):
                    m.d.comb += Assert(byte.data == sequence[:8])
                with m.Case(2):
                    m.d.comb += Assert(byte.data == sequence[8:])
                    m.d.sync += sequence.eq(sequence + 1)
                with m.Case(3):
                    m.d.comb += Assert(took == 1 << source)
                    for number, payload in enumerate(self.i):
                        with m.If(source == number):
                            m.d.comb += Assert(byte.data == payload.payload.data)
                            m.d.sync += at.eq(Mux(payload.payload.last, 4, 3))
        with m.If(~moved | (at != 3)):
            m.d.comb += Assert(took == 0)
        return m


class AnyHeaderStore(wiring.Component):
    """Stands for the store of headers: one is complete some time after its image is over and its rows are there.

    ``word`` is the number of the image in the bank.
    """

    def __init__(self) -> None:
        super().__init__({**HeaderStore().signature.members, "now": In(1)})

    def elaborate(self, platform):
        m = Module()
        numbers, open_ = [Signal(32, name=f"number{n}") for n in range(2)], Signal(2)
        for bank in range(2):
            with m.If(self.take & (self.ends == bank)):
                m.d.sync += [numbers[bank].eq(self.number), open_[bank].eq(1)]
        first = Mux(self.now, 1, 0)  # of the two banks
        m.d.comb += [
            self.complete_bank.eq(first),
            self.complete.eq((open_ & self.filled).bit_select(first, 1)),
            self.word.eq(Mux(self.bank, numbers[1], numbers[0])),
        ]
        for bank in range(2):
            with m.If(self.complete & (self.complete_bank == bank)):
                m.d.sync += open_[bank].eq(0)
        return m


class FramesAreWhole(wiring.Component):
    """All rows of a frame that can be read, and its number, are of one image; and that stays so until it is done.

    Images come in any rhythm, their results as late as the next image but one, every row with the number of its image
    in it; the link pauses as it likes and stands still as long as it likes.
    """

    def __init__(self) -> None:
        super().__init__(
            {
                **{name: In(1) for name in ("begin", "end", "row", "over", "now", "moving", "done", "index")},
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = FrameBuffer(2)
        dut.header_store = store = AnyHeaderStore()
        m.d.comb += store.now.eq(self.now)

        # Images: begun, ended, and results given, in this order for each.
        begun, results, within = Signal(4), Signal(4), Signal()
        first, end, result_end = Signal(), Signal(), Signal()
        m.d.comb += [
            end.eq(self.end & within),
            first.eq(self.begin & ~within & ((begun - results)[:4] < 2)),
            result_end.eq(self.over & (results != begun) & ((begun - results)[:4] > within)),
        ]
        m.d.sync += [within.eq((within | first) & ~end), begun.eq(begun + first), results.eq(results + result_end)]
        result, given = dut.rows.row, Signal(2)  # rows of an image come in order
        m.d.sync += given.eq(Mux(result_end, 0, given + result.valid))
        # A row is written by then, in the compact form.
        written = Signal(2)
        m.d.sync += written.eq(Mux(result.valid, 3, Mux(written != 0, written - 1, 0)))
        m.d.comb += Assume(~result_end | ((written == 0) & ~result.valid))
        m.d.comb += [
            dut.frame_first.eq(first),
            dut.frame_end.eq(end),
            result.valid.eq(self.row & (results != begun) & (given != 3)),
            result.payload.row.eq(given),
            result.payload.record.position.eq(results),
            dut.form.eq(RowForm.COMPACT),
            dut.rows.frame_end.eq(result_end),
            dut.moving.eq(self.moving),
            dut.reader.row_index.eq(self.index),
            dut.reader.done.eq(self.done & dut.reader.ready),
        ]

        # A frame that can be read for three clocks on end gives its rows.
        reader = dut.reader
        stays = Signal()
        m.d.comb += stays.eq(reader.ready & ~reader.done)
        same = past(m, stays)
        for_two = past(m, stays & same)
        number = past(m, reader.word)
        with m.If(same):
            m.d.comb += [Assert(reader.ready), Assert(reader.word == number)]
        index, rows = past(m, past(m, self.index)), Signal(2)
        facts = dut.row_store.facts
        m.d.comb += rows.eq(Mux(dut.row_store.bank, facts[1].rows, facts[0].rows))
        with m.If(for_two & same & (index < rows) & ~reader.row[OVERFLOW]):
            m.d.comb += Assert(reader.row[:4] == reader.word[:4])
        return m


@pytest.mark.parametrize(("block", "pauses", "clocks"), [(2, True, 10), (3, False, 19)])
def test_cobs_output_has_no_zero_inside_and_decodes_to_its_input(block, pauses, clocks):
    prove(CobsIsRight(block, pauses=pauses), "bmc", clocks, timeout_s=600, map_memories=True)


def test_packets_are_never_interleaved(monkeypatch):
    monkeypatch.setattr("gateware.link.packet.Crc32", NoCrc)
    prove(PacketsAreWhole(), "bmc", 18, timeout_s=600)


def test_frames_are_never_torn():
    prove(FramesAreWhole(), "bmc", 13, timeout_s=600, map_memories=True)
