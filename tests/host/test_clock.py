"""The card's clock against the computer's."""

import random

import numpy as np
import pytest

from magtrak.clock import CardClock


def arrivals(rng: np.random.Generator, count: int, drift: float, offset_s: float) -> list[tuple[float, float]]:
    """Card times of frames, and when they came: most a little late, some very, a few hardly at all."""
    card = np.arange(count) / 60 + 3.0
    late = 0.002 + rng.exponential(0.004, count) + (rng.random(count) < 0.05) * rng.uniform(0, 0.5, count)
    late[rng.random(count) < 0.05] = 0.002
    return list(zip(card, offset_s + (1 + drift) * card + late, strict=True))


@pytest.mark.parametrize("drift", [0.0, 40e-6, -95e-6])
def test_offset_and_drift_among_delays(drift: float) -> None:
    seed = random.randrange(2**32)
    print("seed", seed)
    clock = CardClock(epoch_s=1.7e9)
    for card_s, arrival_s in arrivals(np.random.default_rng(seed), 6000, drift, 1000.0):
        clock.add(card_s, arrival_s)
    mapping = clock.mapping
    assert mapping is not None
    assert abs(mapping.drift - drift) < 2e-6
    for card_s in (3.0, 50.0, 103.0):
        true_s = 1.7e9 + 1000 + 0.002 + (1 + drift) * card_s  # the least delay cannot be told from an offset
        assert abs(mapping.host_s(card_s) - true_s) < 0.2e-3


def test_the_line_is_the_best_below_all_points() -> None:
    """Against the linear programme of Moon et al., solved by going through all pairs of points."""
    rng = np.random.default_rng(5)
    card = np.sort(rng.uniform(0, 100, 60))
    arrival = card * (1 + 20e-6) + rng.exponential(0.001, 60)
    clock = CardClock(epoch_s=0.0)
    for one in zip(card, arrival, strict=True):
        clock.add(*one)
    mapping = clock.mapping
    assert mapping is not None
    y = arrival - card
    best = np.inf
    for i in range(60):
        for j in range(i):
            slope = (y[i] - y[j]) / (card[i] - card[j])
            above = y - (y[j] + slope * (card - card[j]))
            if above.min() > -1e-12:
                best = min(best, above.sum())
    line = np.array([mapping.host_s(one) - one for one in card])
    assert (y - line).min() > -1e-9
    assert (y - line).sum() == pytest.approx(best, abs=1e-7)


def test_first_packets_and_a_reset() -> None:
    clock = CardClock(epoch_s=0.0)
    assert clock.mapping is None and clock.delay_s(0, 0) is None
    clock.add(10.0, 110.5)
    assert clock.mapping is not None and (clock.mapping.offset_s, clock.mapping.drift) == (100.5, 0.0)
    clock.add(10.1, 110.6 + 0.3)  # a drift of 3 is none: too short a time
    assert (clock.mapping.offset_s, clock.mapping.drift) == (100.5, 0.0)
    assert clock.delay_s(10.1, 110.9) == pytest.approx(0.3)
    clock.reset()
    clock.add(0.1, 200.1)
    assert clock.mapping.host_s(1.0) == pytest.approx(201.0)
    assert clock.mapping.text(1.0) == "1970-01-01T00:03:21.000000+00:00"


def test_a_virtual_card_that_does_not_keep_pace_has_no_such_time() -> None:
    clock = CardClock(epoch_s=0.0)
    for number in range(200):
        clock.add(number / 60, 8 * number / 60)
    assert clock.mapping is None


def test_it_stays_small() -> None:
    clock = CardClock(epoch_s=0.0)
    for card_s, arrival_s in arrivals(np.random.default_rng(1), 20_000, 1e-5, 0.0):
        clock.add(card_s, arrival_s)
    assert len(clock._hull) < 100
