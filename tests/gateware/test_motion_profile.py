"""Courses: ramps, sweeps and the search for the index, bit for bit with the definition."""

import random

import pytest

from gateware.motion.profile import Course, Profile
from gateware.motion.sector import Sector
from magtrak.protocol import MotorMode
from tests.support.motor_program import Stepped

MODES = (MotorMode.SPEED, MotorMode.SWEEP, MotorMode.SEARCH)
BASE = {"mode": MotorMode.SPEED, "speed": 1000, "measured": 0, "acceleration": 100, "count": 0, "passed": 0, "seen": 1}
BASE |= {"position": 0, "low": -50, "high": 50, "search": 0}


def run(steps):
    """Targets, found and failed after each step; ``passed``: since the step before."""
    profile, rows, now = Stepped(Profile.program, "speed", "position", "moved", "scratch"), [], Course()
    for step in steps:
        values = BASE | step
        mode = MotorMode(values["mode"])
        now = Profile.reference(now, **(values | {"mode": mode}))
        outputs = profile.step(
            closed=mode in MODES,
            speed_mode=mode is MotorMode.SPEED,
            sweep_mode=mode is MotorMode.SWEEP,
            motor_speed=values["speed"],
            speed=values["measured"],
            motor_acceleration=values["acceleration"],
            sweep_low=values["low"],
            sweep_high=values["high"],
            motor_search=values["search"],
            **{name: values[name] for name in ("count", "passed", "seen", "position")},
        )
        assert outputs == {"found": -int(now.found)}
        rows.append((profile.state["target"], int(now.found), -profile.state["failed"]))
        assert rows[-1] == (now.target, int(now.found), int(now.failed))
    return rows


def test_ramp_to_the_speed_and_back():
    targets = [row[0] for row in run([{}] * 12 + [{"speed": -150}] * 14)]
    assert targets[:12] == [100 * k for k in range(1, 11)] + [1000, 1000]
    assert targets[-4:] == [-100, -150, -150, -150]


def test_closing_the_loop_makes_no_jump():
    rows = run([{"mode": MotorMode.OFF, "measured": 730}, {}, {}, {}, {}])
    assert [row[0] for row in rows] == [730, 830, 930, 1000, 1000]


def test_sweep_turns_at_both_ends():
    places = [-90, -60, 0, 49, 50, 51, 40, 0, -49, -50, -60, 0]
    rows = run([{"mode": MotorMode.SWEEP, "acceleration": 5000, "position": place} for place in places])
    assert [row[0] > 0 for row in rows] == [True] * 5 + [False] * 5 + [True] * 2


def test_search_ends_with_the_index():
    rows = run([{"mode": MotorMode.SEARCH, "count": k} for k in range(15)] + [{"mode": MotorMode.SEARCH, "passed": 1}])
    assert rows[-1][1:] == (1, 0) and rows[-2][0] == 1000
    rows = run(
        [
            {"mode": MotorMode.SEARCH, "acceleration": 5000},
            {"mode": MotorMode.SEARCH, "acceleration": 5000, "passed": 1},
        ]
    )
    assert rows == [(1000, 0, 0), (0, 1, 0)]


def test_search_turns_once_and_fails():
    places = [0, 10, 20, 21, 15, 0, -19, -20, -21, -22]
    search = {"mode": MotorMode.SWEEP, "seen": 0, "search": 20, "acceleration": 5000}
    rows = run([search | {"count": 300 + place} for place in places])
    assert [row[0] > 0 for row in rows] == [True] * 4 + [False] * 5 + [True]
    assert [row[2] for row in rows] == [0] * 8 + [1, 1]


@pytest.mark.parametrize("seed", range(3))
def test_random_steps(seed):
    rng = random.Random(seed)
    print(f"seed {seed}")
    steps, settings, count = [], {}, 0
    for number in range(600):
        if number % 40 == 0:
            settings = {
                "mode": rng.randrange(5),
                "speed": rng.choice([rng.randrange(-(1 << 31) + 1, 1 << 31), rng.randrange(-5000, 5000)]),
                "acceleration": rng.choice([rng.randrange(1 << 24), rng.randrange(500)]),
                "search": rng.choice([0, 10, 60]),
                "seen": rng.randrange(2),
            }
        count += rng.randrange(-12, 13)
        random_values = {"measured": rng.randrange(-(1 << 31), 1 << 31), "passed": int(rng.random() < 0.03)}
        steps.append(settings | random_values | {"count": count, "position": count + 7})
    rows = run(steps)
    assert {row[1:] for row in rows} >= {(0, 0), (1, 0)}


@pytest.mark.parametrize("counts_per_turn", [0, 1000])
def test_sector(counts_per_turn):
    """Inside at the limits, outside beyond; turns apart where the counts of a turn are known; never without index."""
    places = [-1001, -900, -800, -799, -1, 0, 99, 100, 150, 200, 201, 1099, 1100, 1200, 1201, 2150]
    for seen in (0, 1):
        sector = Stepped(Sector.program, "position")
        got = [
            -sector.step(position=place, seen=seen, counts_per_turn=counts_per_turn, sector_low=100, sector_high=200)[
                "inside"
            ]
            for place in places
        ]
        assert got == [int(Sector.reference(place, bool(seen), counts_per_turn, 100, 200)) for place in places]
        inside = [place for place, yes in zip(places, got, strict=True) if yes]
        assert inside == (
            [] if not seen else [-900, -800, 100, 150, 200, 1100, 1200] if counts_per_turn else [100, 150, 200]
        )
