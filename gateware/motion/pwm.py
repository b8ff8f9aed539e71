"""Pulse-width modulation for an H-bridge."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

SHORTEST_PERIOD = 16
"""Clocks of the shortest period: what the multiplication needs."""


class Pwm(wiring.Component):
    """PWM of one of the two usual kinds.

    Sign-magnitude: ``pwm`` switches, ``direction`` tells the direction. In each period ``pwm`` is high for the first
    ``high`` clocks, with ``high`` as :meth:`reference` has it, exactly; never for a whole period. Where the sign
    changes, one whole period passes with ``pwm`` low, and ``direction`` turns in the middle of it: half a period of
    dead time before and after. A duty of 0 keeps the direction.

    Locked anti-phase: ``pwm`` is the bridge's enable and stays high; ``direction`` switches, and is low (forward) for
    the first ``high`` clocks of each period and high for the rest: half and half is standstill. Dead time is the
    bridge's.

    ``duty``, ``period`` and ``antiphase`` are taken together, at the start of each period, and rule the one after it,
    so a pulse is never cut or torn. They take effect after one to two periods.

    ``brake``, and ``enable`` low, act at once: one clock later ``pwm`` is low, and ``braking`` is as ``brake``. When
    they end, pulses come back at the start of a period. After reset all outputs are 0, for the first period too.

    Members
    -------
    period : clocks, less than 16 acts as 16
    duty : signed Q0.15; -32768 acts as -32767
    brake : short the motor
    enable : 0: the bridge is off
    antiphase : locked anti-phase instead of sign-magnitude; taken at the start of a period
    pwm : high while the bridge drives
    direction : 1 for a negative duty; switches in locked anti-phase
    braking : high while the bridge brakes
    """

    period: In(16)
    duty: In(signed(16))
    brake: In(1)
    enable: In(1, init=1)
    antiphase: In(1)
    pwm: Out(1)
    direction: Out(1)
    braking: Out(1)

    @staticmethod
    def reference(period: int, duty: int, antiphase: bool = False) -> int:
        """The definition: clocks of a period that ``pwm`` is high, or ``direction`` low in locked anti-phase."""
        if antiphase:
            return (max(duty, -32767) + 32768 >> 1) * max(period, SHORTEST_PERIOD) // 32768
        return min(abs(duty), 32767) * max(period, SHORTEST_PERIOD) // 32768

    def elaborate(self, platform: object) -> Module:
        m = Module()

        # The period that runs, and where it is.
        position, last, high = Signal(16), Signal(16, init=SHORTEST_PERIOD - 1), Signal(16)
        end, middle = Signal(), Signal()
        reversing, blocked, backward = Signal(), Signal(), Signal()
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
        next_antiphase, antiphase = Signal(), Signal()
        magnitude = Mux(self.duty < 0, Mux(self.duty == -32768, 32767, -self.duty), self.duty)
        raised = Cat(self.duty[:15], ~self.duty[15])  # duty + 2**15
        m.d.comb += partial.eq(product + Mux(factor[0], next_length, 0))
        with m.If(end):
            m.d.sync += [
                next_length.eq(Mux(self.period[4:].any(), self.period, SHORTEST_PERIOD)),
                next_backward.eq(self.duty < 0),
                next_antiphase.eq(self.antiphase),
                factor.eq(Mux(self.antiphase, raised[1:], magnitude)),
                moving.eq(self.duty != 0),
                product.eq(0),
                steps.eq(15),
            ]
        with m.Elif(steps != 0):
            m.d.sync += [product.eq(partial >> 1), factor.eq(Cat(factor[1:], 0)), steps.eq(steps - 1)]

        with m.If(end):
            turn = moving & (next_backward != backward) & ~next_antiphase
            m.d.sync += [
                last.eq(next_length - 1),
                high.eq(Mux(turn, 0, product)),
                reversing.eq(turn),
                antiphase.eq(next_antiphase),
            ]
        with m.Elif(reversing & middle):
            m.d.sync += backward.eq(~backward)

        stop = self.brake | ~self.enable
        with m.If(stop):
            m.d.sync += blocked.eq(1)
        with m.Elif(end):
            m.d.sync += blocked.eq(0)
        m.d.sync += [
            self.pwm.eq(((position < high) | antiphase) & ~blocked & ~stop),
            self.direction.eq(Mux(antiphase, (position >= high) & ~blocked & ~stop, backward)),
            self.braking.eq(self.brake),
        ]
        return m
