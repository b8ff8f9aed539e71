"""Products and quotients without an inferred multiplier: shift, add, subtract, one row of carries a clock."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed, unsigned
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out


def delayed(m: Module, value, clocks: int, name: str):
    """``value`` as it was ``clocks`` clocks ago; the registers have no reset."""
    for clock in range(clocks):
        register = Signal(value.shape(), name=f"{name}_{clock + 1}", reset_less=True)
        m.d.sync += register.eq(value)
        value = register
    return value


def adder_tree(terms: list, register):
    """The sum of ``terms``, two at a time, with a register per level; the levels are :func:`tree_latency`.

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


def tree_latency(terms: int) -> int:
    """Clocks that :func:`adder_tree` takes for so many terms."""
    return (terms - 1).bit_length()


class Multiply(wiring.Component):
    """A product of an unsigned and a signed number, one per clock, by shift and add.

    Latency is constant and throughput one a clock; a board with a registered hardware multiplier may put that
    in its place with the same latency.

    Parameters
    ----------
    unsigned_bits : width of ``a``
    signed_bits : width of ``b``, at least 2

    Members
    -------
    a : unsigned factor
    b : signed factor
    product : ``a * b`` of :attr:`latency` clocks ago; exact, it can't overflow

    Raises
    ------
    ValueError
        A width is too small.
    """

    def __init__(self, unsigned_bits: int, signed_bits: int) -> None:
        if unsigned_bits < 1:
            raise ValueError(f"unsigned_bits is {unsigned_bits}; at least 1 is needed")
        if signed_bits < 2:
            raise ValueError(f"signed_bits is {signed_bits}; at least 2 are needed")
        self.unsigned_bits = unsigned_bits
        self.signed_bits = signed_bits
        super().__init__(
            {
                "a": In(unsigned_bits),
                "b": In(signed(signed_bits)),
                "product": Out(signed(unsigned_bits + signed_bits)),
            }
        )

    @property
    def latency(self) -> int:
        """Clocks from the factors to the product."""
        return tree_latency(self.signed_bits)

    def elaborate(self, platform):
        m = Module()
        terms = [Mux(self.b[bit], self.a, 0) << bit for bit in range(self.signed_bits - 1)]
        terms.append(-(Mux(self.b[-1], self.a, 0) << (self.signed_bits - 1)))  # the sign bit's weight is negative
        m.d.comb += self.product.eq(adder_tree(terms, lambda value, name: delayed(m, value, 1, name)))
        return m


class PipelinedDivider(wiring.Component):
    """An unsigned quotient per clock: restoring division, one bit of the quotient a stage.

    Source: any text on computer arithmetic, e.g. B. Parhami, *Computer Arithmetic*, section 13.2.

    Parameters
    ----------
    divisor_bits : width of the divisor
    quotient_bits : width of the quotient

    Members
    -------
    dividend : less than ``divisor << quotient_bits``; otherwise the quotient is meaningless
    divisor : not 0
    quotient : ``dividend // divisor`` of :attr:`latency` clocks ago

    Raises
    ------
    ValueError
        A width is less than 1.
    """

    def __init__(self, divisor_bits: int, quotient_bits: int) -> None:
        if divisor_bits < 1 or quotient_bits < 1:
            raise ValueError(f"a divider of {divisor_bits} and {quotient_bits} bits; at least 1 each is needed")
        self.divisor_bits = divisor_bits
        self.quotient_bits = quotient_bits
        super().__init__(
            {
                "dividend": In(divisor_bits + quotient_bits),
                "divisor": In(divisor_bits),
                "quotient": Out(quotient_bits),
            }
        )

    @property
    def latency(self) -> int:
        """Clocks from dividend and divisor to the quotient."""
        return self.quotient_bits

    def elaborate(self, platform):
        m = Module()
        rest, divisor = self.dividend[self.quotient_bits :], self.divisor
        low = self.dividend[: self.quotient_bits]
        quotient = None
        for stage in range(self.quotient_bits):
            rest, bit = _divide_step(m, rest, low[-1], divisor, f"{stage}")
            rest = delayed(m, rest, 1, f"rest{stage}")
            quotient = delayed(m, bit if quotient is None else Cat(bit, quotient), 1, f"quotient{stage}")
            if stage + 1 < self.quotient_bits:
                divisor = delayed(m, divisor, 1, f"divisor{stage}")
                low = delayed(m, low[:-1], 1, f"low{stage}")
        m.d.comb += self.quotient.eq(quotient)
        return m


class SerialDivider(wiring.Component):
    """An unsigned quotient now and then: restoring division, one bit of the quotient a clock.

    Parameters
    ----------
    divisor_bits : width of the divisor
    quotient_bits : width of the quotient

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
        A width is less than 1.
    """

    def __init__(self, divisor_bits: int, quotient_bits: int) -> None:
        if divisor_bits < 1 or quotient_bits < 1:
            raise ValueError(f"a divider of {divisor_bits} and {quotient_bits} bits; at least 1 each is needed")
        self.divisor_bits = divisor_bits
        self.quotient_bits = quotient_bits
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
        """Clocks from ``start`` to ``done``: one to load, one for each bit."""
        return 1 + self.quotient_bits

    def elaborate(self, platform):
        m = Module()
        rest = Signal(self.divisor_bits, reset_less=True)
        divisor = Signal(self.divisor_bits, reset_less=True)
        left = Signal(self.quotient_bits)  # a one that is shifted out with the last bit
        reduced, bit = _divide_step(m, rest, self.quotient[-1], divisor, "step")
        m.d.comb += self.busy.eq(left.any())
        m.d.sync += self.done.eq(0)
        with m.If(self.start):
            # The dividend's low bits leave `quotient` at the top while the result enters at the bottom.
            m.d.sync += [
                Cat(self.quotient, rest).eq(self.dividend),
                divisor.eq(self.divisor),
                left.eq(1),
            ]
        with m.Elif(self.busy):
            m.d.sync += [
                self.quotient.eq(Cat(bit, self.quotient)),
                rest.eq(reduced),
                left.eq(left << 1),
                self.done.eq(left[-1]),
            ]
        return m


def _divide_step(m: Module, rest, next_bit, divisor, name: str):
    """Rest and quotient bit after one more bit of the dividend; ``rest < divisor`` before and after."""
    trial = Signal(unsigned(len(divisor) + 1), name=f"trial_{name}")
    difference = Signal(signed(len(divisor) + 2), name=f"difference_{name}")
    bit = Signal(name=f"bit_{name}")
    m.d.comb += [trial.eq(Cat(next_bit, rest)), difference.eq(trial - divisor), bit.eq(~difference[-1])]
    return Mux(bit, difference[: len(divisor)], trial[: len(divisor)]), bit
