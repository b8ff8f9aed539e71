"""The index barrier: against its definition, and against a shaft whose true position is known."""

import math
import random
from itertools import pairwise

import pytest

from gateware.motion.index import Index
from gateware.motion.quadrature import Quadrature
from magtrak.protocol import IndexPolicy
from tests.support.motion import barrier, bounce, encoder, wander
from tests.support.trace import trace

OUTPUTS = ("passed", "pass_time", "pass_count", "pass_backward", "passes", "seen", "turns", "difference")


def run(levels, moves, debounce, invert=False, counts_per_turn=0, lost=()):
    """What the gateware makes of it, checked against the definition.

    ``lost`` gives, by time, counts that the encoder loses.
    """
    edges = {move.time: move for move in moves if not move.illegal}
    stimulus, count, offset = [], 0, 0
    shifted = []
    for time, level in enumerate(levels):
        move = edges.get(time)
        offset += dict(lost).get(time, 0)
        if move:
            count = move.count + offset
            shifted.append(type(move)(time, count, move.backward, False))
        stimulus.append({"level": level, "valid": 1, "time": time, "count": count, "edge": move is not None})
        if move:
            stimulus[-1]["backward"] = move.backward
    stimulus[0] |= {"debounce": debounce, "invert": invert, "counts_per_turn": counts_per_turn}
    stimulus += [{"edge": 0}] * 8
    got = trace(Index(), stimulus, OUTPUTS)
    want = list(Index.reference(levels, shifted, debounce, invert, counts_per_turn))
    at = [clock for clock, passed in enumerate(got["passed"]) if passed]
    assert [(got["pass_time"][c], got["pass_count"][c], bool(got["pass_backward"][c])) for c in at] == [
        (p.time, p.count, p.backward) for p in want
    ]
    assert got["passes"][-1] == len(want) and got["seen"][-1] == bool(want)
    assert got["turns"][-1] == sum(bool(p.difference) for p in want)
    if want:
        assert got["difference"][-1] == (want[-1].difference or 0)
        after = at[-1] + 3
        assert got["turns"][after] == got["turns"][-1], "the check takes longer than stated"
    return want


def shaft(positions, edge=10.5, width=20, turn=1000):
    """Level of the barrier and moves of the encoder."""
    a, b = zip(*map(encoder, positions), strict=True)
    start = math.floor(positions[0])
    moves = [type(m)(m.time, m.count + start, m.backward, m.illegal) for m in Quadrature.reference(a, b, 1)]
    return [barrier(position, edge, width, turn) for position in positions], moves


def ramp(*turning_points, clocks_per_count=8):
    """Positions in the middle of eighths of a count, from one turning point to the next."""
    out = []
    for begin, end in pairwise(turning_points):
        steps = round(abs(end - begin) * clocks_per_count)
        out += [begin + (end - begin) * (step + 0.5) / steps for step in range(steps)]
    return out


def test_same_edge_in_both_directions():
    levels, moves = shaft(ramp(0, 50, 0, 50))
    passes = run(levels, moves, 3, counts_per_turn=1000)
    assert [(p.count, p.backward, p.difference) for p in passes] == [
        (10, False, None),
        (10, True, 0),
        (10, False, 0),
    ]
    assert [p.time for p in passes] == [84, 400 + 400 - 84, 800 + 84]


def test_inverted_barrier():
    levels, moves = shaft(ramp(0, 50, 0))
    assert [p.count for p in run([1 - level for level in levels], moves, 3, invert=True)] == [10, 10]


@pytest.mark.parametrize("turning", [10.2, 10.7, 10.95])
@pytest.mark.parametrize("back", [10.1, 9.5])
def test_reversal_in_the_count_of_the_leading_edge(turning, back):
    """There and back, and again: every true crossing is a pass, whether or not the count changed between."""
    positions = ramp(0, turning, back, turning, back, 20, clocks_per_count=40)
    levels, moves = shaft(positions)
    passes = run(levels, moves, 2)
    crossings = 5 if turning > 10.5 else 1
    assert [(p.count, p.backward) for p in passes] == [(10, bool(k % 2)) for k in range(crossings)]


@pytest.mark.parametrize("turning", [(30.2, 30.7), (30.7, 30.2), (30.8, 29.5), (30.2, 31.5)])
def test_reversal_in_the_count_of_the_trailing_edge(turning):
    """However the trailing edge is crossed, it is no pass."""
    first, second = turning
    positions = ramp(15, first, second, first, second, 40, second, first, 15, clocks_per_count=40)
    levels, moves = shaft(positions)
    assert run(levels, moves, 2) == []


