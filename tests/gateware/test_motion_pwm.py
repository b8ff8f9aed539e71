"""The PWM: exact duty for all duties, whole pulses, dead time around reversals."""

import random

import pytest

from gateware.motion.pwm import SHORTEST_PERIOD, Pwm
from tests.support.trace import trace

OUTPUTS = ("pwm", "direction", "braking")
REGISTER = 1  # from the position in the period to the output


def waveform(settings, periods):
    """The definition in full: outputs for ``periods`` periods, with ``settings(start)`` giving period and duty then."""
    pwm, direction = [0] * REGISTER, [0] * REGISTER
    backward = 0
    after = (SHORTEST_PERIOD, 0)
    now = (SHORTEST_PERIOD, 0)
    for _ in range(periods):
        length = max(now[0], SHORTEST_PERIOD)
        high = Pwm.reference(*now)
        wanted = int(now[1] < 0) if now[1] else backward
        if wanted != backward:
            pwm += [0] * length
            half = (length - 1) // 2 + 1
            direction += [backward] * half + [wanted] * (length - half)
            backward = wanted
        else:
            pwm += [1] * high + [0] * (length - high)
            direction += [backward] * length
        now, after = after, settings(len(pwm) - REGISTER)
    return pwm, direction


def check(changes, clocks):
    """Run sign-magnitude with settings that change at given clocks."""
    values, stimulus, current = {}, [], (0, 0)
    for clock in range(clocks):
        current = changes.get(clock, current)
        values[clock] = current
        stimulus.append({"period": current[0], "duty": current[1], "enable": 1})
    got = trace(Pwm(), stimulus, OUTPUTS)
    pwm, direction = waveform(lambda start: values.get(start - 1, current), clocks // SHORTEST_PERIOD + 2)
    assert got["pwm"] == pwm[:clocks]
    assert got["direction"] == direction[:clocks]
    assert not any(got["braking"])
    return got


def test_by_hand():
    assert Pwm.reference(1000, 16384) == 500
    assert Pwm.reference(1000, -32767) == 999
    assert Pwm.reference(1000, 32) == 0
    assert Pwm.reference(1024, 33) == 1


def test_every_duty_of_a_short_period():
    """All high times of a period of 20 clocks, at the duties where they begin and end, both signs."""
    edges = sorted({d for k in range(21) for d in (-(-k * 32768 // 20) - 1, -(-k * 32768 // 20)) if 0 <= d <= 32767})
    duties = [sign * duty for sign in (1, -1) for duty in edges]
    check({5 + 20 * n: (20, duty) for n, duty in enumerate(duties)}, 20 * len(duties) + 100)


@pytest.mark.parametrize("period", [0, 15, 16, 17, 31])
def test_shortest_periods(period):
    check({0: (period, 32767), 200: (period, -9000), 400: (period, 1)}, 600)


def test_reversal_has_dead_time():
    got = check({0: (100, 32767), 500: (100, -32767), 900: (100, 0), 1200: (100, -1), 1300: (100, 20000)}, 1800)
    turns = [c for c in range(1, 1800) if got["direction"][c] != got["direction"][c - 1]]
    assert len(turns) == 2
    for turn in turns:
        assert not any(got["pwm"][turn - 49 : turn + 49])


@pytest.mark.parametrize("seed", range(3))
def test_random_settings(seed):
    """Settings that change at any clock: never a torn pulse."""
    rng = random.Random(seed)
    print(f"seed {seed}")
    changes = {
        rng.randrange(6000): (rng.randrange(16, 200), rng.choice([rng.randrange(-32768, 32768), 0, 32767, -32768]))
        for _ in range(80)
    }
    check(changes, 6000)


def test_longest_period():
    start = 2 * SHORTEST_PERIOD + REGISTER
    pwm = trace(Pwm(), [{"period": 65535, "duty": 32767, "enable": 1}] * (start + 65536), ("pwm",))["pwm"]
    high = Pwm.reference(65535, 32767)
    assert high == 65533
    assert pwm == [0] * start + [1] * high + [0, 0] + [1]


def test_brake_acts_at_once_and_ends_at_a_period():
    stimulus = [{"period": 100, "duty": 20000, "enable": 1, "brake": 300 <= clock < 340} for clock in range(700)]
    got = trace(Pwm(), stimulus, OUTPUTS)
    free = trace(Pwm(), [{**values, "brake": 0} for values in stimulus], OUTPUTS)
    assert got["braking"] == [int(300 <= clock - 1 < 340) for clock in range(700)]
    assert got["pwm"][:301] == free["pwm"][:301]
    start = next(clock for clock in range(340, 700) if not free["pwm"][clock - 1] and free["pwm"][clock])
    assert not any(got["pwm"][301:start])
    assert got["pwm"][start:] == free["pwm"][start:]


@pytest.mark.parametrize("seed", range(2))
def test_locked_antiphase_switches_the_direction(seed):
    """In every period of settings that stay, the direction is low for exactly as long as the definition says."""
    rng = random.Random(seed)
    print(f"seed {seed}")
    for _ in range(6):
        period, duty = rng.randrange(16, 300), rng.choice([rng.randrange(-32768, 32768), 0, 32767, -32768])
        start = 2 * SHORTEST_PERIOD + REGISTER + period
        stimulus = [{"period": period, "duty": duty, "enable": 1, "antiphase": 1}] * (start + 3 * period)
        got = trace(Pwm(), stimulus, OUTPUTS)
        low = Pwm.reference(period, duty, antiphase=True)
        assert got["direction"][-3 * period :] == ([0] * low + [1] * (period - low)) * 3 or low in (0, period)
        assert got["direction"][-period:].count(0) == low
        assert all(got["pwm"][start:])


def test_locked_antiphase_by_hand():
    assert Pwm.reference(1000, 0, antiphase=True) == 500
    assert Pwm.reference(1000, 32767, antiphase=True) == 999
    assert Pwm.reference(1000, -32767, antiphase=True) == 0


def test_bridge_is_off_without_enable():
    """At once, and back at the start of a period, in both kinds."""
    for antiphase in (0, 1):
        stimulus = [
            {"period": 64, "duty": 30000, "antiphase": antiphase, "enable": int(not 300 <= clock < 310)}
            for clock in range(500)
        ]
        got = trace(Pwm(), stimulus, OUTPUTS)
        assert got["pwm"][250:301].count(1) > 40
        back = got["pwm"].index(1, 301)
        assert not any(got["pwm"][301:back]) and not any(got["direction"][301:back])
        assert (back - REGISTER - 2 * SHORTEST_PERIOD) % 64 == 0
        assert not any(got["braking"])
