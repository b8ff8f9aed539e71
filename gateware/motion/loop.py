"""Speed loop: PI with feed-forward, in steps of a millisecond and one bit at a time."""

from dataclasses import dataclass

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

GAIN_BITS = 24
GAIN_FRACTION_BITS = 16
"""Gains are unsigned Q8.16, in duty (1/32768) per count a second."""

FULL = 32767
"""Greatest duty."""

_TERM = (1 << 17) - 1
"""Products saturate here, at four times the greatest duty, so that no sum of them can wrap."""

_INTEGRAL_FRACTION_BITS = 16


@dataclass(frozen=True)
class Loop:
    """What :meth:`SpeedLoop.reference` remembers from step to step; ``integral`` is Q15.16, in duty."""

    integral: int = 0
    duty: int = 0


def _product(value: int, gain: int, shift: int, limit: int) -> int:
    magnitude = min(abs(value) * gain >> shift, limit)
    return -magnitude if value < 0 else magnitude


class SpeedLoop(wiring.Component):
    """From the speed wanted and the speed measured to a duty.

    ``duty = kp * error + integral + kff * target + friction * sign(target)``, where ``integral`` gathers
    ``ki * error`` every step; :meth:`reference` is exact. ``error`` saturates at 32 bits, every product and the
    integral at a bound beside its arithmetic, the duty at ``limit``: nothing wraps, whatever the settings.
    Anti-windup: while the duty is at its limit the integral takes only what leads away from it.

    Source: K. J. Astrom and R. M. Murray, *Feedback Systems*, sections 11.2 and 11.4 (conditional integration).

    Latency: :attr:`latency` clocks from ``start`` to ``done``; a ``start`` on the way is left out. No multiplier:
    three products with a gain, a bit of the gain a clock.

    Members
    -------
    start : strobe: a step
    active : 0 holds integral and duty at 0
    target, speed : signed Q23.8, counts a second
    kp, ki, kff : unsigned Q8.16, duty per count a second; ``ki`` is that of one step
    friction : duty that overcomes dry friction, in the direction of the target
    limit : greatest duty to either side
    duty : signed Q0.15
    done : strobe: ``duty`` is new
    """

    start: In(1)
    active: In(1)
    target: In(signed(32))
    speed: In(signed(32))
    kp: In(GAIN_BITS)
    ki: In(GAIN_BITS)
    kff: In(GAIN_BITS)
    friction: In(15)
    limit: In(15)
    duty: Out(signed(16))
    done: Out(1)

    def __init__(self) -> None:
        super().__init__()
        self._integral = Signal(signed(32))  # |32767 * 2**16| < 2**31
        self._increment = Signal(signed(32))
        self._candidate = Signal(signed(33))
        self._proportional, self._forward = Signal(signed(18)), Signal(signed(18))
        self._wanted = Signal(signed(21))  # 2 * (2**17 - 1) + 2 * 32767 < 2**19

    latency = 3 * (GAIN_BITS + 3) + 6

    @staticmethod
    def reference(now: Loop, *, target: int, speed: int, kp: int, ki: int, kff: int, friction: int, limit: int) -> Loop:
        """The definition: what a step makes of ``now``."""
        error = min(max(target - speed, -(1 << 31) + 1), (1 << 31) - 1)
        shift = 8 + GAIN_FRACTION_BITS  # Q23.8 times Q8.16
        proportional = _product(error, kp, shift, _TERM)
        forward = _product(target, kff, shift, _TERM) + friction * ((target > 0) - (target < 0))
        increment = _product(error, ki, shift - _INTEGRAL_FRACTION_BITS, (1 << 31) - 1)
        bound = FULL << _INTEGRAL_FRACTION_BITS
        integral = min(max(now.integral + increment, -bound), bound)
        wanted = proportional + forward + (integral >> _INTEGRAL_FRACTION_BITS)
        duty = min(max(wanted, -limit), limit)
        winding = (wanted > limit and increment > 0) or (wanted < -limit and increment < 0)
        return Loop(now.integral if winding else integral, duty)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        integral, increment, candidate = self._integral, self._increment, self._candidate
        proportional, forward, wanted = self._proportional, self._forward, self._wanted
        error, friction = Signal(signed(33)), Signal(signed(16))

        # A magnitude below 2**32 times a gain below 2**24, lowest bit of the gain first: 33 bits are added, and a bit
        # of the product leaves to the right each step.
        negative = Signal()
        magnitude, gain = Signal(32), Signal(GAIN_BITS)
        high, low = Signal(32), Signal(GAIN_BITS)
        total = Signal(33)
        steps = Signal(range(GAIN_BITS + 1))
        product = Signal(32 + GAIN_BITS)
        m.d.comb += [total.eq(high + Mux(gain[0], magnitude, 0)), product.eq(Cat(low, high))]
        duty_product, integral_product = Signal(17), Signal(31)  # saturated, in a clock of their own
        shift = 8 + GAIN_FRACTION_BITS
        fine = shift - _INTEGRAL_FRACTION_BITS
        m.d.sync += [
            duty_product.eq(Mux((product >> (shift + 17)).any(), _TERM, product >> shift)),
            integral_product.eq(Mux((product >> (fine + 31)).any(), (1 << 31) - 1, product >> fine)),
        ]

        def multiply(name: str, value: Signal, by: Signal, then: str) -> None:
            """States that leave ``abs(value) * by`` in ``product`` and the sign in ``negative``."""
            with m.State(name):
                m.d.sync += [
                    negative.eq(value < 0),
                    magnitude.eq(Mux(value < 0, -value, value)),
                    gain.eq(by),
                    high.eq(0),
                    steps.eq(GAIN_BITS),
                ]
                m.next = f"{name} steps"
            with m.State(f"{name} steps"):
                m.d.sync += [Cat(low, high).eq(Cat(low[1:], total)), gain.eq(gain >> 1), steps.eq(steps - 1)]
                with m.If(steps == 1):
                    m.next = f"{name} saturated"
            with m.State(f"{name} saturated"):
                m.next = then

        bound = FULL << _INTEGRAL_FRACTION_BITS
        m.d.sync += self.done.eq(0)
        stale = Signal()  # the loop was opened during the step
        with m.FSM():
            with m.State("Wait"):
                m.d.sync += [error.eq(self.target - self.speed), stale.eq(0)]
                with m.If(self.start):
                    m.next = "Error"
            with m.State("Error"):
                # -2**31 itself would have no magnitude of 31 bits.
                with m.If(error > (1 << 31) - 1):
                    m.d.sync += error.eq((1 << 31) - 1)
                with m.Elif(error < -(1 << 31) + 1):
                    m.d.sync += error.eq(-(1 << 31) + 1)
                m.next = "Proportional"
            multiply("Proportional", error, self.kp, "Take proportional")
            with m.State("Take proportional"):
                m.d.sync += proportional.eq(Mux(negative, -duty_product, duty_product))
                m.next = "Forward"
            multiply("Forward", self.target, self.kff, "Take forward")
            with m.State("Take forward"):
                m.d.sync += forward.eq(Mux(negative, -duty_product, duty_product))
                m.next = "Integral"
            multiply("Integral", error, self.ki, "Take integral")
            with m.State("Take integral"):
                m.d.sync += increment.eq(Mux(negative, -integral_product, integral_product))
                m.next = "Add"
            with m.State("Add"):
                m.d.sync += [
                    candidate.eq(integral + increment),
                    wanted.eq(proportional + forward),
                    friction.eq(Mux(self.target < 0, -self.friction, Mux(self.target == 0, 0, self.friction))),
                ]
                m.next = "Clamp"
            with m.State("Clamp"):
                m.d.sync += wanted.eq(wanted + friction)
                with m.If(candidate > bound):
                    m.d.sync += candidate.eq(bound)
                with m.Elif(candidate < -bound):
                    m.d.sync += candidate.eq(-bound)
                m.next = "Sum"
            with m.State("Sum"):
                m.d.sync += wanted.eq(wanted + (candidate >> _INTEGRAL_FRACTION_BITS))
                m.next = "Limit"
            with m.State("Limit"):
                limit = self.limit
                over, under = Signal(), Signal()
                m.d.comb += [over.eq(wanted > limit), under.eq(wanted < -limit)]
                with m.If(~stale):
                    m.d.sync += [self.duty.eq(Mux(over, limit, Mux(under, -limit, wanted))), self.done.eq(1)]
                    with m.If(~(over & (increment > 0)) & ~(under & (increment < 0))):
                        m.d.sync += integral.eq(candidate)
                m.next = "Wait"
        with m.If(~self.active):
            m.d.sync += [integral.eq(0), self.duty.eq(0), self.done.eq(0), stale.eq(1)]
        return m