def test_spike_is_no_pass_and_bounce_does_not_delay():
    levels, moves = shaft(ramp(0, 50))
    levels[40:44] = [1, 0, 1, 1]  # long before the edge at 84, shorter than the debouncing
    levels[84:90] = [1, 0, 1, 0, 0, 1]
    passes = run(levels, moves, 5)
    assert [p.time for p in passes] == [84]


def test_level_at_reset_is_no_pass():
    levels, moves = shaft(ramp(15, 28, 15))
    assert run(levels, moves, 3) == []


def test_no_pass_before_the_first_edge_of_the_encoder():
    levels, moves = shaft(ramp(10.3, 10.9, 10.1, clocks_per_count=40))
    assert sum(levels) and run(levels, moves, 3) == []


def test_lost_counts_and_missing_index_are_reported():
    levels, moves = shaft(ramp(0, 450, clocks_per_count=4), turn=100)
    passes = run(levels, moves, 3, counts_per_turn=100, lost={600: -3})
    assert [p.difference for p in passes] == [None, 0, -3, 0, 0]
    missing = [level * (not 800 < clock < 1000) for clock, level in enumerate(levels)]
    assert [p.difference for p in run(missing, moves, 3, counts_per_turn=100)] == [None, 0, 100, 0]


def test_backward_turns_are_checked():
    levels, moves = shaft(ramp(0, -450, clocks_per_count=4), turn=100)
    passes = run(levels, moves, 3, counts_per_turn=100, lost={600: 2})
    assert [(p.count, p.difference) for p in passes] == [(-90, None), (-188, 2), (-288, 0), (-388, 0)]


@pytest.mark.parametrize("debounce", [0, 1, 3, 12])
def test_random_shaft(debounce):
    """Clean signals, slower than the debouncing: passes are the true crossings of the leading edge."""
    rng = random.Random(seed := debounce)
    print(f"seed {seed}")
    positions = wander(rng, 4000, 9.0, *((0.2, -30, 90) if debounce < 5 else (0.04, 0, 20)))
    levels, moves = shaft(positions, turn=100, width=5)
    passes = run(levels, moves, debounce, counts_per_turn=100)
    counts = [math.floor((position - 10.5) / 100) for position in positions]
    true = [
        (clock, max(counts[clock - 1], counts[clock]) * 100 + 10, counts[clock] < counts[clock - 1])
        for clock in range(1, len(positions))
        if counts[clock] != counts[clock - 1]
    ]
    if debounce <= 1:
        assert [(p.time, p.count, p.backward) for p in passes] == true
    assert {p.count % 100 for p in passes} == {10}
    assert not any(p.difference for p in passes)


@pytest.mark.parametrize("debounce", [0, 2, 7, 255])
def test_random_noise(debounce):
    rng = random.Random(seed := 50 + debounce)
    print(f"seed {seed}")
    levels, moves = shaft(wander(rng, 4000, 5.0, 0.3, -30, 90), turn=100, width=5)
    run(bounce(rng, levels, 12), moves, debounce, invert=bool(debounce % 2), counts_per_turn=100)


def test_policies_of_the_zero():
    """Reset follows each pass, latch none, first only the first since it was written; all else is the same."""
    levels, moves = shaft(ramp(0, 4200), turn=1000)
    edges = {move.time: move for move in moves}
    zeros = {}
    for policy in IndexPolicy:
        stimulus = [{"valid": 1, "level": level, "time": time, "edge": 0} for time, level in enumerate(levels)]
        for time, move in edges.items():
            stimulus[time] |= {"count": move.count, "edge": 1, "backward": move.backward}
        stimulus[0] |= {"debounce": 3, "policy": policy}
        if policy is IndexPolicy.FIRST:
            stimulus[16_400]["policy"], stimulus[17_000]["policy"] = IndexPolicy.RESET, IndexPolicy.FIRST
        got = trace(Index(), stimulus, ("zero_count", "passes", "pass_count"))
        assert got["passes"][-1] == 5 and got["pass_count"][-1] == 4010
        zeros[policy] = sorted(set(got["zero_count"]))
    assert zeros == {
        IndexPolicy.RESET: [0, 10, 1010, 2010, 3010, 4010],
        IndexPolicy.LATCH: [0],
        IndexPolicy.FIRST: [0, 10, 3010],
    }
