"""The speed loop on a motor with friction, ripple and a load that comes on; ``docs/motion.md`` states the figures."""

import pytest

from tests.support.step_response import LOAD_AT_S, SPEED_DEG_S, respond

SETTLED_S = 0.3
RECOVERED_S = 0.1
OVERSHOOT = 0.08


@pytest.mark.parametrize("bridge", ["sign-magnitude", "locked-antiphase"])
def test_step_and_load(bridge: str) -> None:
    response = respond(bridge)
    before = response.time_s < LOAD_AT_S
    first = response.time_s[before][-1]
    settled = [
        float(t)
        for t in (
            type(response)(response.time_s[before], response.speed_deg_s[before], response.duty[before]).settled_s(0.0),
            response.settled_s(LOAD_AT_S),
        )
    ]
    print(f"{bridge}: settled in {settled[0]:.3f} s of {first:.2f} s, recovered in {settled[1]:.3f} s")
    assert settled[0] <= SETTLED_S
    assert settled[1] <= RECOVERED_S
    assert response.speed_deg_s[before].max() <= (1 + OVERSHOOT) * SPEED_DEG_S
    assert abs(response.duty).max() < 1
