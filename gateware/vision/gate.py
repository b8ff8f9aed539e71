"""The colour gate: three tables, all of which must pass."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import LUT_WORDS
from magtrak.reference import gate

from ..arithmetic import delayed
from ..layouts import LutWrite
from .hls import Colour


class Gate(wiring.Component):
    """One bit per colour: hue, luminance and saturation all pass their tables.

    Each table has 256 entries of one bit, in two banks of 16 x 32 bits of distributed RAM. The host fills the idle
    bank; ``lut.swap`` exchanges the banks of all ``lut.written`` at once, for colours that come from then on. After
    reset both banks are 0: nothing passes.

    Members
    -------
    lut : writes to the idle bank, and the strobe that swaps
    i : colour
    may : the colour of two clocks ago may pass at all; 1 if it is left alone
    o : whether the colour of :attr:`latency` clocks ago passes

    With :class:`~gateware.vision.hls.HLS` before it, it computes :func:`magtrak.reference.gate`.
    """

    lut: In(LutWrite())
    i: In(Colour)
    may: In(1, init=1)
    o: Out(1)

    latency = 3
    """Clocks from the colour to its bit: word, half of a byte, bit."""

    reference = staticmethod(gate)

    def elaborate(self, platform):
        m = Module()
        banks = Signal(3)
        with m.If(self.lut.swap):
            m.d.sync += banks.eq(banks ^ self.lut.written)

        passes = []
        for axis, name in enumerate(("hue", "luminance", "saturation")):
            table = memory.Memory(shape=32, depth=2 * LUT_WORDS, init=[])
            m.submodules[f"table_{name}"] = table
            write, bank = table.write_port(), banks[axis]
            m.d.comb += [
                write.en.eq(self.lut.valid & (self.lut.axis == axis)),
                write.addr.eq(Cat(self.lut.word, ~bank)),
                write.data.eq(self.lut.data),
            ]
            read = table.read_port(domain="comb")
            index = self.i[name]
            m.d.comb += read.addr.eq(Cat(index[5:8], bank))
            # Only the byte in question gets into the word: that takes the registers' reset, and no multiplexer.
            word = Signal(32, name=f"{name}_word")
            for number in range(4):
                part = slice(8 * number, 8 * number + 8)
                m.d.sync += word[part].eq(Mux(index[3:5] == number, read.data[part], 0))
            byte = word[:8] | word[8:16] | word[16:24] | word[24:]
            half = Signal(4, name=f"{name}_half", reset_less=True)
            m.d.sync += half.eq(Mux(delayed(m, index[2], 1, f"{name}_half"), byte[4:], byte[:4]))
            passes.append(half.bit_select(delayed(m, index[:2], 2, f"{name}_bit"), 1))
        m.d.sync += self.o.eq(passes[0] & passes[1] & passes[2] & self.may)
        return m
