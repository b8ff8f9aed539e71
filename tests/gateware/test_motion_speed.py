"""Speed from edges: by hand, at all rates, through reversals and standstill, bit for bit."""

import random

import pytest

from gateware.motion.speed import FRACTION_BITS, GREATEST, Measured, SpeedMeter
from tests.support.motor_program import Stepped

UNKNOWN = (1 << 32) - 1
TICK = 100


def run(edges, clocks, clock_hz):
    """Speeds after each tick, ours and the definition's; ``edges`` maps clocks to +1 or -1."""
    count, backward, age, got, want, now = 0, 0, UNKNOWN, [], [], Measured()
    meter, begin = Stepped(SpeedMeter.program), (1 << 32) - clocks // 2  # the clock of 32 bits wraps half-way
    for clock in range(clocks):
        if age != UNKNOWN:
            age += 1
        if clock in edges:
            count, backward, age = count + edges[clock], int(edges[clock] < 0), 0
        if clock % TICK == TICK - 1:
            now = SpeedMeter.reference(
                now, time=clock, count=count, backward=bool(backward), age=age, clock_hz=clock_hz
            )
            want.append(now.speed)
            time = (begin + clock) % (1 << 32)
            meter.step(time=time, count=count, backward=backward, age=age, clock_hz=clock_hz)
            got.append(meter.state["speed"])
    return got, want


def test_slow_and_steady_is_exact():
    """An edge in 670 clocks of 100 kHz, 149.25 counts a second: right from the second edge on."""
    got, want = run({50 + 670 * k: 1 for k in range(8)}, 5000, 100_000)
    assert got == want
    assert set(got[8:]) == {(100_000 << FRACTION_BITS) // 670}


def test_an_edge_passed_twice_lies_in_one_place():
    got, want = run({50: 1, 250: 1, 450: 1, 650: -1, 850: -1, 1050: -1}, 1300, 100_000)
    assert got == want
    assert got[6] == 0 and got[8] == -got[2] < 0


def test_standstill_tends_to_zero():
    got, want = run({20: 1, 40: 1, 120: 1, 140: 1}, 5000, 100_000)
    assert got == want
    # At 140 the last edge came; at tick 4799 the speed is at most a count in 4659 clocks.
    assert got[47] == (100_000 << FRACTION_BITS) // (4799 - 140)


def test_no_edge_is_no_speed():
    got, want = run({}, 400, 100_000)
    assert got == want == [0] * len(got)


@pytest.mark.parametrize(("clock_hz", "gap"), [(1 << 31, 1), (400_000_000, 4), ((1 << 32) - 1, 1)])
def test_saturates(clock_hz, gap):
    for way in (1, -1):
        got, want = run({10 + gap * k: way for k in range(900 // gap)}, 900, clock_hz)
        assert got == want
        assert got[4] == way * GREATEST


@pytest.mark.parametrize("seed", range(4))
def test_random_motion(seed):
    rng = random.Random(seed)
    print(f"seed {seed}")
    edges, clock, way = {}, 30, 1
    while clock < 20_000:
        if rng.random() < 0.1:
            way = -way
        edges[clock] = way
        clock += rng.choice([1, 4, 30, 120, 500, 3000]) + rng.randrange(4)
    got, want = run(edges, 20_000, rng.choice([1_000_000, 48_000_000, 148_500_000]))
    assert got == want
    assert min(got) < 0 < max(got)
