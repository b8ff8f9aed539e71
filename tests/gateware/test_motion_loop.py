"""The speed loop and its limits, bit for bit."""

import random

import pytest

from gateware.motion.loop import FULL, Loop, SpeedLoop
from tests.support.motor_program import Stepped


def run(steps):
    """Duties after each step, ours and the definition's."""
    loop, got, want, now = Stepped(SpeedLoop.program, "target", "speed", "scratch"), [], [], Loop()
    for step in steps:
        outputs = loop.step(**{NAMES.get(name, name): value for name, value in step.items()})
        now = SpeedLoop.reference(now, **step)
        assert outputs == {"duty": now.duty} and loop.state["integral"] == now.integral
        got.append(outputs["duty"])
        want.append(now.duty)
    return got, want


NAMES = {
    "kp": "motor_kp",
    "ki": "motor_ki",
    "kff": "motor_kff",
    "friction": "motor_friction",
    "limit": "motor_duty_max",
}
BASE = {"target": 0, "speed": 0, "kp": 0, "ki": 0, "kff": 0, "friction": 0, "limit": FULL}


def test_each_term_by_hand():
    got, want = run(
        [
            BASE | {"target": 100 << 8, "speed": 90 << 8, "kp": 3 << 16},
            BASE | {"target": -100 << 8, "speed": 90 << 8, "kff": 2 << 16},
            BASE | {"target": -1, "friction": 1234},
            BASE | {"target": 100 << 8, "ki": 1 << 15},
            BASE | {"target": 100 << 8, "ki": 1 << 15},
        ]
    )
    assert got == want == [30, -200, -1234, 50, 100]


def test_extremes_saturate():
    """The greatest values everywhere: the duty is at its limit, never on the other side."""
    full = {"kp": (1 << 24) - 1, "ki": (1 << 24) - 1, "kff": (1 << 24) - 1, "friction": FULL}
    up = BASE | full | {"target": (1 << 31) - 1, "speed": -(1 << 31)}
    down = BASE | full | {"target": -(1 << 31) + 1, "speed": (1 << 31) - 1}
    got, want = run([up] * 5 + [down] * 5 + [up])
    assert got == want == [FULL] * 5 + [-FULL] * 5 + [FULL]


def test_no_windup():
    """However long the motor cannot follow, the integral leaves its limit with the first step the other way."""
    far = BASE | {"target": 1000 << 8, "kp": 20 << 16, "ki": 1 << 16, "limit": 10_000}
    back = far | {"target": 0, "speed": 100 << 8}
    got, want = run([far] * 40 + [back])
    assert got == want
    assert got[-2:] == [10_000, -2100]


def test_opened_loop_forgets():
    loop = Stepped(SpeedLoop.program, "target", "speed", "scratch")
    step = {"target": 100 << 8, "motor_ki": 1 << 16, "motor_duty_max": FULL}
    assert [loop.step(**step, opened=opened)["duty"] for opened in (1, 0, 1, 0, 0)] == [100, 200, 100, 200, 300]


@pytest.mark.parametrize("seed", range(3))
def test_random_steps(seed):
    rng = random.Random(seed)
    print(f"seed {seed}")
    steps = []
    for _ in range(1000):
        wide = rng.choice([8, 16, 24, 31])
        gain = rng.choice([8, 16, 24])
        steps.append(
            {
                "target": rng.randrange(-(1 << wide) + 1, 1 << wide),
                "speed": rng.randrange(-(1 << wide), 1 << wide),
                **{name: rng.randrange(1 << gain) for name in ("kp", "ki", "kff")},
                "friction": rng.randrange(1 << 15),
                "limit": rng.choice([FULL, rng.randrange(1 << 15)]),
            }
        )
    got, want = run(steps)
    assert got == want
    assert all(abs(duty) <= step["limit"] for duty, step in zip(got, steps, strict=True))
