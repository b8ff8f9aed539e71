"""Each fault of the motor alone, just not reached and just reached; and all of them at random, bit for bit."""

import random

import pytest

from gateware.motion.watch import FAULTS, FORGET_MS, OVERSPEED_MS, SLOWEST, MotorWatch, Watched
from magtrak.protocol import MotorCause
from tests.support.motor_program import Stepped

BASE = {
    **{"rested": 0, "driven": 1, "closed": 1, "target": 100 << 8, "motor_duty": 0, "speed": 0, "count": 0},
    **{"right": 0, "chattered": 0, "illegals": 0, "passed": 0, "pass_count": 0, "wrong": 0, "difference": 0},
    **{"failed": 0, "alive": 1, "watch": 31, "motor_stall_ms": 20, "motor_runaway": 5, "motor_speed_max": 1000},
    **{"encoder_tolerance": 3, "index_tolerance": 4, "counts_per_turn": 0},
}
START = {"rested": 1, "driven": 0}


def run(steps, **always):
    """The cause of each step."""
    watch, causes, now = Stepped(MotorWatch.program, "target", "speed", "failed", "scratch"), [], Watched()
    for step in [START, *steps]:
        values = BASE | step | always
        now, cause = MotorWatch.reference(now, **values)
        inner = {name: value for name, value in values.items() if name not in ("failed", "difference", "watch")}
        enable = {f"watch_{name}": values["watch"] >> bit & 1 for bit, name in enumerate(FAULTS)}
        outputs = watch.step(**inner, **enable, failed=-values["failed"], difference=values["difference"])
        assert outputs.get("cause", 0) == cause
        causes.append(MotorCause(cause))
    return causes[1:]


def moves(step, times, **more):
    return [{"count": step * (number + 1), **more} for number in range(times)]


CASES = [
    (MotorCause.STALL, [{}] * 20, [{}] * 21),
    (MotorCause.RUNAWAY, moves(-5, 1), moves(-6, 1)),
    (MotorCause.RUNAWAY, moves(-1, 5), moves(-1, 6)),
    (MotorCause.RUNAWAY, *[moves(2, 12, speed=-speed, right=1) for speed in (1000, 1001)]),
    (MotorCause.RUNAWAY, *[moves(2, times, speed=1001, right=1) for times in (OVERSPEED_MS - 1, OVERSPEED_MS)]),
    (MotorCause.ENCODER, [{"chattered": 1, "target": SLOWEST - 1}], [{"chattered": 1, "target": -SLOWEST}]),
    (MotorCause.ENCODER, [{"illegals": 2}, {"illegals": 1}], [{"illegals": 2}, {"illegals": 2}]),
    (MotorCause.TURN, [{"wrong": 1, "difference": 4}], [{"wrong": 1, "difference": -5}]),
    (
        MotorCause.INDEX_MISSING,
        [{"counts_per_turn": 40, "count": 50, "right": 1}],
        [{"counts_per_turn": 40, "count": -51, "right": 1}],
    ),
    (MotorCause.SEARCH, [{}], [{"failed": 1}]),
    (MotorCause.LEASE, [{}], [{"alive": 0}]),
]


@pytest.mark.parametrize(("cause", "just_not", "just"), CASES)
def test_each_fault(cause, just_not, just):
    assert set(run(just_not)) == {MotorCause.NONE}
    assert run(just)[-1] == cause
    # Not watched, or not driven: nothing.
    assert not any(run(just, watch=0))
    assert not any(run(just, driven=0, rested=1))


def test_stall_starts_anew_with_every_two_counts():
    """A slow motor is none that stalls; one count to and fro is no way."""
    assert not any(run([{"count": count, "right": 1} for count in range(10) for _ in range(9)]))
    assert run([{"count": tick % 2, "right": 1} for tick in range(40)])[-1] == MotorCause.STALL


def test_an_edge_the_right_way_ends_a_run_away():
    assert not any(run([{"count": -4}, {"count": -7, "right": 1}, {"count": -11}]))


def test_no_direction_is_wrong_without_a_loop():
    assert not any(run(moves(-9, 9), closed=0, motor_duty=1))


def test_illegal_transitions_are_forgotten():
    calm = moves(3, 2 * FORGET_MS, right=1)
    assert not any(run([{"illegals": 3}, *calm, {"illegals": 2, "count": 6 * FORGET_MS, "right": 1}]))
    assert any(run([{"illegals": 3}, *calm, {"illegals": 3, "count": 6 * FORGET_MS, "right": 1}]))


def test_missing_index_counts_from_the_last_pass():
    turn = {"counts_per_turn": 40, "pass_count": 30, "right": 1}
    passed = [turn | {"passed": 1, "count": 30}, turn | {"count": 80}]
    assert not any(run(passed))
    assert run([*passed, turn | {"count": 81}])[-1] == MotorCause.INDEX_MISSING


def test_counts_that_wrap_are_no_way():
    turn = {"counts_per_turn": 40, "pass_count": (1 << 31) - 3, "right": 1}
    assert not any(run([turn | {"passed": 1, "count": (1 << 31) - 2}, turn | {"count": -(1 << 31) + 1}]))


def test_a_new_start_forgets():
    assert not any(run([*[{}] * 15, {"rested": 1}, *[{}] * 19]))
    assert not any(run([{"illegals": 3}, {"rested": 1, "illegals": 3}, {"illegals": 3}]))
    assert not any(run([{"rested": 1, "wrong": 1, "difference": 100}]))


@pytest.mark.parametrize("seed", range(4))
def test_random_steps(seed):
    rng = random.Random(seed)
    print(f"seed {seed}")
    steps, count, passed_at, settings = [], rng.choice([0, (1 << 31) - 200, -(1 << 31) + 200]), 0, {}
    for number in range(4000):
        if number % 50 == 0:
            settings = {
                "closed": rng.getrandbits(1),
                "target": rng.choice([0, SLOWEST, -SLOWEST, rng.randrange(-(1 << 31) + 1, 1 << 31)]),
                "motor_duty": rng.choice([0, 100, -32767]),
                "watch": rng.getrandbits(5),
                "motor_stall_ms": rng.choice([0, 3, 20, 65535]),
                "motor_runaway": rng.choice([0, 10, 65535]),
                "motor_speed_max": rng.choice([0, 1000, (1 << 31) - 1]),
                "encoder_tolerance": rng.choice([0, 3, 255]),
                "index_tolerance": rng.choice([0, 255]),
                "counts_per_turn": rng.choice([0, 41, 100, (1 << 24) - 1]),
            }
        step = rng.choice([0, 1, 5, 2000])
        count = (count + rng.randrange(-step, step + 1) + (1 << 31)) % (1 << 32) - (1 << 31)
        passed = rng.random() < 0.1
        passed_at = count if passed else passed_at
        steps.append(
            settings
            | {"count": count, "passed": int(passed), "pass_count": passed_at}
            | {name: int(rng.random() < part) for name, part in (("rested", 0.03), ("right", 0.3), ("wrong", 0.05))}
            | {
                name: int(rng.random() < part)
                for name, part in (("chattered", 0.03), ("failed", 0.03), ("alive", 0.97))
            }
            | {"driven": int(rng.random() < 0.98), "illegals": rng.choice([0, 0, 0, 1, 255])}
            | {"speed": rng.choice([0, 999, -1001, (1 << 31) - 1, -(1 << 31) + 1])}
            | {"difference": rng.choice([0, 3, -256, (1 << 31) - 1, -(1 << 31)])}
        )
    assert len(set(run(steps))) == len(MotorCause)
