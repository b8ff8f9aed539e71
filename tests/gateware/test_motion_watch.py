"""Each fault of the motor alone, just not reached and just reached; the first one stays."""

import pytest

from gateware.motion.watch import CHATTER, MotorWatch
from magtrak.protocol import MotorCause
from tests.support.trace import trace

BASE = {
    **{"driven": 1, "moving": 1, "backward_wanted": 0, "loop": 1, "enable": 31, "tick": 0, "count": 0, "edge": 0},
    **{"backward": 0, "illegal": 0, "passed": 0, "pass_count": 0, "wrong": 0, "difference": 0, "speed": 0},
    **{"search_failed": 0, "alive": 1, "stall_ms": 20, "runaway": 5, "speed_max": 1000, "encoder_tolerance": 3},
    **{"index_tolerance": 4, "counts_per_turn": 0},
}


def run(stimulus, **always):
    """``stopped`` and ``cause``; the motor is driven from the third clock on."""
    stimulus = [BASE | {"driven": 0, "moving": 0}] * 2 + [BASE | values | always for values in [*stimulus, *[{}] * 4]]
    return trace(MotorWatch(), stimulus, ("stopped", "cause"))


def moves(*ways, gap=2, start=0):
    """Edges forward (1) and backward (-1)."""
    count, out = start, []
    for way in ways:
        count += way
        here = {"count": count, "backward": int(way < 0)}
        out += [here | {"edge": 1}, *[here] * (gap - 1)]
    return out


CASES = [
    (MotorCause.STALL, [{"tick": 1}] * 20, [{"tick": 1}] * 21),
    (MotorCause.RUNAWAY, moves(*[-1] * 5), moves(*[-1] * 6)),
    (MotorCause.RUNAWAY, *[[*[{"speed": -speed}] * 2, *[{"speed": -speed, "tick": 1}] * 8] for speed in (1000, 1001)]),
    (MotorCause.RUNAWAY, *[[*[{"speed": 1001}] * 2, *[{"speed": 1001, "tick": 1}] * ticks] for ticks in (7, 8)]),
    (MotorCause.ENCODER, moves(*[1, -1] * 4), moves(*[1, -1] * 5)),
    (MotorCause.ENCODER, [{"illegal": 1}] * 3, [{"illegal": 1}] * 4),
    (MotorCause.TURN, [{"wrong": 1, "difference": 4}], [{"wrong": 1, "difference": -5}]),
    (
        MotorCause.INDEX_MISSING,
        [{"counts_per_turn": 40, "count": 50}] * 4,
        [{"counts_per_turn": 40, "count": -51}] * 5,
    ),
    (MotorCause.SEARCH, [], [{"search_failed": 1}]),
    (MotorCause.LEASE, [], [{"alive": 0}]),
]


@pytest.mark.parametrize(("cause", "just_not", "just"), CASES)
def test_each_fault(cause, just_not, just):
    assert not any(run(just_not)["stopped"])
    got = run([{}, *just])
    assert got["stopped"][-1] and got["cause"][-1] == cause
    # Not watched, or not driven: nothing.
    assert not any(run(just, enable=0)["stopped"])
    assert not any(run(just, driven=0, moving=0)["stopped"])


def test_stall_starts_anew_with_every_two_counts():
    """A slow motor is none that stalls; one count to and fro is no way."""
    slow = []
    for count in range(10):
        slow += [{"count": count, "tick": 1}] * 9
    assert not any(run(slow)["stopped"])
    shaking = [{"count": tick % 2, "tick": 1} for tick in range(40)]
    assert run(shaking)["cause"][-1] == MotorCause.STALL


def test_an_edge_the_right_way_ends_a_run_away():
    assert not any(run(moves(*[-1, -1, -1, -1, 1] * 3))["stopped"])


def test_a_reversal_is_no_chatter():
    ways = [1] * 6 + [-1, 1, -1] + [-1] * 3
    assert not any(run(moves(*ways))["stopped"]) and CHATTER > 3


def test_illegal_transitions_are_forgotten():
    calm = [{"tick": 1, "count": 3 * k} for k in range(140)]
    assert not any(run([{"illegal": 1}] * 3 + calm + [{"illegal": 1, "count": 420}])["stopped"])


def test_missing_index_counts_from_the_last_pass():
    turn = {"counts_per_turn": 40}
    passes = [turn | {"passed": 1, "count": 30, "pass_count": 30}, turn | {"count": 30, "pass_count": 30}]
    after = [turn | {"count": 80, "pass_count": 30}] * 4
    assert not any(run(passes + after)["stopped"])
    assert run(passes + after + [turn | {"count": 81, "pass_count": 30}] * 4)["cause"][-1] == MotorCause.INDEX_MISSING


def test_the_first_cause_stays_until_the_next_start():
    stimulus = [{}, {"search_failed": 1}, {}, {"alive": 0}, {}, {"driven": 0}, {"driven": 0}, {}, {}, {}]
    got = run(stimulus)
    stopped = got["stopped"][2:]
    assert stopped[:10] == [0, 0, 1, 1, 1, 1, 0, 0, 0, 0]
    assert got["cause"][2:11] == [0, 0, *[MotorCause.SEARCH] * 6, 0]
