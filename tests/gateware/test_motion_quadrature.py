"""The decoder against its definition, clock by clock."""

import random

import pytest

from gateware.motion.quadrature import UNKNOWN, Quadrature
from tests.support.trace import trace

OUTPUTS = ("count", "edge", "backward", "illegal", "illegals", "age", "period")
PHASES = ((0, 0), (1, 0), (1, 1), (0, 1))  # forward


def expected(a, b, length, swap=False):
    """The outputs in each clock, as the docstrings of the decoder define them."""
    moves = {move.time + Quadrature.latency(length): move for move in Quadrature.reference(a, b, length, swap)}
    state = {"count": 0, "backward": 0, "illegals": 0, "age": UNKNOWN, "period": UNKNOWN}
    rows = {name: [] for name in OUTPUTS}
    for clock in range(len(a)):
        move = moves.get(clock)
        edge, illegal = bool(move and not move.illegal), bool(move and move.illegal)
        age = min(state["age"] + 1, UNKNOWN)
        state["age"] = 0 if edge else age
        state["illegals"] = min(state["illegals"] + illegal, 65535)
        if edge:
            state.update(count=move.count, backward=move.backward, period=age)
        for name, value in {**state, "edge": edge, "illegal": illegal}.items():
            rows[name].append(value)
    return rows


def check(a, b, length, swap=False):
    stimulus = [{"a": x, "b": y} for x, y in zip(a, b, strict=True)]
    stimulus[0] |= {"length": length, "swap": swap}
    got = trace(Quadrature(), stimulus, OUTPUTS)
    want = expected(a, b, length, swap)
    want["age"][0] = 0  # in the clock after reset, as stated
    for name in OUTPUTS:
        assert got[name] == want[name], name
    return got


def levels(phase_of_clock):
    return tuple(zip(*(PHASES[phase % 4] for phase in phase_of_clock), strict=True))


def hold(phases, clocks):
    return [phase for phase in phases for _ in range(clocks)]


@pytest.mark.parametrize("swap", [False, True])
def test_forward_by_hand(swap):
    """A leads B: up; with swapped pins: down. The edges stand where the pins changed."""
    a, b = levels(hold([0, 1, 2, 3, 4, 5], 10) + [5] * 10)
    got = check(a, b, 3, swap)
    edges = [clock for clock, edge in enumerate(got["edge"]) if edge]
    assert [clock - Quadrature.latency(3) for clock in edges] == [10, 20, 30, 40, 50]
    assert got["count"][-1] == (-5 if swap else 5)
    assert got["period"][-1] == 10
    assert got["age"][-1] == 69 - 50 - Quadrature.latency(3)


@pytest.mark.parametrize("phase", range(4))
def test_any_state_at_reset_is_no_count(phase):
    got = check(*levels([phase] * 40), 5)
    assert not any(got["edge"]) and not any(got["illegals"])


@pytest.mark.parametrize("length", [0, 1, 2, 3, 4, 8])
def test_greatest_edge_rate(length):
    """One edge every four clocks: none is lost. Reversing, a pin changes back after four clocks; a
    longer filter takes this for a glitch, and the count is right all the same.
    """
    phases = [*range(60), *range(60, -30, -1)]
    a, b = levels(hold(phases, 4) + [phases[-1]] * 20)
    got = check(a, b, length)
    assert sum(got["edge"]) == len(phases) - (1 if length <= 4 else 3)
    assert got["count"][-1] == phases[-1]
    assert set(got["period"][60:]) == ({4} if length <= 4 else {4, 12})


def test_an_edge_each_clock():
    got = check(*levels([*range(50), *[49] * 10]), 1)
    assert got["count"][-1] == 49


@pytest.mark.parametrize("length", [2, 3, 7, 255])
def test_glitch_bursts_are_no_edges(length):
    """Pulses shorter than the filter on a standing encoder, on both pins, at the same time too."""
    random.seed(seed := length)
    print(f"seed {seed}")
    a, b = [], []
    for pin in (a, b):
        pin += [0] * length
        while len(pin) < 1500:
            pin += [1] * random.randrange(1, length) + [0] * random.randrange(1, 2 * length)
        del pin[1500:]
    got = check([*a, *[0] * 300], [*b, *[0] * 300], length)
    assert not any(got["edge"]) and not any(got["illegal"])


def test_illegal_transitions_move_nothing():
    """From 00 to 11 and back; an edge between them is still measured from the edge before."""
    phases = hold([0, 1, 3, 1, 2, 0, 1], 9)
    got = check(*levels([*phases, *[1] * 9]), 2)
    assert got["illegals"][-1] == 3
    assert got["count"][-1] == 3
    assert [p for p, e in zip(got["period"], got["edge"], strict=True) if e] == [UNKNOWN, 27, 18]


def test_illegal_transitions_saturate():
    stimulus = [{"a": clock // 4 % 2, "b": clock // 4 % 2, "length": 1} for clock in range(60)]
    stimulus[0]["illegals"] = 65533  # where the register would be much later
    assert trace(Quadrature(), stimulus, ("illegals",))["illegals"][-3:] == [65535] * 3


def test_ages_saturate():
    """An edge, and long after it another one."""
    a, b = levels([0] * 10 + [1] * 80 + [2] * 30)
    stimulus = [{"a": x, "b": y, "length": 3} for x, y in zip(a, b, strict=True)]
    stimulus[40]["age"] = UNKNOWN - 20  # where the register would be much later
    got = trace(Quadrature(), stimulus, ("age", "period"))
    assert got["age"][50] == UNKNOWN - 10
    assert got["age"][80] == got["period"][-1] == UNKNOWN
    assert got["age"][-1] == 119 - 90 - Quadrature.latency(3)


@pytest.mark.parametrize("length", [0, 1, 3, 6, 40])
@pytest.mark.parametrize("swap", [False, True])
def test_random_walk(length, swap):
    """Any speed, jitter, reversals, glitches and jumps, faster than the filter allows too."""
    random.seed(seed := 100 * length + swap)
    print(f"seed {seed}")
    phase, phases = random.randrange(4), []
    direction = 1
    while len(phases) < 2500:
        phase += random.choices([direction, 2, -direction], [30, 1, 1])[0]
        direction = random.choices([direction, -direction], [15, 1])[0]
        phases += [phase] * random.choice([1, 2, 4, 4 + length, 4 + 2 * length + random.randrange(40)])
    a, b = (list(pin) for pin in levels(phases))
    for _ in range(150):
        random.choice([a, b])[random.randrange(len(a))] ^= 1
    check(a, b, length, swap)
