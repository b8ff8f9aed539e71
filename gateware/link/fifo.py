"""Bytes of packets that wait for the link."""

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..layouts import Packet, Packets
from ..memory import BlockRam


class PacketFifo(wiring.Component):
    """A queue of bytes in block RAM, first in, first out.

    Throughput: a byte a clock. Latency 3 clocks when empty: a block RAM's output goes to a register first.

    Parameters
    ----------
    depth : bytes that it holds, a power of two

    Members
    -------
    i, o : bytes of packets

    Raises
    ------
    ValueError
        ``depth`` is no power of two.
    """

    i: In(Packets)
    o: Out(Packets)

    def __init__(self, depth: int) -> None:
        if depth < 2 or depth & (depth - 1):
            raise ValueError(f"depth is {depth}; a power of two is needed, at least 2")
        self.depth = depth
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        # Where one is read another is written: at equal addresses it is empty, and nothing is read.
        m.submodules.memory = memory = BlockRam(Packet, self.depth)
        to, from_ = Signal(range(self.depth)), Signal(range(self.depth))
        takes, gives = Signal(), Signal()
        fetched, moves = Signal(), Signal()  # a byte is at the memory's output; it goes on
        m.d.comb += [
            self.i.ready.eq((to + 1)[: len(to)] != from_),
            takes.eq(self.i.valid & self.i.ready),
            moves.eq(fetched & (~self.o.valid | self.o.ready)),
            gives.eq((to != from_) & (~fetched | moves)),
            *(memory.write.addr.eq(to), memory.write.data.eq(self.i.payload), memory.write.en.eq(takes)),
            *(memory.read.addr.eq(from_), memory.read.en.eq(gives)),
        ]
        m.d.sync += [to.eq(to + takes), from_.eq(from_ + gives)]
        with m.If(gives | moves):
            m.d.sync += fetched.eq(gives)
        with m.If(moves):
            m.d.sync += self.o.payload.eq(memory.read.data)
        with m.If(moves | self.o.ready):
            m.d.sync += self.o.valid.eq(moves)
        return m
