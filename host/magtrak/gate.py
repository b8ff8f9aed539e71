"""Ranges of colours to the words of the card's gate tables.

The card's hue byte is round(256 h) modulo 256 for a hue h of 0 to 1 turns; luminance and saturation are 0 to 255.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from operator import or_

from .protocol import LUT_WORDS

Spans = tuple[tuple[float, float], ...]
"""Ranges, both ends included."""

_BITS = 32


def pack_table(entries: Iterable[int]) -> Sequence[int]:
    """Words of a table in which these entries, 0 to 255, pass: entry i is bit i % 32 of word i // 32."""
    words = [0] * LUT_WORDS
    for entry in entries:
        words[entry // _BITS] |= 1 << entry % _BITS
    return words


def hue_table(first_deg: float, last_deg: float) -> Sequence[int]:
    """Hues from the first to the last, through 360 degrees where the first is greater; 0 to 360 is every hue."""
    first, last = round(first_deg * 256 / 360), round(last_deg * 256 / 360)
    if last_deg < first_deg:
        last += 256
    return pack_table(entry % 256 for entry in range(first, last + 1))


def range_table(low: float, high: float) -> Sequence[int]:
    """Bytes from ``low`` to ``high``, given as 0 to 1."""
    return pack_table(range(round(255 * low), round(255 * high) + 1))


def union(table: Callable[[float, float], Sequence[int]], spans: Spans) -> Sequence[int]:
    """What passes in any of the ranges; ``table`` makes the words of one."""
    return [reduce(or_, words) for words in zip(*(table(*span) for span in spans), strict=True)]
