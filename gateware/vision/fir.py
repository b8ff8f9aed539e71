"""Zero crossings of the smoothed derivative of a row."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak.reference import fir
from magtrak.reference.fir import CONTRAST_MAX, DERIVATIVE_MAX, REACH, TAPS

from ..arithmetic import Multiply, adder_tree, differences
from .lookahead import LOOKAHEAD


class Fir(wiring.Component):
    """A 15-tap derivative and its falling zero crossings, as :func:`magtrak.reference.fir.crossings` defines them.

    Every register moves by columns, not by clocks: a result stands ``LOOKAHEAD`` columns after its column entered,
    beside the :class:`~gateware.vision.lookahead.Column`, until the next step. Products are sums of two
    shifted terms, or come from multipliers where a platform has them (see :class:`~gateware.arithmetic.Multiply`).

    Members
    -------
    step, mix, row_first : from :class:`~gateware.vision.lookahead.Lookahead`
    falls : the derivative is negative here for the first time after it was positive
    distance : columns back to the last one where it was positive, at least 1
    rise : the derivative there
    contrast : ``rise`` and the magnitude of the derivative here
    near_first : that column is one of the first ``REACH`` of the row
    late : ``rise`` is at least that magnitude: the crossing is in the second half of the way from there to here
    """

    step: In(1)
    mix: In(8)
    row_first: In(1)
    falls: Out(1)
    distance: Out(12)
    rise: Out(DERIVATIVE_MAX.bit_length())
    contrast: Out(CONTRAST_MAX.bit_length())
    near_first: Out(1)
    late: Out(1)

    reference = staticmethod(fir.crossings)

    latency = LOOKAHEAD
    """Steps from a column's ``mix`` to its result."""

    def elaborate(self, platform):
        m = Module()

        def register(value, name):
            held = Signal(value.shape(), name=name, reset_less=True)
            with m.If(self.step):
                m.d.sync += held.eq(value)
            return held

        firsts = [self.row_first]
        for place in range(1, LOOKAHEAD + REACH - 1):
            firsts.append(register(firsts[-1], f"first_{place}"))

        # Steps 1 to 8: the window. In its middle, the first column of a row fills what is behind: the left border is
        # replicated.
        window = []
        for place in range(2 * REACH + 1):
            before = window[-1] if window else self.mix
            if place > REACH:
                before = Mux(firsts[REACH], window[REACH - 1], before)
            window.append(register(before, f"window_{place}"))
        # Steps 9 and 10: differences of at most 255, products; 11 and 12: sums; 13: the derivative.
        pairs = [(window[REACH - k], window[REACH + k]) for k in range(1, REACH + 1)]
        half = (REACH + 1) // 2
        steps = differences(m, pairs[:half], 8, "low_differences") + differences(m, pairs[half:], 8, "high_differences")
        terms = []
        for k, (tap, difference) in enumerate(zip(TAPS, steps, strict=True), 1):
            if hasattr(platform, "get_multiplier") and tap.bit_count() > 1:
                m.submodules[f"multiply_{k}"] = multiply = Multiply(signed(9), tap.bit_length())
                m.d.comb += [multiply.a.eq(difference), multiply.b.eq(tap), multiply.enable.eq(self.step)]
                terms.append(multiply.product)
            else:
                terms.append(register(_times(register(difference, f"difference_{k}"), tap), f"product_{k}"))
        slope = Signal(signed(DERIVATIVE_MAX.bit_length() + 1))
        m.d.comb += slope.eq(adder_tree(terms, register))
        # Step 14: its sign.
        here = register(slope, "here")
        up, down = register(slope > 0, "up"), register(slope < 0, "down")
        # Step 15: crossings.
        armed = Signal()
        risen = Signal(self.rise.shape(), reset_less=True)
        near = Signal(reset_less=True)
        since = Signal(12, reset_less=True)
        with m.If(self.step):
            m.d.sync += [
                armed.eq(up | (armed & ~firsts[14] & ~down)),
                since.eq(Mux(up, 1, since + 1)),
                self.falls.eq(down & armed & ~firsts[14]),
                self.distance.eq(since),
                self.rise.eq(risen),
                self.near_first.eq(near),
                self.contrast.eq(risen - here),
                self.late.eq(risen + here >= 0),
            ]
            with m.If(up):
                m.d.sync += [risen.eq(here), near.eq(Cat(firsts[14:]).any())]
        return m


def _times(value, factor: int):
    """``value * factor`` as one sum or difference; the taps are chosen so that it can be."""
    for high in range(factor.bit_length() + 1):
        if factor == 1 << high:
            return value << high
        for low in range(high):
            if factor == (1 << high) + (1 << low):
                return (value << high) + (value << low)
            if factor == (1 << high) - (1 << low):
                return (value << high) - (value << low)
    raise ValueError(f"tap {factor} is no sum or difference of two powers of two")
