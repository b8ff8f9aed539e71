"""Pulse-width modulation for an H-bridge."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

SHORTEST_PERIOD = 16
"""Clocks of the shortest period: what the multiplication needs."""


class Pwm(wiring.Component):
    """Sign-magnitude PWM: one output switches, another tells the direction.

    In each period ``pwm`` is high for the first ``high`` clocks, with ``high`` as :meth:`reference` has it,
    exactly; never for a whole period. ``duty`` and ``period`` are taken together, at the start of each
    period, and rule the one after it, so a pulse is never cut or torn. They take effect after one to two periods.

    Where the sign changes, one whole period passes with ``pwm`` low, and ``direction`` turns in the middle of it:
    half a period of dead time before and after. A duty of 0 keeps the direction.

    ``brake`` alone acts at once: one clock later ``pwm`` is low and ``braking`` high. When it ends, pulses come
    back at the start of a period. After reset all outputs are 0, for the first period too.

    Members
    -------
    period : clocks, less than 16 acts as 16
    duty : signed Q0.15; -32768 acts as -32767
    brake : short the motor
    pwm : high while the bridge drives
    direction : 1 for a negative duty
    braking : high while the bridge brakes
    """

    period: In(16)
    duty: In(signed(16))
    brake: In(1)
    pwm: Out(1)
    direction: Out(1)
    braking: Out(1)

    @staticmethod
    def reference(period: int, duty: int) -> int:
        """The definition: clocks that ``pwm`` is high in a period."""
        return min(abs(duty), 32767) * max(period, SHORTEST_PERIOD) // 32768

    def elaborate(self, platform: object) -> Module:
        m = Module()

        # The period that runs, and where it is.
        position, last, high = Signal(16), Signal(16, init=SHORTEST_PERIOD - 1), Signal(16)
        end, middle = Signal(), Signal()
        reversing, blocked = Signal(), Signal()
        m.d.comb += [end.eq(position == last), middle.eq(position == last >> 1)]
        m.d.sync += position.eq(Mux(end, 0, position + 1))

        # The next one. Multiply |duty| by the period, lowest bit first: each step drops a bit of the product that
        # later ones cannot change, so 15 steps leave floor(|duty| * period / 2**15), with one 17-bit addition each.
        next_length, next_backward = Signal(16, init=SHORTEST_PERIOD), Signal()
        factor = Signal(15)
        product = Signal(16)  # |duty| < 2**15, so what is left is less than the period
        partial = Signal(17)
        steps = Signal(range(16))
        moving = Signal()
        m.d.comb += partial.eq(product + Mux(factor[0], next_length, 0))
        with m.If(end):
            m.d.sync += [
                next_length.eq(Mux(self.period[4:].any(), self.period, SHORTEST_PERIOD)),
                next_backward.eq(self.duty < 0),
                factor.eq(Mux(self.duty < 0, Mux(self.duty == -32768, 32767, -self.duty), self.duty)),
                moving.eq(self.duty != 0),
                product.eq(0),
                steps.eq(15),
            ]
        with m.Elif(steps != 0):
            m.d.sync += [product.eq(partial >> 1), factor.eq(Cat(factor[1:], 0)), steps.eq(steps - 1)]

        with m.If(end):
            turn = moving & (next_backward != self.direction)
            m.d.sync += [last.eq(next_length - 1), high.eq(Mux(turn, 0, product)), reversing.eq(turn)]
        with m.Elif(reversing & middle):
            m.d.sync += self.direction.eq(~self.direction)

        with m.If(self.brake):
            m.d.sync += blocked.eq(1)
        with m.Elif(end):
            m.d.sync += blocked.eq(0)
        m.d.sync += [
            self.pwm.eq((position < high) & ~blocked & ~self.brake),
            self.braking.eq(self.brake),
        ]
        return m
