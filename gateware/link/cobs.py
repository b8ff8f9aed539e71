r"""Consistent overhead byte stuffing, with a zero byte after each packet.

S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM
Transactions on Networking 7(2), 1999. The reference model is
:mod:`magtrak.protocol.cobs`: the encoder's output is ``cobs_encode(packet) + b"\0"``
byte for byte.
"""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol.cobs import BLOCK

from ..layouts import Bytes, Packets
from ..memory import BlockRam


class CobsEncoder(wiring.Component):
    """Packets to bytes for the wire.

    A code byte comes before the up to 254 bytes that it announces, so blocks are collected in one
    bank of a memory while the block before leaves the other. A bank has its code byte at address 0, written last.

    Throughput: it takes a byte a clock, and one clock more a block; it gives one every two clocks. Latency: a block
    leaves when it is complete; its code byte 4 clocks later.

    After reset a lone zero byte leaves first: it ends the packet that a reset may have cut off.

    Parameters
    ----------
    block : bytes that one code byte announces at most; the standard's 254 but for proofs, which need it small

    Members
    -------
    i : packets of at least one byte
    o : their encoding, a zero byte after each; no other byte is zero
    """

    i: In(Packets)
    o: Out(Bytes)

    def __init__(self, block: int = BLOCK) -> None:
        self.block = block
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        full = Signal(2)
        lasts = Signal(2, init=1)  # the packet's last block
        bits = self.block.bit_length()  # of an address within a bank
        # A bank that is being written is not read: it is not full.
        m.submodules.memory = memory = BlockRam(8, 2 << bits)
        write, read = memory.write, memory.read

        # Collect. A code byte says where the next zero was, counted from itself: 1 to 255.
        bank = Signal(init=1)
        code = Signal(8, init=1)  # of the block so far: its bytes + 1
        closing = Signal()  # the code is to be written
        ends = Signal()  # the packet ends here
        tail = Signal()  # a zero was the packet's last byte: an empty block must follow
        zero = self.i.payload.data == 0
        free = Signal()
        m.d.comb += [
            free.eq(~full.bit_select(bank, 1)),
            self.i.ready.eq(free & ~closing),
            write.addr.eq(Cat(code[:bits] & (~closing).replicate(bits), bank)),
            write.data.eq(Mux(closing, code, self.i.payload.data)),
            write.en.eq(free),  # whatever is at the input: what is no byte is overwritten
        ]
        with m.If(closing & free):
            m.d.sync += [code.eq(1), bank.eq(~bank), closing.eq(tail), ends.eq(tail), tail.eq(0)]
        with m.Elif(self.i.valid & self.i.ready):
            m.d.sync += [
                closing.eq(zero | self.i.payload.last | (code == self.block)),
                ends.eq(self.i.payload.last & ~zero),
                tail.eq(self.i.payload.last & zero),
            ]
            with m.If(~zero):
                m.d.sync += code.eq(code + 1)

        # Send: code byte, the block, a delimiter after a packet's last block. Two clocks a byte, because the
        # memory's output goes through a register of its own.
        taking = Signal()  # the bank that leaves; at first there is none, but its delimiter
        at = Signal(range(self.block + 2))  # next byte of it: 0 is the code byte
        leaving = Signal(8)  # its code, or 255 until that is known
        first = Signal()
        last = Signal()
        at_end = Signal()
        fetched = Signal()
        able = self.o.ready | ~self.o.valid
        m.d.comb += [
            last.eq(lasts.bit_select(taking, 1)),
            first.eq(at == 0),
            at_end.eq(at == leaving),
            read.addr.eq(Cat(at[:bits], taking)),
            read.en.eq(~fetched),
        ]
        with m.If(self.o.ready):
            m.d.sync += self.o.valid.eq(0)
        with m.If(fetched):
            with m.If(able):
                m.d.sync += [self.o.valid.eq(1), self.o.payload.eq(read.data), at.eq(at + 1), fetched.eq(0)]
                with m.If(first):
                    m.d.sync += leaving.eq(read.data)
        with m.Elif(~at_end):
            m.d.sync += fetched.eq(full.bit_select(taking, 1))
        with m.Elif(able | ~last):
            m.d.sync += [at.eq(0), leaving.eq(0xFF), taking.eq(~taking)]
            with m.If(last):
                m.d.sync += [self.o.valid.eq(1), self.o.payload.eq(0)]

        for number in range(2):
            with m.If(closing & free & (bank == number)):
                m.d.sync += [full[number].eq(1), lasts[number].eq(ends)]
            with m.If(~fetched & at_end & (able | ~last) & (taking == number)):
                m.d.sync += full[number].eq(0)

        return m


class CobsDecoder(wiring.Component):
    """Bytes from the wire to packets.

    A byte is passed on when the next one tells whether it was the packet's last. The decoder is in step
    again after any zero byte, wherever it starts.

    Throughput: a byte a clock. Latency: none beyond the wait for the next byte.

    Members
    -------
    i : bytes, a zero after each packet; further zeros are idle filling
    o : decoded packets
    error : strobe: the bytes since the last ``last`` were no whole packet; a receiver forgets them
    """

    i: In(Bytes)
    o: Out(Packets)
    error: Out(1)

    def elaborate(self, platform):
        m = Module()

        rest = Signal(8, init=1)  # bytes to come in this block, and one more
        short = Signal()  # the block ends with a zero, unless it ends the packet
        inside = Signal()  # something came since the last delimiter
        held = Signal(8)
        holding = Signal()

        delimiter = self.i.payload == 0
        complete = rest == 1
        code = ~delimiter & complete
        intact = holding & complete
        yields = Signal()  # this byte completes a decoded byte
        m.d.comb += [
            yields.eq(~delimiter & Mux(code, short, 1)),
            self.o.payload.data.eq(held),
            self.o.payload.last.eq(delimiter),
            self.o.valid.eq(self.i.valid & holding & Mux(delimiter, intact, yields)),
            self.i.ready.eq(self.o.ready | ~self.o.valid),
            self.error.eq(self.i.valid & delimiter & inside & ~intact),
        ]
        with m.If(self.i.valid & self.i.ready):
            with m.If(delimiter):
                m.d.sync += [rest.eq(1), Cat(short, inside, holding).eq(0)]
            with m.Else():
                m.d.sync += inside.eq(1)
                with m.If(code):
                    m.d.sync += [rest.eq(self.i.payload), short.eq(self.i.payload != BLOCK + 1)]
                with m.Else():
                    m.d.sync += rest.eq(rest - 1)
                with m.If(yields):
                    m.d.sync += [held.eq(Mux(code, Const(0, 8), self.i.payload)), holding.eq(1)]

        return m
