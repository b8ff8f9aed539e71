r"""Consistent overhead byte stuffing, with a zero byte after each packet.

S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM
Transactions on Networking 7(2), 1999. The reference model is
:mod:`magtrak.protocol.cobs`: the encoder's output is ``cobs_encode(packet) + b"\0"``
byte for byte.
"""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol.cobs import BLOCK

from ..layouts import Bytes, Packets
from ..memory import BlockRam


class CobsEncoder(wiring.Component):
    """Packets to bytes for the wire.

    A code byte comes before the up to 254 bytes that it announces, so blocks are collected in one
    bank of a memory while the block before leaves the other.

    Throughput: a byte a clock, code bytes and delimiters included. Latency: a block leaves when it is
    complete; its code byte 2 clocks later.

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

        # A code byte says where the next zero was, counted from itself: 1 to 255.
        block = data.StructLayout({"code": 8, "last": 1})
        blocks = [Signal(block, name=f"block{bank}") for bank in range(2)]
        full = Signal(2)

        bits = self.block.bit_length()  # of an address within a bank; address 0 is not used
        # A bank that is being written is also read, but nothing comes of that: it is not full.
        m.submodules.memory = memory = BlockRam(8, 2 << bits)
        write, read = memory.write, memory.read

        # Collect.
        bank = Signal()
        code = Signal(8, init=1)  # of the block so far: its bytes + 1
        tail = Signal()  # a zero was the packet's last byte: an empty block must follow
        free = Signal()
        zero = self.i.payload.data == 0
        close = Signal()
        closed = Signal(block)
        m.d.comb += [
            free.eq(~full.bit_select(bank, 1)),
            self.i.ready.eq(free & ~tail),
            write.addr.eq(Cat(code[:bits], bank)),
            write.data.eq(self.i.payload.data),
            write.en.eq(self.i.valid & self.i.ready),
        ]
        with m.If(tail):
            m.d.comb += [close.eq(free), closed.code.eq(1), closed.last.eq(1)]
            m.d.sync += tail.eq(~free)
        with m.Elif(write.en):
            with m.If(zero):
                m.d.comb += [close.eq(1), closed.code.eq(code)]
                m.d.sync += tail.eq(self.i.payload.last)
            with m.Else():
                m.d.comb += [
                    close.eq(self.i.payload.last | (code == self.block)),
                    closed.code.eq(code + 1),
                    closed.last.eq(self.i.payload.last),
                ]
                m.d.sync += code.eq(code + 1)
        with m.If(close):
            m.d.sync += [code.eq(1), bank.eq(~bank)]

        # Send: code byte, the block, a delimiter after a packet's last block. Two stages, because the
        # memory's output goes through a register of its own.
        taking = Signal()  # the bank that leaves
        at = Signal(range(self.block + 2))  # next byte of it: 0 is the code byte
        leaving = Signal(block)
        advance = Signal()
        done = Signal()
        fetched = Signal(data.StructLayout({"valid": 1, "stored": 1, "byte": 8}), init={"valid": 1})
        delimiter = at == leaving.code
        m.d.comb += [
            leaving.eq(Mux(taking, blocks[1], blocks[0])),
            advance.eq(self.o.ready | ~self.o.valid),
            read.addr.eq(Cat(at[:bits], taking)),
            read.en.eq(advance),
            # After code - 1 bytes the block is out; its delimiter takes one more.
            done.eq((at == Mux(leaving.last, leaving.code, leaving.code - 1)) & full.bit_select(taking, 1)),
        ]
        with m.If(advance):
            m.d.sync += [
                fetched.valid.eq(full.bit_select(taking, 1)),
                fetched.stored.eq((at != 0) & ~delimiter),
                fetched.byte.eq(Mux(delimiter, 0, leaving.code)),
                self.o.valid.eq(fetched.valid),
                self.o.payload.eq(Mux(fetched.stored, read.data, fetched.byte)),
            ]
            with m.If(done):
                m.d.sync += [at.eq(0), taking.eq(~taking)]
            with m.Elif(full.bit_select(taking, 1)):
                m.d.sync += at.eq(at + 1)

        for number, stored in enumerate(blocks):
            with m.If(close & (bank == number)):
                m.d.sync += [stored.eq(closed), full[number].eq(1)]
            with m.If(advance & done & (taking == number)):
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

        rest = Signal(8)  # bytes to come in this block
        short = Signal()  # the block ends with a zero, unless it ends the packet
        inside = Signal()  # something came since the last delimiter
        held = Signal(8)
        holding = Signal()

        delimiter = self.i.payload == 0
        code = ~delimiter & (rest == 0)
        intact = holding & (rest == 0)
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
                m.d.sync += Cat(rest, short, inside, holding).eq(0)
            with m.Else():
                m.d.sync += inside.eq(1)
                with m.If(code):
                    m.d.sync += [rest.eq(self.i.payload - 1), short.eq(self.i.payload != BLOCK + 1)]
                with m.Else():
                    m.d.sync += rest.eq(rest - 1)
                with m.If(yields):
                    m.d.sync += [held.eq(Mux(code, Const(0, 8), self.i.payload)), holding.eq(1)]

        return m
