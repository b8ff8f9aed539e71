"""A shaft with an encoder and an index barrier, as motion tests turn it."""

import math
import random
from collections.abc import Sequence

PHASES = ((0, 0), (1, 0), (1, 1), (0, 1))
"""Levels of A and B in four counts, on the way forward."""


def encoder(position: float) -> tuple[int, int]:
    """A and B of a shaft at ``position`` counts."""
    return PHASES[math.floor(position) % 4]


def barrier(position: float, edge: float, width: float, turn: float) -> int:
    """Index of a shaft at ``position``: 1 over ``width`` counts from ``edge`` on, every ``turn``."""
    return int((position - edge) % turn < width)


def wander(rng: random.Random, clocks: int, start: float, step: float, low: float, high: float) -> list[float]:
    """Positions of a shaft that speeds up, slows down, stands and reverses between ``low`` and ``high``.

    ``step`` is the most that it moves in a clock.
    """
    positions, position, speed = [], start, 0.0
    while len(positions) < clocks:
        target = rng.choice([-1, -0.3, -0.05, 0, 0.05, 0.3, 1]) * step
        for _ in range(rng.randrange(10, 150)):
            speed += 0.1 * (target - speed)
            position += speed
            if not low <= position <= high:
                position = min(max(position, low), high)
                speed, target = -speed, -target
            positions.append(position)
    return positions[:clocks]


def bounce(rng: random.Random, levels: Sequence[int], longest: int) -> list[int]:
    """Levels whose every change chatters for up to ``longest`` clocks, and that now and then have a spike."""
    out = list(levels)
    for clock in range(1, len(levels)):
        if levels[clock] != levels[clock - 1]:
            for late in range(1, rng.randrange(1, longest + 1)):
                if clock + late < len(out):
                    out[clock + late] = rng.getrandbits(1)
        elif rng.random() < 0.002:
            out[clock] ^= 1
    return out
