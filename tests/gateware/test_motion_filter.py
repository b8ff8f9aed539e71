"""The glitch filter and the delay that matches it."""

import random

import pytest

from gateware.motion.filter import Align, GlitchFilter
from tests.support.trace import trace


def test_filter_by_hand():
    levels = [0, 1, 1, 0, 0, 0, 1, 1, 1, 0, 1, 1, 0, 0, 0]
    assert GlitchFilter.reference(levels, 3) == [0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 0, 0, 0]


@pytest.mark.parametrize("length", [0, 1, 2, 5, 255])
def test_filter_against_definition(length):
    random.seed(seed := length)
    print(f"seed {seed}")
    levels = [0]
    while len(levels) < 3000:
        levels += [random.getrandbits(1)] * random.choice([1, 2, max(1, length - 1), length, length + 1])
    delay = max(length, 1)
    got = trace(GlitchFilter(), [{"i": level, "length": length} for level in levels], ("o",))["o"]
    assert got[delay:] == GlitchFilter.reference(levels, length)[:-delay]


@pytest.mark.parametrize("length", [0, 1, 2, 3, 255])
def test_delay(length):
    """Each word once, in order, after the stated latency; nothing before the first."""
    words = [random.randrange(1, 8) for _ in range(1200)]
    got = trace(Align(3), [{"i": word, "length": length} for word in words], ("o", "valid"))
    latency = Align.latency(length)
    assert got["o"] == [0] * latency + words[:-latency]
    assert got["valid"] == [0] * latency + [1] * (len(words) - latency)


def test_width_is_checked():
    with pytest.raises(ValueError, match="0 bits"):
        Align(0)
