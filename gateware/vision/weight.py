"""The signed mix of the channels, which measures the line."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak import reference
from magtrak.protocol import register
from magtrak.reference.weight import FRACTION_BITS

from ..arithmetic import Multiply, delayed
from ..layouts import FrameSettings

COEFFICIENT_BITS = register("weight_r").bits


class Weight(wiring.Component):
    """Mix and weight of each pixel: :func:`magtrak.reference.mix` and :func:`magtrak.reference.weight`.

    ``raw = clip((weight_r * R + weight_g * G + weight_b * B + 128) >> 8, 0, 255)`` with coefficients in signed Q2.8,
    ``mix = max(raw - background, 0)`` and ``weight = max(mix - floor, 0)``. One pixel a clock, constant latency.

    Members
    -------
    settings : ``weight_r``, ``weight_g``, ``weight_b`` and ``floor`` are used
    r, g, b : colour
    background : what is subtracted from the pixel of :attr:`raw_latency` clocks ago
    raw : mix of the pixel of :attr:`raw_latency` clocks ago, before that
    mix, weight : of the pixel :attr:`latency` clocks ago
    saturated : one of its channels was at full scale
    """

    settings: In(FrameSettings)
    r: In(8)
    g: In(8)
    b: In(8)
    background: In(8)
    raw: Out(8)
    mix: Out(8)
    weight: Out(8)
    saturated: Out(1)

    reference_mix = staticmethod(reference.mix)
    reference_weight = staticmethod(reference.weight)

    raw_latency = Multiply.latency + 4
    """Clocks from the pixel to its mix: hold, for multipliers lie far away; product, two sums, clip."""

    latency = raw_latency + 2
    """Clocks from the pixel to its weight: background, floor."""

    def elaborate(self, platform):
        m = Module()
        products = []
        for name in "rgb":
            m.submodules[f"multiply_{name}"] = multiply = Multiply(8, signed(COEFFICIENT_BITS))
            held = delayed(m, getattr(self, name), 1, name)
            m.d.comb += [multiply.a.eq(held), multiply.b.eq(self.settings[f"weight_{name}"])]
            products.append(multiply.product)

        # |product| <= 512 * 255 < 2**17, so the sum of three and 128 is below 2**19 in magnitude.
        partial = Signal(signed(19), reset_less=True)
        rounded = Signal(signed(19), reset_less=True)
        total = Signal(signed(20), reset_less=True)
        scaled = Signal(signed(20 - FRACTION_BITS))
        m.d.sync += [
            partial.eq(products[0] + products[1]),
            rounded.eq(products[2] + (1 << (FRACTION_BITS - 1))),
            total.eq(partial + rounded),
        ]
        m.d.comb += scaled.eq(total >> FRACTION_BITS)
        raw = Signal(8, reset_less=True)
        with m.If(scaled < 0):
            m.d.sync += raw.eq(0)
        with m.Elif(scaled[8:].any()):
            m.d.sync += raw.eq(255)
        with m.Else():
            m.d.sync += raw.eq(scaled)
        m.d.comb += self.raw.eq(raw)

        left = Signal(signed(9))
        mix = Signal(8, reset_less=True)
        above = Signal(signed(9))
        m.d.comb += [left.eq(raw - self.background), above.eq(mix - self.settings.floor)]
        m.d.sync += [mix.eq(Mux(left < 0, 0, left)), self.mix.eq(mix), self.weight.eq(Mux(above < 0, 0, above))]

        full = Signal(reset_less=True)
        m.d.sync += full.eq(self.r.all() | self.g.all() | self.b.all())
        m.d.comb += self.saturated.eq(delayed(m, full, self.latency - 1, "saturated"))
        return m
