"""Latches and edge log against their definitions."""

import random

import pytest

from gateware.motion.angle import AngleLatch, EdgeLog
from gateware.motion.quadrature import Move
from magtrak.protocol import EDGE, MAX_EDGES
from tests.support.simulation import simulate
from tests.support.trace import trace


@pytest.mark.parametrize("keep_first", [True, False])
def test_latches(keep_first):
    """`first` and `last` take all that belongs together, at their strobes only.

    Where the former is not kept the latter stays for a while.
    """
    rng = random.Random(seed := 5)
    print(f"seed {seed}")
    bits = {"time": 48, "count": 31, "age": 32, "period": 32}
    states = [{name: rng.getrandbits(width) for name, width in bits.items()} for _ in range(200)]
    rows = [rng.choice([(0, 0), (1, 0), (1, 1)]) for _ in states]
    stimulus = [
        {f"now.{name}": value for name, value in state.items()} | {"row_first": row, "frame_first": frame}
        for state, (row, frame) in zip(states, rows, strict=True)
    ]
    names = [f"{latch}.{name}" for latch in ("first", "last") for name in bits]
    got = trace(AngleLatch(keep_first=keep_first), [*stimulus, {}], [*names, "first_is_last"])
    want = dict.fromkeys(names, 0)
    for clock, (state, (row, frame)) in enumerate(zip(states, rows, strict=True)):
        for name, value in state.items():
            if frame and keep_first:
                want[f"first.{name}"] = value
            if frame or (row and (keep_first or not any(frame for _, frame in rows[max(clock - 7, 0) : clock]))):
                want[f"last.{name}"] = value
        assert {name: got[name][clock + 1] for name in names} == want
        assert got["first_is_last"][clock + 1] == frame


def run(log, moves, takes, clocks, start=0):
    """Take the log at the given times, read it after each, and compare with the definition."""
    edges = {move.time: move for move in moves}
    begin, seen = 0, []
    ends = iter(takes)
    reading, expected = None, None

    async def testbench(ctx):
        nonlocal begin, reading, expected
        end = next(ends, None)
        for clock in range(clocks):
            move = edges.get(clock)
            ctx.set(log.time, clock + start)
            ctx.set(log.edge, move is not None)
            if move:
                ctx.set(log.count, move.count)
                ctx.set(log.backward, move.backward)
            ctx.set(log.take, clock == end)
            # Read entry after entry, all the time while the next log is being written.
            ctx.set(log.index, clock % MAX_EDGES)
            _, _, entry, entries, shift = await ctx.tick().sample(log.entry, log.entries, log.shift)
            if expected is not None and clock > reading + log.read_latency:
                assert shift == expected[0]
                assert entries == len(expected[1])
                index = (clock - log.read_latency) % MAX_EDGES
                if index < entries:
                    assert EDGE.unpack(entry.as_bits().to_bytes(EDGE.size, "little")) == expected[1][index]
                    seen.append(index)
            if clock == end:
                here = [
                    Move(move.time + start, move.count, move.backward, False) for move in moves if move.time >= begin
                ]
                expected = log.reference(here, end + start)
                reading, begin = clock, end
                end = next(ends, None)

    simulate(log, testbench, clocks=clocks + 1)
    return seen


@pytest.mark.parametrize("edges", [0, 1, 15, 16, 17, 31, 32, 33, 64, 65, 255, 256, 257, 600])
def test_thinning(edges):
    """Any number of edges, one in each clock, around every doubling of the stride."""
    moves = [Move(10 + number, number + 1, False, False) for number in range(edges)]
    take = 12 + edges
    seen = run(EdgeLog(), moves, [take], take + 40)
    shift, entries = EdgeLog().reference(moves, take)
    assert set(seen) == set(range(len(entries)))
    assert len(entries) == -(-edges >> shift) <= MAX_EDGES if edges else not entries


def test_by_hand():
    moves = [Move(5 * number, number, False, False) for number in range(1, 21)]
    shift, entries = EdgeLog().reference(moves, 200)
    assert shift == 1
    assert [entry["count"] for entry in entries] == [1, 3, 5, 7, 9, 11, 13, 15, 17, 19]
    assert entries[1]["time"] == 15


@pytest.mark.parametrize("seed", range(4))
def test_random_edges_and_takes(seed):
    """Reading a log while the next one fills; edges in the clock of the take, and next to it."""
    rng = random.Random(seed)
    print(f"seed {seed}")
    moves, time, count = [], 0, rng.randrange(-(1 << 31), 1 << 31)
    while time < 4000:
        time += rng.choice([1, 1, 2, 4, 9, 60])
        backward = rng.random() < 0.3
        count += -1 if backward else 1
        moves.append(Move(time, count, backward, False))
    takes = sorted({rng.choice(moves).time + rng.choice([-1, 0, 1]) for _ in range(20)})
    takes = [take for take, before in zip(takes, [-100, *takes], strict=False) if take - before > MAX_EDGES + 2]
    assert run(EdgeLog(), moves, takes, 4000, start=(1 << 32) - 2000)


def test_two_takes_in_a_row_give_an_empty_log():
    moves = [Move(time, time, False, False) for time in range(3, 9)]
    run(EdgeLog(), moves, [20, 21], 60)


@pytest.mark.parametrize(
    ("more", "take", "entries"),
    [
        ([], 73, 3),
        ([], 74, 0),
        ([], 75, 0),
        ([72], 73, 4),
        ([73], 74, 0),
        ([74], 74, 0),
        ([74], 75, 1),
        ([75], 80, 1),
        ([74, 90], 137, 2),
        ([74, 90], 138, 0),
    ],
)
def test_old_log_is_emptied(more, take, entries):
    """64 clocks after its first entry, whether another edge comes then or not."""
    log = EdgeLog(horizon_bits=6)
    moves = [Move(time, time, False, False) for time in (10, 20, 30, *more)]
    run(log, moves, [take], take + 40)
    assert len(log.reference(moves, take)[1]) == entries


def test_horizon_is_checked():
    with pytest.raises(ValueError, match="32"):
        EdgeLog(32)
