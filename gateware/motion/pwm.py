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

        # The period that runs, and which of its clocks it is, from 1 on. Times are met, not compared: equality is less.
        position = Signal(16, init=1)
        length = Signal(16, init=SHORTEST_PERIOD)
        high = Signal(16)
        end = Signal()
        halfway = Signal()
        after_half = Signal()
        middle = Signal()
        pulse = Signal()
        reversing = Signal()
        blocked = Signal()
        backward = Signal()
        m.d.comb += [
            end.eq(position == length),
            halfway.eq(position == length >> 1),
            middle.eq(Mux(length[0], after_half, halfway)),
        ]
        m.d.sync += [position.eq(position + 1), after_half.eq(halfway)]
        with m.If(end):
            m.d.sync += position.eq(1)

        # The next one. Multiply |duty| by the period, lowest bit first: each step drops a bit of the product that
        # later ones cannot change, so 15 steps leave floor(|duty| * period / 2**15), with one 17-bit addition each.
        # Negation is bit by bit as well: all bits beyond the lowest one that is set turn round.
        next_length = Signal(16, init=SHORTEST_PERIOD)
        next_backward = Signal()
        factor = Signal(16)
        bit = Signal()
        product = Signal(16)  # |duty| < 2**15, so what is left is less than the period
        partial = Signal(17)
        steps = Signal(range(16))
        moving = Signal()  # a duty that is not 0
        most = Signal()  # -32768
        some = Signal()  # a bit was set
        next_antiphase = Signal()
        antiphase = Signal()
        any_of_it = Signal()
        long = Signal()
        m.d.comb += [
            any_of_it.eq(self.duty[:15].any()),
            long.eq(self.period[4:].any()),
            bit.eq(Mux(next_antiphase, factor[1], most | (factor[0] ^ (next_backward & some)))),
            partial.eq(product + (next_length & bit.replicate(16))),
        ]
        with m.If(end):
            m.d.sync += [
                next_length.eq(Cat(self.period[:4] & long.replicate(4), self.period[4] | ~long, self.period[5:])),
                next_backward.eq(self.duty[15]),
                next_antiphase.eq(self.antiphase),
                factor.eq(Cat(self.duty[:15], self.duty[15] ^ self.antiphase)),  # duty + 2**15
                moving.eq(any_of_it | self.duty[15]),
                most.eq(self.duty[15] & ~any_of_it),
                some.eq(0),
                steps.eq(15),
            ]
        with m.Elif(steps != 0):
            m.d.sync += [
                product.eq(partial >> 1),
                factor.eq(factor >> 1),
                some.eq(some | factor[0]),
                steps.eq(steps - 1),
            ]
        with m.If(end):
            m.d.sync += product.eq(0)

        turn = Signal()
        m.d.comb += turn.eq(moving & (next_backward != backward) & ~next_antiphase)
        with m.If(position == high):
            m.d.sync += pulse.eq(0)
        with m.If(end):
            m.d.sync += [
                length.eq(next_length),
                high.eq(product),
                pulse.eq(product.any() & ~turn),
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
            self.pwm.eq((pulse | antiphase) & ~blocked & ~stop),
            self.direction.eq(Mux(antiphase, ~pulse & ~blocked & ~stop, backward)),
            self.braking.eq(self.brake),
        ]
        return m
