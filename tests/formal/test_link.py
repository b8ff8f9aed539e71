"""What the link must never do, for every sequence of inputs.

``bmc``: for every sequence of the stated length from reset on. ``prove``: for ever, by induction.
"""

import pytest
from amaranth.hdl import Assert, Assume, Cat, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from gateware.layouts import Packets
from gateware.link.cobs import CobsEncoder
from gateware.link.packet import PacketSender
from magtrak.protocol import COMPACT_ROW, PacketType
from tests.support.formal import Opened, past, prove

OVERFLOW = next(at for at, field in COMPACT_ROW if field.name == "overflow")


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
        m.submodules.dut = dut = Opened(PacketSender(self.types))
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

        # What it follows from: where the sender is, and the sequence number, which it turns as it sends it.
        state, chosen, number, carry = (dut[name] for name in ("fsm_state", "chosen", "number", "carry"))
        turned, later = dut["sequence"], Signal(16)
        m.d.comb += later.eq(sequence + 1)
        with m.Switch(state):
            with m.Case(0):  # Choose
                m.d.comb += Assert((at == 0) & (turned == sequence))
            with m.Case(1):  # Type
                m.d.comb += Assert((at == 0) & (turned == sequence) & carry & (number == 0))
            with m.Case(2):  # Sequence
                m.d.comb += Assert((at == 1 + number) & (number < 2))
                with m.If(number[0]):
                    m.d.comb += Assert((turned == Cat(sequence[8:], later[:8])) & (carry == sequence[:8].all()))
                with m.Else():
                    m.d.comb += Assert((turned == sequence) & carry)
            with m.Case(3):  # Payload
                m.d.comb += Assert((at == 3) & (turned == sequence) & (number == 0))
            with m.Case(4):  # CRC
                m.d.comb += Assert((at == 4 + number) & (turned == sequence))
            with m.Default():
                m.d.comb += Assert(0)
        with m.If(state != 0):
            m.d.comb += Assert((chosen != 0) & ((chosen & (chosen - 1)) == 0))
        with m.If((state != 0) & (state != 1)):
            m.d.comb += Assert(chosen == 1 << source)
        return m


@pytest.mark.parametrize(("block", "pauses", "clocks"), [(2, True, 13), (3, False, 19)])
def test_cobs_output_has_no_zero_inside_and_decodes_to_its_input(block, pauses, clocks):
    prove(CobsIsRight(block, pauses=pauses), "bmc", clocks, timeout_s=600, map_memories=True)


def test_packets_are_never_interleaved(monkeypatch):
    monkeypatch.setattr("gateware.link.packet.Crc32", NoCrc)
    prove(PacketsAreWhole(), "prove", 2)
