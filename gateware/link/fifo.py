"""Bytes of packets that wait for the link."""

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..layouts import Packet, Packets
from ..memory import BlockRam

_TAPS = {3: 2, 4: 3, 5: 3, 6: 5, 7: 6, 9: 5, 10: 7, 11: 9}
"""By the bits of an address: where besides its top bit a shift register is tapped to go through all values but 0.

W. Stahnke, "Primitive binary polynomials", Mathematics of Computation 27 (1973): those with three terms.
"""


class PacketFifo(wiring.Component):
    """A queue of bytes in block RAM, first in, first out.

    Addresses follow each other as in a shift register with feedback, which has no carry: the next one takes a cell.

    Throughput: a byte a clock. Latency 3 clocks when empty: a block RAM's output goes to a register first.

    Parameters
    ----------
    depth : words of the memory, a power of two; it holds two bytes less, and two are on their way out

    Members
    -------
    i, o : bytes of packets

    Raises
    ------
    ValueError
        There is no such ``depth``.
    """

    i: In(Packets)
    o: Out(Packets)

    def __init__(self, depth: int) -> None:
        depths = [1 << bits for bits in _TAPS]
        if depth not in depths:
            raise ValueError(f"depth is {depth}; possible are {', '.join(map(str, depths))}")
        self.depth = depth
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        # Where one is read another is written: at equal addresses it is empty, and nothing is read.
        m.submodules.memory = memory = BlockRam(Packet, self.depth)
        to = Signal(range(self.depth), init=1)
        from_ = Signal(range(self.depth), init=1)
        takes = Signal()
        gives = Signal()
        fetched = Signal()  # a byte is at the memory's output
        moves = Signal()  # it goes on

        def following(address):
            return Cat(address[-1] ^ address[_TAPS[len(address)] - 1], address[:-1])

        m.d.comb += [
            self.i.ready.eq(following(to) != from_),
            takes.eq(self.i.valid & self.i.ready),
            moves.eq(fetched & (~self.o.valid | self.o.ready)),
            gives.eq((to != from_) & (~fetched | moves)),
            *(memory.write.addr.eq(to), memory.write.data.eq(self.i.payload), memory.write.en.eq(takes)),
            *(memory.read.addr.eq(from_), memory.read.en.eq(gives)),
        ]
        with m.If(takes):
            m.d.sync += to.eq(following(to))
        with m.If(gives):
            m.d.sync += from_.eq(following(from_))
        with m.If(gives | moves):
            m.d.sync += fetched.eq(gives)
        with m.If(moves):
            m.d.sync += self.o.payload.eq(memory.read.data)
        with m.If(moves | self.o.ready):
            m.d.sync += self.o.valid.eq(moves)
        return m
