"""The speed loop and its limits, bit for bit."""

import random

import pytest

from gateware.motion.loop import FULL, Loop, SpeedLoop
from tests.support.trace import trace

GAP = SpeedLoop.latency + 3


def run(steps):
    """Duties after each step, ours and the definition's."""
    stimulus, want, now = [], [], Loop()
    for step in steps:
        stimulus += [{**step, "start": 1, "active": 1}, *[{"start": 0}] * (GAP - 1)]
        now = SpeedLoop.reference(now, **step)
        want.append(now.duty)
    got = trace(SpeedLoop(), stimulus, ("duty", "done"))
    assert [clock for clock, done in enumerate(got["done"]) if done] == [
        number * GAP + SpeedLoop.latency for number in range(len(steps))
    ], "the latency is constant"
    return got["duty"][GAP - 1 :: GAP], want


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
    step = BASE | {"target": 100 << 8, "ki": 1 << 16}
    stimulus = [step | {"start": 1, "active": 1}, *[{"start": 0}] * GAP]
    stimulus += [{"active": 0}, {"active": 1}, {"start": 1}, *[{"start": 0}] * GAP]
    # Opened in the middle of a step: that one is void.
    stimulus += [{"start": 1}, *[{"start": 0}] * 20, {"active": 0}, *[{"active": 1}] * GAP]
    got = trace(SpeedLoop(), stimulus, ("duty",))["duty"]
    assert (got[GAP], got[GAP + 2], got[2 * GAP + 3], got[-1]) == (100, 0, 100, 0)


@pytest.mark.parametrize("seed", range(3))
def test_random_steps(seed):
    rng = random.Random(seed)
    print(f"seed {seed}")
    steps = []
    for _ in range(120):
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
