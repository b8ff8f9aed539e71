"""RGB to hue, luminance and saturation, one pixel a clock."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak import reference
from magtrak.reference.hls import SEXTANT_OFFSET, SEXTANT_START

from ..arithmetic import PipelinedDivider, delayed


class Colour(data.Struct):
    """A colour of 8 bits each: hue in 1/256 turn, luminance and saturation 255 = 1."""

    hue: 8
    luminance: 8
    saturation: 8


class HLS(wiring.Component):
    """Hue, luminance and saturation of each pixel, as :func:`magtrak.reference.hls` defines them.

    One pixel a clock, constant latency, no state from one pixel to the next. Two pipelined dividers take
    8 of the clocks.

    Members
    -------
    r, g, b : colour
    o : the :class:`Colour` of :attr:`latency` clocks ago
    """

    r: In(8)
    g: In(8)
    b: In(8)
    o: Out(Colour)

    reference = staticmethod(reference.hls)

    PREPARE = 5
    SATURATION_BITS = 8
    HUE_BITS = 7  # the quotient is at most 86, see the reference

    latency = PREPARE + SATURATION_BITS
    """Clocks from the pixel to its colour: one for each bit of the longer quotient."""

    def elaborate(self, platform):
        m = Module()
        m.submodules.divide_hue = divide_hue = PipelinedDivider(11, self.HUE_BITS)
        m.submodules.divide_saturation = divide_saturation = PipelinedDivider(9, self.SATURATION_BITS)

        # 1: order
        rg, gb, rb = Signal(), Signal(), Signal()
        m.d.sync += [rg.eq(self.r >= self.g), gb.eq(self.g >= self.b), rb.eq(self.r >= self.b)]
        r, g, b = (delayed(m, getattr(self, name), 1, name) for name in "rgb")

        # 2: greatest, least, and the two others in the order of the turn
        high, low, plus, minus = (Signal(8, reset_less=True, name=n) for n in ("high", "low", "plus", "minus"))
        sextant = Signal(2, reset_less=True)
        with m.If(rg & rb):
            m.d.sync += [high.eq(r), plus.eq(g), minus.eq(b), sextant.eq(0)]
        with m.Elif(gb):
            m.d.sync += [high.eq(g), plus.eq(b), minus.eq(r), sextant.eq(1)]
        with m.Else():
            m.d.sync += [high.eq(b), plus.eq(r), minus.eq(g), sextant.eq(2)]
        m.d.sync += low.eq(Mux(rb & gb, b, Mux(~rg & ~rb, r, g)))

        # 3
        delta, total, turn = Signal(8, reset_less=True), Signal(9, reset_less=True), Signal(signed(9), reset_less=True)
        m.d.sync += [delta.eq(high - low), total.eq(high + low), turn.eq(plus - minus)]
        sextant = delayed(m, sextant, 1, "sextant")

        # 4: SEXTANT_OFFSET is 256 + 5, 1 or 3: the 256 joins the turn, the rest is one sum.
        assert SEXTANT_OFFSET == (256 + 4 + 1, 256 + 0 + 1, 256 + 2 + 1)
        turned = Signal(9, reset_less=True)  # |turn| <= delta: 0 to 2 * delta
        offset = Signal(11, reset_less=True)
        six_delta = Signal(11, reset_less=True)
        span, scaled = Signal(8, reset_less=True), Signal(17, reset_less=True)
        luminance, grey = Signal(8, reset_less=True), Signal(reset_less=True)
        multiple = Mux(sextant == 0, delta << 2, Mux(sextant == 1, 0, delta << 1))
        m.d.sync += [
            turned.eq(turn + delta),
            offset.eq(multiple + delta),
            six_delta.eq(((delta << 1) + delta) << 1),
            span.eq(Mux(total[8], 510 - total, total)),
            scaled.eq((delta << 9) - (delta << 1)),
            luminance.eq((total + 1) >> 1),
            grey.eq(delta == 0),
        ]
        sextant = delayed(m, sextant, 1, "sextant4")

        # 5: numerators of at most 517 * 255 < 2**18 and 511 * 255 < 2**17. Divisors are even: a grey sets
        # bit 0, which keeps them from 0 and both quotients at 0.
        for divider, dividend, divisor in (
            (divide_hue, (turned << 8) + offset, six_delta | grey),
            (divide_saturation, scaled + span, Cat(grey, span)),
        ):
            m.d.sync += [divider.dividend.eq(dividend), divider.divisor.eq(divisor)]

        start = Signal(8, reset_less=True)
        with m.If(grey):
            m.d.sync += start.eq(0)
        for value in range(3):
            with m.Elif(sextant == value):
                m.d.sync += start.eq(SEXTANT_START[value] & 0xFF)
        start = delayed(m, start, divide_hue.latency, "start")
        hue = Signal(8, reset_less=True)
        m.d.sync += hue.eq(start + divide_hue.quotient)
        m.d.comb += [
            self.o.hue.eq(hue),
            self.o.luminance.eq(delayed(m, luminance, self.latency - 4, "luminance")),
            self.o.saturation.eq(divide_saturation.quotient),
        ]
        return m
