"""Edges of encoder and index, at exactly the angles where they belong."""

from math import pi

import numpy as np
import pytest

from sim.encoder import Encoder, Event, Flaws, IndexBarrier, Signal
from sim.trajectory import Segment, Trajectory

N = 64
PITCH = 2 * pi / N


def line(start_s: float, end_s: float, start_counts: float, end_counts: float) -> Segment:
    return Segment.line(start_s, end_s, start_counts * PITCH, end_counts * PITCH)


def test_forward_edges_stand_at_whole_counts() -> None:
    encoder = Encoder(N, -0.5 * PITCH)
    assert (encoder.count, encoder.levels()) == (-1, {Signal.A: 0, Signal.B: 1})
    events = encoder.follow([line(0, 5, -0.5, 4.5)])
    # A leads B while the angle grows.
    assert [(e.signal, e.level) for e in events] == [
        (Signal.B, 0),
        (Signal.A, 1),
        (Signal.B, 1),
        (Signal.A, 0),
        (Signal.B, 0),
    ]
    assert [e.time_s for e in events] == pytest.approx([0.5, 1.5, 2.5, 3.5, 4.5])
    assert encoder.count == 4


def test_reversal_meets_the_same_edges_backward() -> None:
    """A parabola up to 2.5 counts and back again: each edge twice, at times that mirror each other."""
    encoder = Encoder(N, 0.5 * PITCH)
    segment = Segment.hermite(0, 2, 0.5 * PITCH, 0.5 * PITCH, 4 * PITCH, -4 * PITCH)
    assert segment.at(0.5) == pytest.approx(2.5 * PITCH)
    events = encoder.follow([segment])
    assert [(e.signal, e.level) for e in events] == [
        (Signal.A, 1),
        (Signal.B, 1),
        (Signal.B, 0),
        (Signal.A, 0),
    ]
    # 2.5 - 2 (t - 1)^2 = 1 and 2
    first, second = 1 - 0.75**0.5, 0.5
    assert [e.time_s for e in events] == pytest.approx([first, second, 2 - second, 2 - first])
    assert encoder.count == 0


def test_only_touching_a_mark_from_below_and_back_counts_twice_or_never() -> None:
    encoder = Encoder(N, 0.5 * PITCH)
    events = encoder.follow([line(0, 1, 0.5, 1.0), line(1, 2, 1.0, 0.5)])
    assert [(e.signal, e.level) for e in events] == [(Signal.A, 1), (Signal.A, 0)]
    assert [e.time_s for e in events] == pytest.approx([1, 1])
    assert encoder.count == 0


def test_a_random_walk_ends_at_the_floor_of_its_angle() -> None:
    seed = 11
    print("seed", seed)
    random = np.random.default_rng(seed)
    encoder = Encoder(N, 0.3 * PITCH)
    index = IndexBarrier(N, 5, 0.3 * PITCH)
    levels = encoder.levels() | index.levels()
    angle, speed, time = 0.3 * PITCH, 0.0, 0.0
    for _ in range(400):
        new, new_speed = angle + random.normal(0, 6) * PITCH, random.normal(0, 300) * PITCH
        segment = Segment.hermite(time, time + 0.02, angle, new, speed, new_speed)
        events = sorted(encoder.follow([segment]) + index.follow([segment]))
        for event in events:
            assert time <= event.time_s <= time + 0.02
            assert levels[event.signal] != event.level, "an output changed to what it was"
            levels[event.signal] = event.level
        angle, speed, time = new, new_speed, time + 0.02
        assert encoder.count == np.floor(angle / PITCH)
        assert levels == encoder.levels() | index.levels()
        assert levels[Signal.INDEX] == ((angle / PITCH - 0.5) % N < 5)


@pytest.mark.parametrize("turn", [0, 1, -1])
def test_index_stands_half_a_count_after_the_line_in_both_directions(turn: int) -> None:
    start = turn * N - 2.0
    index = IndexBarrier(N, 4, start * PITCH)
    up = index.follow([line(0, 10, start, start + 10)])
    assert up == [
        Event(pytest.approx(2.5), Signal.INDEX, 1),
        Event(pytest.approx(6.5), Signal.INDEX, 0),
    ]
    down = index.follow([line(10, 20, start + 10, start)])
    assert down == [
        Event(pytest.approx(13.5), Signal.INDEX, 1),
        Event(pytest.approx(17.5), Signal.INDEX, 0),
    ]


def test_index_edge_meets_the_same_count_both_ways() -> None:
    counts = []
    encoder, index = Encoder(N, -3.5 * PITCH), IndexBarrier(N, 4, -3.5 * PITCH)
    count = encoder.count
    for segment in (line(0, 5, -3.5, 1.5), line(5, 10, 1.5, -3.5)):
        rising = segment.c[1] > 0
        for event in sorted(encoder.follow([segment]) + index.follow([segment])):
            if event.signal is Signal.INDEX:
                counts.append(count)
            else:
                count += 1 if rising else -1
    assert counts == [0, 0]


def test_once_a_turn() -> None:
    index = IndexBarrier(N, 4, -0.1)
    events = index.follow([Segment.line(0, 1, -0.1, -0.1 + 10 * 2 * pi)])
    assert sum(event.level for event in events) == 10


def test_refuses() -> None:
    with pytest.raises(ValueError, match="multiple of 4, not 30"):
        Encoder(30, 0)
    with pytest.raises(ValueError, match="1 to 63 counts, not 64"):
        IndexBarrier(64, 64, 0)


def test_trajectory_forgets_only_what_is_old() -> None:
    trajectory = Trajectory(0.0, 1.0, history_s=0.5)
    assert trajectory.at([-5.0, 0.0]).tolist() == [1, 1]
    for i in range(5000):
        trajectory.extend([Segment.line(i * 1e-3, (i + 1) * 1e-3, 1 + i, 2 + i)])
    assert trajectory.at([4.5, 4.9995]) == pytest.approx([4501, 5000.5])
    with pytest.raises(ValueError, match="until 5"):
        trajectory.at([5.1])
    with pytest.raises(ValueError, match="forgotten"):
        trajectory.at([0.5])


def test_line_errors_are_the_same_in_every_turn() -> None:
    """Each edge comes where its line is; the errors are as great as asked for, and belong to the seed."""
    encoder = Encoder(N, 0.5 * PITCH, Flaws(line_error_counts=0.05, seed=3))
    events = encoder.follow([line(0, 3, 0.5, 3 * N + 0.5)])
    places = np.array([e.time_s for e in events]) * N + 0.5
    errors = (places - np.arange(1, 3 * N + 1)).reshape(3, N)
    assert np.abs(errors - errors[0]).max() < 1e-9
    assert 0.03 < errors.std() < 0.07
    assert errors[0] == pytest.approx(np.roll(encoder.line_errors_counts, -1))
    assert not np.allclose(errors[0], Encoder(N, 0.0, Flaws(0.05, seed=4)).line_errors_counts)


def test_jitter_moves_times_only() -> None:
    still = Encoder(N, 0.5 * PITCH).follow([line(0, 1, 0.5, N)])
    shaken = Encoder(N, 0.5 * PITCH, Flaws(jitter_s=1e-4, seed=1)).follow([line(0, 1, 0.5, N)])
    assert [e[1:] for e in still] == [e[1:] for e in shaken]
    late = np.array([b.time_s - a.time_s for a, b in zip(still, shaken, strict=True)])
    assert 0.5e-4 < late.std() < 2e-4
    times = [e.time_s for e in shaken]
    assert times == sorted(times) and times[0] >= 0 and times[-1] <= 1
