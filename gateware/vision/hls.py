"""RGB to hue, luminance and saturation, one pixel a clock."""

from typing import NamedTuple

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak import reference

from ..arithmetic import PipelinedDivider, delayed


class Colour(data.Struct):
    """A colour of 8 bits each: hue in 1/256 turn, luminance and saturation 255 = 1."""

    hue: 8
    luminance: 8
    saturation: 8


class Sextant(NamedTuple):
    """A sixth of the hue circle, from one of the pure or mixed colours to the next.

    ``start`` is the hue (1/256 turn) from which the quotient counts, ``offset`` what 6 * 256 * hue lies above it at its
    beginning, in units of delta, with half a step added to round: the exact start is 256 / 6 * k of sextant k, so
    ``offset = 256 * k + 3 - 6 * start``.
    """

    start: int
    offset: int


SEXTANTS = (Sextant(0, 3), Sextant(43, 1), Sextant(85, 5), Sextant(128, 3), Sextant(171, 1), Sextant(213, 5))
"""Red to yellow, to green, to cyan, to blue, to magenta, to red."""


class HLS(wiring.Component):
    """Hue, luminance and saturation of each pixel, as :func:`magtrak.reference.hls` defines them.

    One pixel a clock, constant latency, no state from one pixel to the next. The reference counts hue by thirds of
    the circle; sixths are the same numbers and keep the quotient at 6 bits: within a sextant one channel moves from
    the least to the greatest or back, by ``way``, and ``hue = start + (256 * way + offset * delta) // (6 * delta)``.

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

    PREPARE = 4
    latency = PREPARE + 5
    """Clocks from the pixel to its colour: one more than half the bits of the longer quotient after the four."""

    def elaborate(self, platform):
        m = Module()
        # Both quotients are halved above and below. They are at most 43 and 255.
        m.submodules.divide_hue = divide_hue = PipelinedDivider(10, 6)
        m.submodules.divide_saturation = divide_saturation = PipelinedDivider(8, 8)
        assert self.latency == self.PREPARE + divide_saturation.latency == self.PREPARE + divide_hue.latency + 1

        # 1: order
        rg, gb, rb = Signal(), Signal(), Signal()
        m.d.sync += [rg.eq(self.r >= self.g), gb.eq(self.g >= self.b), rb.eq(self.r >= self.b)]
        r, g, b = (delayed(m, getattr(self, name), 1, name) for name in "rgb")

        # 2: greatest, least, the two of which `way` is the difference, and what depends on the sextant. Greys are in
        # the first, which starts at 0.
        high, low, plus, minus = (Signal(8, reset_less=True, name=n) for n in ("high", "low", "plus", "minus"))
        start, twice, four_times = Signal(8, reset_less=True), Signal(reset_less=True), Signal(reset_less=True)

        def sextant(number: int):
            offset = SEXTANTS[number].offset
            return [start.eq(SEXTANTS[number].start), twice.eq(offset == 1 + 2), four_times.eq(offset == 1 + 4)]

        with m.If(rg & rb):
            m.d.sync += [high.eq(r), minus.eq(b)]
            with m.If(gb):
                m.d.sync += [plus.eq(g), *sextant(0)]
            with m.Else():
                m.d.sync += [plus.eq(r), *sextant(5)]
        with m.Elif(gb):
            m.d.sync += [high.eq(g), minus.eq(r)]
            with m.If(rb):
                m.d.sync += [plus.eq(g), *sextant(1)]
            with m.Else():
                m.d.sync += [plus.eq(b), *sextant(2)]
        with m.Else():
            m.d.sync += [high.eq(b), minus.eq(g)]
            with m.If(rg):
                m.d.sync += [plus.eq(r), *sextant(4)]
            with m.Else():
                m.d.sync += [plus.eq(b), *sextant(3)]
        m.d.sync += low.eq(Mux(rb & gb, b, Mux(~rg & ~rb, r, g)))

        # 3
        delta, total, way = Signal(8, reset_less=True), Signal(9, reset_less=True), Signal(8, reset_less=True)
        m.d.sync += [delta.eq(high - low), total.eq(high + low), way.eq(plus - minus)]
        twice, four_times = delayed(m, twice, 1, "twice"), delayed(m, four_times, 1, "four_times")

        # 4
        offset, three_delta = Signal(11, reset_less=True), Signal(10, reset_less=True)
        span, scaled = Signal(8, reset_less=True), Signal(16, reset_less=True)
        luminance, grey = Signal(8, reset_less=True), Signal(reset_less=True)
        multiple = (delta << 1) & twice.replicate(9) | (delta << 2) & four_times.replicate(10)
        m.d.sync += [
            offset.eq(multiple + delta),
            three_delta.eq((delta << 1) + delta),
            span.eq(Mux(total[8], 510 - total, total)),
            scaled.eq((delta << 8) - delta),
            luminance.eq((total + 1) >> 1),
            grey.eq(delta == 0),
        ]
        way = delayed(m, way, 1, "way")

        # 5 on: dividends of at most 261 * 255 / 2 < 2**16 and 255.5 * 255 < 2**16. Those of a grey are less than their
        # divisors, which its bit keeps from 0.
        m.d.comb += [
            divide_hue.dividend.eq((way << 7) + (offset >> 1)),
            divide_hue.divisor.eq(three_delta | grey),
            divide_saturation.dividend.eq(scaled + (span >> 1)),
            divide_saturation.divisor.eq(span | grey),
        ]
        hue = Signal(8, reset_less=True)
        m.d.sync += hue.eq(delayed(m, start, self.latency - 3, "start") + divide_hue.quotient)
        m.d.comb += [
            self.o.hue.eq(hue),
            self.o.luminance.eq(delayed(m, luminance, self.latency - 4, "luminance")),
            self.o.saturation.eq(divide_saturation.quotient),
        ]
        return m
