"""Speed loop: PI with feed-forward, in steps of a millisecond."""

from dataclasses import dataclass

from .assembly import Program

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


class SpeedLoop:
    """From the speed wanted and the speed measured to a duty.

    ``duty = kp * error + integral + kff * target + friction * sign(target)``, where ``integral`` gathers
    ``ki * error`` every step; :meth:`reference` is exact. ``error`` saturates at 32 bits, every product and the
    integral at a bound beside its arithmetic, the duty at ``limit``: nothing wraps, whatever the settings.
    Anti-windup: while the duty is at its limit the integral takes only what leads away from it.

    Source: K. J. Astrom and R. M. Murray, *Feedback Systems*, sections 11.2 and 11.4 (conditional integration).

    ``target`` and ``speed`` are signed Q23.8, counts a second; ``kp``, ``ki`` and ``kff`` unsigned Q8.16, duty per
    count a second, ``ki`` that of one step; ``friction`` is the duty that overcomes dry friction, in the direction of
    the target; ``limit`` the greatest duty to either side; the duty is signed Q0.15.
    """

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

    @staticmethod
    def program(p: Program) -> None:
        """``duty`` from ``target``, ``speed`` and the settings; flag ``opened``: it was opened."""
        p.variable("error", "integral", "increment", "candidate", "duty")
        with p.when("opened"):
            p.put(0, "integral")
        p.load("target")
        p.subtract("speed")
        p.at_most((1 << 31) - 1, "error")
        p.at_least(-(1 << 31) + 1, "error")
        p.store("error")

        _times(p, "error", "motor_kp")
        _signed(p, "error")
        p.store("duty")

        _times(p, "target", "motor_kff")
        p.add("motor_friction")
        _signed(p, "target")
        p.add("duty")
        p.store("duty")

        # The integral has 16 bits more of the product: they are at the top of L.
        _times(p, "error", "motor_ki", 1 << 15)
        p.store("scratch")
        p.subtract(1 << 15)
        with p.when("negative"):
            p.load("scratch")
            p.divide(0, _INTEGRAL_FRACTION_BITS)
        with p.otherwise():
            p.load((1 << 31) - 1)
        _signed(p, "error")
        p.store("increment")
        p.add("integral")
        p.at_most(FULL << _INTEGRAL_FRACTION_BITS, "candidate")
        p.at_least(-FULL << _INTEGRAL_FRACTION_BITS, "candidate")
        p.multiply(0, _INTEGRAL_FRACTION_BITS)
        p.add("duty")
        p.store("duty")

        # Beyond the limit the integral only moves back.
        p.subtract("motor_duty_max")
        p.subtract(1)
        with p.unless("negative"):
            p.put_copy("motor_duty_max", "duty")
            p.load("increment")
        with p.otherwise():
            p.load("duty")
            p.add("motor_duty_max")
            with p.when("negative"):
                p.load_negative("motor_duty_max")
                p.store("duty")
                p.load_negative("increment")
            with p.otherwise():
                p.load(0)
        p.subtract(1)
        with p.when("negative"):
            p.put_copy("candidate", "integral")
        p.load("duty")
        p.output("duty")


def _times(p: Program, value: str, gain: str, most: int = _TERM) -> None:
    """A = ``min(abs(value) * gain >> 24, most)``."""
    p.load_magnitude(value)
    p.store("scratch")
    p.load(gain)
    p.to_low()
    p.load(0)
    p.multiply("scratch", GAIN_BITS)
    p.at_most(most, "scratch")


def _signed(p: Program, like: str) -> None:
    """A has the sign of a variable; it is 0 where that is."""
    p.store("scratch")
    p.load(like)
    with p.when("negative"):
        p.load_negative("scratch")
    with p.otherwise():
        p.load_negative(like)
        with p.when("negative"):
            p.load("scratch")
