"""What an asynchronous pin passes before it is used: a glitch filter, and the delay that makes up for it."""

from collections.abc import Sequence

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..memory import BlockRam

LENGTH_BITS = 8


class GlitchFilter(wiring.Component):
    """Passes a level on once it has been stable.

    The output takes a new level when the input has had it for ``length`` consecutive clocks, ``length``
    clocks after the first of them. A length of 0 acts as 1. A length that changes in operation holds for
    the edges under way as well.

    Members
    -------
    i : level, synchronous
    length : clocks that a new level must last
    adopt : take the input as it is, as after reset
    o : filtered level
    """

    i: In(1)
    length: In(LENGTH_BITS)
    adopt: In(1)
    o: Out(1)

    @staticmethod
    def reference(levels: Sequence[int], length: int) -> list[int]:
        """The definition: every stretch of equal levels shorter than ``length`` takes on what was before it.

        The hardware's output is this, ``max(length, 1)`` clocks later; the first stretch counts as
        stable however short it is.
        """
        out: list[int] = []
        start = 0
        for end in range(1, len(levels) + 1):
            if end == len(levels) or levels[end] != levels[start]:
                stable = start == 0 or end - start >= length
                out += [levels[start] if stable else out[-1]] * (end - start)
                start = end
        return out

    def elaborate(self, platform: object) -> Module:
        m = Module()
        clocks = Signal(LENGTH_BITS, init=1)
        with m.If(self.adopt | (self.i == self.o)):
            m.d.sync += clocks.eq(1)
        with m.Elif(clocks < self.length):
            m.d.sync += clocks.eq(clocks + 1)
        with m.Else():
            m.d.sync += clocks.eq(1)
        with m.If(self.adopt | ((self.i != self.o) & (clocks >= self.length))):
            m.d.sync += self.o.eq(self.i)
        return m


class Align(wiring.Component):
    """Delays signals by as much as :class:`GlitchFilter` and the three clocks of a decoder behind it.

    Latency is ``max(length, 1) + FIXED`` clocks, see :meth:`latency`; throughput a word a clock. After reset
    the output is 0 until the first word arrives, so nothing from before the reset comes out of the memory.
    Where ``length`` grows in operation, the last words come once more; where it shrinks, as many are left out.

    Parameters
    ----------
    width : bits of a word

    Members
    -------
    i : word
    length : as for the filter
    o : delayed word
    valid : ``o`` was taken after the reset
    """

    FIXED = 3

    def __init__(self, width: int) -> None:
        if width < 1:
            raise ValueError(f"a word of {width} bits cannot be delayed; at least 1 is needed")
        self.width = width
        super().__init__({"i": In(width), "length": In(LENGTH_BITS), "o": Out(width), "valid": Out(1)})

    @classmethod
    def latency(cls, length: int) -> int:
        """Clocks from ``i`` to ``o``."""
        return max(length, 1) + cls.FIXED

    def elaborate(self, platform: object) -> Module:
        m = Module()
        write_bits = LENGTH_BITS + 1
        depth = 1 << write_bits  # twice the longest delay: the two ports never meet
        m.submodules.memory = memory = BlockRam(self.width, depth)
        write, read = memory.write, memory.read
        distance = Signal(LENGTH_BITS)
        behind = Signal(signed(write_bits + 1))
        full = Signal()
        fresh = Signal()
        taken = Signal()
        word = Signal(self.width)  # with nothing between, so that it can stand next to a slow block RAM
        m.d.comb += [
            distance.eq(self.length | (self.length == 0)),
            behind.eq(write.addr - distance),
            write.data.eq(self.i),
            write.en.eq(1),
            read.en.eq(1),
            read.addr.eq(behind),
        ]
        m.d.sync += [
            write.addr.eq(write.addr + 1),
            fresh.eq(full | (behind >= 0)),
            taken.eq(fresh),
            word.eq(read.data),
            self.valid.eq(taken),
            self.o.eq(Mux(taken, word, 0)),
        ]
        with m.If(write.addr.all()):
            m.d.sync += full.eq(1)
        return m
