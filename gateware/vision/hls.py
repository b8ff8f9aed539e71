"""RGB to hue, luminance and saturation, one pixel a clock."""

from functools import cache

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak import reference

from ..arithmetic import MULTIPLIER_BITS, Multiply, delayed
from ..memory import BlockRom


class Colour(data.Struct):
    """A colour of 8 bits each: hue in 1/256 turn, luminance and saturation 255 = 1."""

    hue: 8
    luminance: 8
    saturation: 8


SEXTANTS = ((0, 3), (43, 1), (85, 5), (128, 3), (171, 1), (213, 5))
"""Sixths of the hue circle: red to yellow, to green, to cyan, to blue, to magenta, to red.

Each has the hue (1/256 turn) from which its quotient counts, and what 6 * 256 * hue lies above that at its beginning,
in units of delta, with half a step added to round: the exact start is 256 / 6 * k of sextant k, so the second number is
256 * k + 3 - 6 * start."""

HUE_BITS, SATURATION_BITS = 17, 16
"""Bits after the point of the products."""

OFFSET_BITS = 10
"""Bits after the point of what a sextant adds to its product."""

SATURATIONS = 512
"""Where the factors of the saturation begin in the table."""


def hue_offset(offset: int) -> int:
    """A sextant's second number divided by 6, rounded up: Q3.10."""
    return -(-(offset << OFFSET_BITS) // 6)


SIZES = (64, 16, 4)
"""Divisors below these are scaled by 4, 16, 64, and so are the numbers that they divide."""


def shift(divisor: int) -> int:
    """Bits by which a divisor of 8 bits is scaled."""
    return 2 * sum(divisor < size for size in SIZES)


@cache
def factors() -> tuple[int, ...]:
    """Reciprocals for all differences (0 to 255) of the hue, then for all sums (0 to 510) of the saturation.

    Each is the least number of which every product, shifted and rounded as :class:`HLS` does, is right: there is such a
    number for each divisor, which is why the multiplication is exact. 18 bits are enough since both factors are scaled
    by the divisor's size.

    Raises
    ------
    ArithmeticError
        There is none: the bits after the point are too few.
    """
    hues, saturations = [0], [0]
    for delta in range(1, 256):
        bounds = [
            ((256 * way + offset * delta) // (6 * delta), hue_offset(offset) << (HUE_BITS - OFFSET_BITS), way)
            for way in range(1, delta + 1)
            for _, offset in SEXTANTS[:3]
        ]
        hues.append(_factor(bounds, HUE_BITS, shift(delta)))
    for total in range(1, 511):
        span = min(total, 510 - total)
        half = 1 << (SATURATION_BITS - 1)
        bounds = [((510 * delta + span) // (2 * span), half, delta) for delta in range(1, span + 1)]
        saturations.append(_factor(bounds, SATURATION_BITS, shift(span)) if span else 0)
    return (*hues, *[0] * (SATURATIONS - len(hues)), *saturations)


def _factor(bounds: list[tuple[int, int, int]], bits: int, up: int) -> int:
    """The least factor with ``((number << up) * factor + added) >> bits == quotient`` for all of ``bounds``."""
    least = max(-(-((quotient << bits) - added) // (number << up)) for quotient, added, number in bounds)
    most = min((((quotient + 1) << bits) - 1 - added) // (number << up) for quotient, added, number in bounds)
    if not least <= most < 1 << MULTIPLIER_BITS:
        raise ArithmeticError(f"no factor of {MULTIPLIER_BITS} bits: {least} to {most}")
    return least


class HLS(wiring.Component):
    """Hue, luminance and saturation of each pixel, as :func:`magtrak.reference.hls` defines them.

    One pixel a clock, constant latency, no state from one pixel to the next. The reference counts hue by thirds of
    the circle; sixths are the same numbers and keep the quotient at 6 bits: within a sextant one channel moves from
    the least to the greatest or back, by ``way``, and ``hue = start + (256 * way + offset * delta) // (6 * delta)``.
    Saturation is the difference of greatest and least, divided by their sum or by what is missing to twice white.

    Instead of dividing it multiplies by reciprocals from a table (:func:`factors`) of one block RAM, exactly.

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

    latency = 6 + Multiply.latency
    """Clocks from the pixel to its colour: order, sort, subtract, look up (2), multiply, add."""

    def elaborate(self, platform):
        m = Module()
        # 1: order
        rg = Signal()
        gb = Signal()
        rb = Signal()
        m.d.sync += [rg.eq(self.r >= self.g), gb.eq(self.g >= self.b), rb.eq(self.r >= self.b)]
        r, g, b = (delayed(m, getattr(self, name), 1, name) for name in "rgb")

        # 2: greatest, least, the two of which `way` is the difference, and the sextant. Greys are in the first, which
        # starts at 0.
        high, low, plus, minus = (Signal(8, reset_less=True, name=n) for n in ("high", "low", "plus", "minus"))
        sextant = Signal(range(len(SEXTANTS)), reset_less=True)
        with m.If(rg & rb):
            m.d.sync += [high.eq(r), minus.eq(b), plus.eq(Mux(gb, g, r)), sextant.eq(Mux(gb, 0, 5))]
        with m.Elif(gb):
            m.d.sync += [high.eq(g), minus.eq(r), plus.eq(Mux(rb, g, b)), sextant.eq(Mux(rb, 1, 2))]
        with m.Else():
            m.d.sync += [high.eq(b), minus.eq(g), plus.eq(Mux(rg, r, b)), sextant.eq(Mux(rg, 4, 3))]
        m.d.sync += low.eq(Mux(rb & gb, b, Mux(~rg & ~rb, r, g)))

        # 3: subtract
        delta = Signal(8, reset_less=True)
        total = Signal(9, reset_less=True)
        way = Signal(8, reset_less=True)
        m.d.sync += [delta.eq(high - low), total.eq(high + low), way.eq(plus - minus)]

        # 4 and 5: look up
        m.submodules.table = table = BlockRom(MULTIPLIER_BITS, 2 * SATURATIONS, factors())
        over = total ^ 0x1FF  # what is missing to twice white, and 1
        up_hue = Signal(2, reset_less=True)
        up_saturation = Signal(2, reset_less=True)
        m.d.sync += [
            up_hue.eq(_up([_at_least(delta, size) for size in SIZES])),
            up_saturation.eq(_up([_at_least(total, size) & _above(over, size) for size in SIZES])),
        ]
        products = []
        for port, name, address, number, up in (
            (0, "hue", delta, way, up_hue),
            (1, "saturation", Cat(total, Const(1, 1)), delta, up_saturation),
        ):
            m.d.comb += table.address[port].eq(address)
            number = delayed(m, number, 1, f"{name}_number")
            scaled = Signal(8, name=f"{name}_scaled", reset_less=True)
            m.d.sync += scaled.eq(Array(number << 2 * steps for steps in range(4))[up])
            m.submodules[f"multiply_{name}"] = multiply = Multiply(8, MULTIPLIER_BITS)
            m.d.comb += [multiply.a.eq(scaled), multiply.b.eq(table.word[port])]
            products.append(multiply.product)

        # 8: add and round
        hue = Signal(8 + OFFSET_BITS, reset_less=True)
        saturation = Signal(8, reset_less=True)
        starts = Array((start << OFFSET_BITS) + hue_offset(offset) for start, offset in SEXTANTS)
        m.d.sync += [
            hue.eq((products[0] >> (HUE_BITS - OFFSET_BITS)) + starts[delayed(m, sextant, 5, "sextant")]),
            saturation.eq((products[1] >> SATURATION_BITS) + products[1][SATURATION_BITS - 1]),
        ]
        m.d.comb += [
            self.o.hue.eq(hue >> OFFSET_BITS),
            self.o.luminance.eq(delayed(m, (total + 1) >> 1, self.latency - 3, "luminance")),
            self.o.saturation.eq(saturation),
        ]
        return m


def _up(reached: list):
    """In how many steps of 4 a divisor is scaled that reaches these of :data:`SIZES`."""
    return Cat(~reached[0] & (reached[1] | ~reached[2]), ~reached[1])


def _at_least(value, size: int):
    """``value >= size``, a power of two."""
    return value[size.bit_length() - 1 :].any()


def _above(value, size: int):
    """``value > size``, a power of two."""
    bit = size.bit_length() - 1
    return value[bit + 1 :].any() | (value[bit] & value[:bit].any())
