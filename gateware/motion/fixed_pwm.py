"""Pulse-width modulation with a period of 1024 clocks, for cards of few cells."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .pwm import Pwm

PERIOD = 1024
"""Clocks: the initial value of ``motor_period``."""

_BITS = PERIOD.bit_length() - 1


class FixedPwm(wiring.Component):
    """What :class:`~gateware.motion.pwm.Pwm` does with a period of :data:`PERIOD`, which needs no multiplication.

    After reset the first 32 clocks are without pulse.

    Members
    -------
    duty : signed Q0.15, -32767 at least
    brake, enable, antiphase, pwm, direction, braking : as there
    """

    duty: In(signed(16))
    brake: In(1)
    enable: In(1, init=1)
    antiphase: In(1)
    pwm: Out(1)
    direction: Out(1)
    braking: Out(1)

    @staticmethod
    def reference(duty: int, antiphase: bool = False) -> int:
        """As :meth:`gateware.motion.pwm.Pwm.reference`."""
        return Pwm.reference(PERIOD, duty, antiphase)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        position = Signal(_BITS, init=PERIOD - 32)
        high = Signal(_BITS)
        following = Signal(_BITS)
        end = Signal()
        middle = Signal()
        m.d.comb += [end.eq(position.all()), middle.eq(position == PERIOD // 2 - 1)]
        m.d.sync += position.eq(position + 1)

        # Taken at the start of a period, for the next one.
        moving = Signal()
        next_backward = Signal()
        next_antiphase = Signal()
        reversing = Signal()
        blocked = Signal()
        backward = Signal()
        antiphase = Signal()
        magnitude = Signal(15)
        raised = Cat(self.duty[:15], ~self.duty[15])  # duty + 2**15
        m.d.comb += magnitude.eq(Mux(self.duty < 0, -self.duty, self.duty))
        with m.If(end):
            turn = moving & (next_backward != backward) & ~next_antiphase
            m.d.sync += [
                next_backward.eq(self.duty < 0),
                next_antiphase.eq(self.antiphase),
                following.eq(Mux(self.antiphase, raised[16 - _BITS :], magnitude[15 - _BITS :])),
                moving.eq(self.duty != 0),
                high.eq(Mux(turn, 0, following)),
                reversing.eq(turn),
                antiphase.eq(next_antiphase),
            ]
        with m.Elif(reversing & middle):
            m.d.sync += backward.eq(~backward)

        stop = self.brake | ~self.enable
        within = Signal()
        m.d.comb += within.eq(position < high)
        with m.If(stop):
            m.d.sync += blocked.eq(1)
        with m.Elif(end):
            m.d.sync += blocked.eq(0)
        m.d.sync += [
            self.pwm.eq((within | antiphase) & ~blocked & ~stop),
            self.direction.eq(Mux(antiphase, ~within & ~blocked & ~stop, backward)),
            self.braking.eq(self.brake),
        ]
        return m
