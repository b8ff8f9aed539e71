"""The PWM of a fixed period is the other one at that period, clock by clock."""

import random

import pytest

from gateware.motion.fixed_pwm import PERIOD, FixedPwm
from gateware.motion.pwm import SHORTEST_PERIOD, Pwm
from magtrak.protocol import register
from tests.support.trace import trace

OUTPUTS = ("pwm", "direction", "braking")
SEED = 5


def test_the_period_is_what_the_register_has_after_reset():
    assert register("motor_period").init == PERIOD


@pytest.mark.parametrize("antiphase", [0, 1])
def test_as_the_other_at_this_period(antiphase):
    """Duties at the ends, about zero and at random, changes of direction, brake and enable at any time. The first two
    periods of the other are the shortest.
    """
    print("seed", SEED)
    rng = random.Random(SEED)
    values = {"duty": 0, "brake": 0, "enable": 1, "antiphase": 0}
    stimulus = [dict(values)] * (2 * SHORTEST_PERIOD)
    values["antiphase"] = antiphase
    duties = [32767, -32767, 31, 32, -32, -31, 0, -33, *(rng.randint(-32767, 32767) for _ in range(10))]
    for duty in duties:
        values["duty"] = duty
        for _ in range(PERIOD * 3 // 2):
            if rng.random() < 1 / 700:
                values["brake"] ^= 1
            if rng.random() < 1 / 700:
                values["enable"] ^= 1
            stimulus.append(dict(values))
    got = trace(FixedPwm(), stimulus, OUTPUTS)
    expected = trace(Pwm(), [{**one, "period": PERIOD} for one in stimulus], OUTPUTS)
    for name in OUTPUTS:
        assert got[name] == expected[name], name
        assert len(set(got[name])) == 2


def test_by_hand():
    assert FixedPwm.reference(16384) == FixedPwm.reference(-16384) == 512
    assert FixedPwm.reference(32767) == 1023
    assert FixedPwm.reference(0, antiphase=True) == 512
