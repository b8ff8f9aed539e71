"""RGB to hue, luminance and saturation with multipliers and memories of 16 bits, as an iCE40 has them."""

from functools import cache

from amaranth.hdl import Array, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak import reference

from ..arithmetic import Multiply, delayed
from ..memory import BlockRam
from .hls import OFFSET_BITS, SEXTANTS, hue_offset

FACTOR_BITS = 16

HUE_BITS, SATURATION_BITS = 17, 15
"""Bits after the point of the products."""

SATURATION_ADDED = (1 << 14) + (1 << 6)
"""What rounds a saturation. Half a step, 2**14, would be enough for factors of 17 bits: of all sums, 16416 to 16450
leave room for each divisor's factor to be exact."""


def shift(divisor: int) -> int:
    """Bits by which a divisor of 8 bits, and the number that it divides, is scaled: until its top bit is set."""
    return 8 - max(divisor, 1).bit_length()


@cache
def factors() -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Reciprocals for each difference of the hue, and for each span of the saturation, 0 to 255.

    As :func:`gateware.vision.hls.factors`: the least numbers that make every product right.

    Raises
    ------
    ArithmeticError
        There is none for a divisor.
    """
    hues, saturations = [0], [0]
    for divisor in range(1, 256):
        numbers = range(1, divisor + 1)
        bounds = [
            ((256 * way + offset * divisor) // (6 * divisor), hue_offset(offset) << (HUE_BITS - OFFSET_BITS), way)
            for way in numbers
            for _, offset in SEXTANTS[:3]
        ]
        hues.append(_factor(bounds, HUE_BITS, shift(divisor)))
        bounds = [((510 * delta + divisor) // (2 * divisor), SATURATION_ADDED, delta) for delta in numbers]
        saturations.append(_factor(bounds, SATURATION_BITS, shift(divisor)))
    return tuple(hues), tuple(saturations)


def _factor(bounds: list[tuple[int, int, int]], bits: int, up: int) -> int:
    """The least factor with ``((number << up) * factor + added) >> bits == quotient`` for all of ``bounds``."""
    least = max(-(-((quotient << bits) - added) // (number << up)) for quotient, added, number in bounds)
    most = min((((quotient + 1) << bits) - 1 - added) // (number << up) for quotient, added, number in bounds)
    if not least <= most < 1 << FACTOR_BITS + 1 or least >= 1 << FACTOR_BITS:
        raise ArithmeticError(f"no factor of {FACTOR_BITS} bits: {least} to {most}")
    return least


class HLS16(wiring.Component):
    """Hue, luminance and saturation of each pixel, as :func:`magtrak.reference.hls` defines them.

    It computes what :class:`~gateware.vision.hls.HLS` does, for cards of few cells and a slow clock: two tables of 256
    words of 16 bits, two products of 8 by 16 bits, and more logic between two registers. One pixel a clock, constant
    latency, no state from one pixel to the next.

    Members
    -------
    r, g, b : colour
    luminance : of the pixel of :attr:`luminance_latency` clocks ago
    hue, saturation : of the pixel of :attr:`latency` clocks ago
    """

    r: In(8)
    g: In(8)
    b: In(8)
    luminance: Out(8)
    hue: Out(8)
    saturation: Out(8)

    reference = staticmethod(reference.hls)

    luminance_latency = 2
    """Clocks from the pixel to its luminance: sort, add."""

    latency = 2 + Multiply.latency
    """Clocks from the pixel to its hue and saturation: sort, look up, multiply."""

    def elaborate(self, platform):
        m = Module()
        # 1: greatest, least, the two of which `way` is the difference, and the sextant, as in `HLS`.
        r, g, b = self.r, self.g, self.b
        rg = Signal()
        gb = Signal()
        rb = Signal()
        m.d.comb += [rg.eq(r >= g), gb.eq(g >= b), rb.eq(r >= b)]
        high, low, plus, minus = (Signal(8, reset_less=True, name=n) for n in ("high", "low", "plus", "minus"))
        sextant = Signal(range(len(SEXTANTS)), reset_less=True)
        with m.If(rg & rb):
            m.d.sync += [high.eq(r), minus.eq(b), plus.eq(Mux(gb, g, r)), sextant.eq(Mux(gb, 0, 5))]
        with m.Elif(gb):
            m.d.sync += [high.eq(g), minus.eq(r), plus.eq(Mux(rb, g, b)), sextant.eq(Mux(rb, 1, 2))]
        with m.Else():
            m.d.sync += [high.eq(b), minus.eq(g), plus.eq(Mux(rg, r, b)), sextant.eq(Mux(rg, 4, 3))]
        m.d.sync += low.eq(Mux(rb & gb, b, Mux(~rg & ~rb, r, g)))

        # 2: subtract, look up. `span` is the sum, or what is missing to twice white: 511 - (total + 1) is ~(total + 1).
        delta = Signal(8)
        way = Signal(8)
        total = Signal(9)
        more = Signal(9)
        span = Signal(8)
        m.d.comb += [
            delta.eq(high - low),
            way.eq(plus - minus),
            total.eq(high + low),
            more.eq(total + 1),
            span.eq(Mux(more[8], ~more[:8], total[:8])),
        ]
        m.d.sync += self.luminance.eq(more >> 1)
        products = []
        for name, divisor, number, table in zip(
            ("hue", "saturation"), (delta, span), (way, delta), factors(), strict=True
        ):
            m.submodules[f"table_{name}"] = reciprocals = BlockRam(FACTOR_BITS, 256, table, block=True)
            m.submodules[f"multiply_{name}"] = multiply = Multiply(8, FACTOR_BITS)
            scaled = Signal(8, name=f"{name}_scaled", reset_less=True)
            up = Signal(3, name=f"{name}_up")
            with m.Switch(divisor):
                for steps in range(8):
                    with m.Case("0" * steps + "1" + "-" * (7 - steps)):
                        m.d.comb += up.eq(steps)
            m.d.sync += scaled.eq((number << up)[:8])  # number <= divisor
            m.d.comb += [
                reciprocals.read.addr.eq(divisor),
                reciprocals.read.en.eq(1),
                multiply.a.eq(scaled),
                multiply.b.eq(reciprocals.read.data),
            ]
            products.append(multiply.product)

        # After the products: add and round.
        hue = Signal(8 + OFFSET_BITS)
        saturation = Signal(24)
        starts = Array((start << OFFSET_BITS) + hue_offset(offset) for start, offset in SEXTANTS)
        m.d.comb += [
            hue.eq(
                (products[0] >> (HUE_BITS - OFFSET_BITS)) + starts[delayed(m, sextant, self.latency - 1, "sextant")]
            ),
            saturation.eq(products[1] + SATURATION_ADDED),
            self.hue.eq(hue >> OFFSET_BITS),
            self.saturation.eq(saturation >> SATURATION_BITS),
        ]
        return m
