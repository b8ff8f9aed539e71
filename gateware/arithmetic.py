"""Delays, sums, products and quotients, one row of carries a clock."""

from amaranth.hdl import C, Cat, Module, Mux, Shape, ShapeCastable, ShapeLike, Signal, Value, signed, unsigned
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

WORD_BITS = 64
MULTIPLIER_BITS = 18


def delayed(m: Module, value, clocks: int, name: str):
    """``value`` as it was ``clocks`` clocks ago; the registers have no reset.

    Words of up to 64 bits hold as many clocks as fit: a simulator then moves one word instead of many.
    """
    plain, shape = Value.cast(value), value.shape()
    bits = len(plain)
    while clocks:
        held = min(clocks, max(1, WORD_BITS // max(1, bits)))
        line = Signal(bits * held, name=f"{name}_{clocks}", reset_less=True)
        m.d.sync += line.eq(Cat(plain, line))
        plain = line[bits * (held - 1) :]
        clocks -= held
    if isinstance(shape, ShapeCastable):
        return shape(plain)
    return plain.as_signed() if shape.signed else plain


def adder_tree(terms: list, register):
    """The sum of ``terms``, two at a time, with a register per level.

    ``register(value, name)`` makes a register that holds ``value``.
    """
    level = 0
    while len(terms) > 1:
        level += 1
        pairs = [terms[at : at + 2] for at in range(0, len(terms), 2)]
        terms = [
            register(pair[0] + pair[1] if len(pair) == 2 else pair[0], f"sum_{level}_{at}")
            for at, pair in enumerate(pairs)
        ]
    return terms[0]


def below(a: Value, b: Value) -> Value:
    """Whether ``a < b``, both unsigned, by the carries of a difference.

    Boards have Yosys make comparisons of LUTs, which saves cells where words are short; of 20 bits it is six LUTs one
    behind the other.
    """
    return (a - b)[-1]


def sums(m: Module, pairs: list, bits: int, name: str) -> list:
    """``a + b`` of each pair of unsigned numbers, one bit more than ``bits``, in one row of carries.

    A row takes an ECP5 cells for its beginning: one long row is less than many short ones.
    """
    firsts, seconds = zip(*pairs, strict=True)
    row = Signal((bits + 1) * len(pairs), name=name)
    m.d.comb += row.eq(_side_by_side(firsts, bits, 0) + _side_by_side(seconds, bits, 0))
    return [row.word_select(at, bits + 1) for at in range(len(pairs))]


def differences(m: Module, pairs: list, bits: int, name: str) -> list:
    """``a - b`` of each pair of unsigned numbers, of ``bits`` and a sign, as :func:`sums` adds."""
    firsts, seconds = zip(*pairs, strict=True)
    row = Signal((bits + 1) * len(pairs), name=name)
    # The bit above a number takes what is borrowed; it stays 1 where nothing is.
    m.d.comb += row.eq(_side_by_side(firsts, bits, 1) - _side_by_side(seconds, bits, 0))
    parts = [row.word_select(at, bits + 1) for at in range(len(pairs))]
    return [Cat(part[:-1], ~part[-1]).as_signed() for part in parts]


def _side_by_side(values, bits: int, above: int):
    return Cat(
        *(Cat(Value.cast(value)[:bits], C(0, bits - len(Value.cast(value)[:bits])), C(above, 1)) for value in values)
    )


class Multiply(wiring.Component):
    """A product per clock, of factors of up to 18 bits: what FPGAs have multipliers for.

    Both factors and the product go through a register. Where the tools don't put those into the multiplier itself, a
    board's platform has the method ``get_multiplier(multiply)``, which returns what takes this component's place:
    it drives ``product`` :attr:`latency` clocks after the factors.

    Parameters
    ----------
    a_shape, b_shape : of the factors, signed or not

    Members
    -------
    a, b : factors
    enable : all registers move; 1 if it is left alone
    product : ``a * b`` of :attr:`latency` clocks with ``enable`` ago; exact, it can't overflow

    Raises
    ------
    ValueError
        A factor is too wide, or has no bits.
    """

    def __init__(self, a_shape: ShapeLike, b_shape: ShapeLike) -> None:
        a, b = Shape.cast(a_shape), Shape.cast(b_shape)
        for name, shape in (("a", a), ("b", b)):
            if not 1 <= shape.width <= MULTIPLIER_BITS:
                raise ValueError(f"factor {name} has {shape.width} bits; 1 to {MULTIPLIER_BITS} are possible")
        product = Shape(a.width + b.width, a.signed or b.signed)
        super().__init__({"a": In(a), "b": In(b), "enable": In(1, init=1), "product": Out(product)})

    latency = 2
    """Clocks from the factors to the product."""

    def elaborate(self, platform):
        if hasattr(platform, "get_multiplier"):
            return platform.get_multiplier(self)
        m = Module()
        a = Signal.like(self.a, reset_less=True)
        b = Signal.like(self.b, reset_less=True)
        product = Signal.like(self.product, reset_less=True)
        with m.If(self.enable):
            m.d.sync += [a.eq(self.a), b.eq(self.b), product.eq(a * b)]
        m.d.comb += self.product.eq(product)
        return m


class AddSubtract(wiring.Component):
    """``a + b`` or ``a - b`` in one row of carries.

    Synthesis would put a row of LUTs in front of it. Where the FPGA's carries can do it all, a board's platform has the
    method ``get_add_subtract(add_subtract)``, which returns what takes this component's place.

    Parameters
    ----------
    bits : of each number

    Members
    -------
    a, b : numbers
    subtract : ``b`` is subtracted
    o : the result, modulo ``1 << bits``
    """

    def __init__(self, bits: int) -> None:
        super().__init__({"a": In(bits), "b": In(bits), "subtract": In(1), "o": Out(bits)})

    def elaborate(self, platform):
        if hasattr(platform, "get_add_subtract"):
            return platform.get_add_subtract(self)
        m = Module()
        inverted = self.b ^ self.subtract.replicate(len(self.b))
        m.d.comb += self.o.eq((Cat(self.subtract, self.a) + Cat(self.subtract, inverted))[1:])
        return m


class SerialDivider(wiring.Component):
    """An unsigned quotient now and then, one or two bits of it a clock.

    One bit a clock is by non-restoring division: what is left may be negative, and then the divisor is added and not
    subtracted. It is what a restoring division would try, so the bits are the same; but nothing waits for the sign.

    Parameters
    ----------
    divisor_bits : width of the divisor
    quotient_bits : width of the quotient
    bits_per_clock : 1, or 2 for half the clocks and about three times the logic

    Members
    -------
    start : strobe that takes dividend and divisor; while a division is under way it starts anew
    dividend : less than ``divisor << quotient_bits``; otherwise the quotient is meaningless
    divisor : not 0
    busy : a division is under way
    done : strobe, :attr:`latency` clocks after ``start``
    quotient : ``dividend // divisor``, from ``done`` until the next ``start``

    Raises
    ------
    ValueError
        A width is less than 1, or ``bits_per_clock`` neither 1 nor 2.
    """

    def __init__(self, divisor_bits: int, quotient_bits: int, bits_per_clock: int = 1) -> None:
        if divisor_bits < 1 or quotient_bits < 1:
            raise ValueError(f"a divider of {divisor_bits} and {quotient_bits} bits; at least 1 each is needed")
        if bits_per_clock not in (1, 2):
            raise ValueError(f"bits_per_clock is {bits_per_clock}; 1 and 2 are possible")
        self.divisor_bits = divisor_bits
        self.quotient_bits = quotient_bits
        self.bits_per_clock = bits_per_clock
        super().__init__(
            {
                "start": In(1),
                "dividend": In(divisor_bits + quotient_bits),
                "divisor": In(divisor_bits),
                "busy": Out(1),
                "done": Out(1),
                "quotient": Out(quotient_bits),
            }
        )

    @property
    def latency(self) -> int:
        """Clocks from ``start`` to ``done``: one to load, one for each digit."""
        return 1 + self._digits

    @property
    def _digits(self) -> int:
        return -(-self.quotient_bits // self.bits_per_clock)

    def elaborate(self, platform):
        m = Module()
        signed_bits = self.divisor_bits + 2 - self.bits_per_clock
        rest = Signal(signed_bits, reset_less=True)
        divisor = Signal(self.divisor_bits, reset_less=True)
        bits = Signal(self._digits * self.bits_per_clock)  # with one more, 0, if odd
        left = Signal(self._digits)  # a one that is shifted out with the last digit
        busy = Signal()
        if self.bits_per_clock == 1:
            m.submodules.step = step = AddSubtract(signed_bits)
            m.d.comb += [step.a.eq(Cat(bits[-1], rest)), step.b.eq(divisor), step.subtract.eq(~rest[-1])]
            reduced, digit = step.o, ~step.o[-1]
        else:
            triple = Signal(self.divisor_bits + 2, reset_less=True)
            with m.If(self.start):
                m.d.sync += triple.eq(_triple(self.divisor))
            reduced, digit = _divide_two_bits(m, rest, bits[-2:], divisor, triple, "step")
        m.d.comb += [self.busy.eq(busy), self.quotient.eq(bits)]
        m.d.sync += self.done.eq(0)
        with m.If(self.start):
            # The dividend's low bits leave at the top while the quotient's enter at the bottom.
            m.d.sync += [
                Cat(bits, rest).eq(self.dividend),
                divisor.eq(self.divisor),
                left.eq(1),
                busy.eq(1),
            ]
        with m.Elif(busy):
            m.d.sync += [
                bits.eq(Cat(digit, bits)),
                rest.eq(reduced),
                left.eq(left << 1),
                busy.eq(~left[-1]),
                self.done.eq(left[-1]),
            ]
        return m


def _triple(divisor):
    return divisor + (divisor << 1)


def _divide_two_bits(m: Module, rest, next_bits, divisor, triple, name: str):
    """Rest and two bits of the quotient after two more of the dividend; ``rest < divisor`` before and after.

    Three differences side by side, of which the least that fits is the rest.
    """
    width = len(divisor)
    trial = Signal(unsigned(width + 2), name=f"trial_{name}")
    m.d.comb += trial.eq(Cat(next_bits, rest))
    rests, fits = [trial[:width]], []
    for times, multiple in enumerate((divisor, divisor << 1, triple), 1):
        difference = Signal(signed(width + 3), name=f"difference{times}_{name}")
        fit = Signal(name=f"fits{times}_{name}")
        m.d.comb += [difference.eq(trial - multiple), fit.eq(~difference[-1])]
        rests.append(difference[:width])
        fits.append(fit)
    once, twice, thrice = fits
    reduced = Mux(twice, Mux(thrice, rests[3], rests[2]), Mux(once, rests[1], rests[0]))
    return reduced, Cat(Mux(twice, thrice, once), twice)
