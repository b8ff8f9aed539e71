"""The colour gate in block RAM: three tables, all of which must pass."""

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import LUT_WORDS
from magtrak.reference import gate

from ..arithmetic import delayed
from ..layouts import LutWrite
from ..memory import BlockRam
from .hls16 import HLS16

_NIBBLE = 4
_NIBBLES = 32 // _NIBBLE


class BlockGate(wiring.Component):
    """Which colours pass: :func:`magtrak.reference.gate`.

    As :class:`~gateware.vision.gate.Gate` behind :class:`~gateware.vision.hls.HLS`, for FPGAs without distributed RAM.
    Each table is a block RAM of words of 4 bits, in two banks. A word of 32 bits is written a nibble a clock, so that
    none of it has to be kept: ``lut.axis``, ``lut.word`` and ``lut.data`` stand for :attr:`write_clocks` clocks from
    ``lut.valid`` on, and neither another write nor ``lut.swap`` comes until then.

    The host fills the idle bank; ``lut.swap`` exchanges the banks of all ``lut.written`` at once. It comes between two
    images, from the clock after the last colour's bit has come to the clock of the first colour. After reset both banks
    are 0: nothing passes.

    Members
    -------
    lut : writes to the idle bank, and the strobe that swaps
    r, g, b : colour
    o : whether the colour of :attr:`latency` clocks ago passes
    """

    lut: In(LutWrite())
    r: In(8)
    g: In(8)
    b: In(8)
    o: Out(1)

    reference = staticmethod(gate)

    write_clocks = _NIBBLES
    """Clocks that a write takes."""

    latency = HLS16.latency + 1
    """Clocks from the colour to its bit: the table's nibble."""

    def elaborate(self, platform):
        m = Module()
        m.submodules.hls = hls = HLS16()
        m.d.comb += [hls.r.eq(self.r), hls.g.eq(self.g), hls.b.eq(self.b)]

        banks = Signal(3)
        with m.If(self.lut.swap):
            m.d.sync += banks.eq(banks ^ self.lut.written)
        # The first nibble is written with `valid`.
        nibble = Signal(range(_NIBBLES))
        writing = Signal()
        m.d.comb += writing.eq(self.lut.valid | nibble.any())
        m.d.sync += nibble.eq(nibble + writing)

        passes = []
        for axis, (name, late) in enumerate(
            (("hue", 0), ("luminance", HLS16.latency - HLS16.luminance_latency), ("saturation", 0))
        ):
            # What is read is in the other bank.
            m.submodules[f"table_{name}"] = table = BlockRam(_NIBBLE, 2 * LUT_WORDS * _NIBBLES, block=True)
            index, bank = getattr(hls, name), banks[axis]
            m.d.comb += [
                table.write.en.eq(writing & (self.lut.axis == axis)),
                table.write.addr.eq(Cat(nibble, self.lut.word, ~bank)),
                table.write.data.eq(self.lut.data.word_select(nibble, _NIBBLE)),
                table.read.addr.eq(Cat(index[2:], bank)),
                table.read.en.eq(1),
            ]
            bit = table.read.data.bit_select(delayed(m, index[:2], 1, f"{name}_low"), 1)
            passes.append(delayed(m, bit, late, f"{name}_passes"))
        m.d.comb += self.o.eq(passes[0] & passes[1] & passes[2])
        return m
