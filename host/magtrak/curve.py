"""The encoder's movement as a smooth curve through its edges.

An edge lies at a whole count: the position between edges follows from those before and after. The curve is a cubic
between each two edges (Hermite's); its slope at an edge is that of the parabola through the edge and its neighbours.
So it is exact at constant speed and at constant acceleration, reversals included (an edge passed twice lies at the same
place both times), and it never leaves the count that the encoder shows.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from math import inf
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from .arrays import Booleans, Floats
from .edges import Edge

STANDSTILL_RATIO = 8.0
"""An interval so many times as long as both its neighbours is a stop, not slow motion: turning round at constant
acceleration makes a ratio of at most 4.9."""

_HISTORY = 8
"""Edges kept before what is still asked for: the curve uses two."""


_time = attrgetter("time")


@dataclass(frozen=True, slots=True)
class Latched:
    """What a latch tells: no edge came from ``start`` to ``end`` (clocks since reset), and the count was ``count``."""

    start: int
    end: int
    count: int


_Interval = tuple[float, float, float, float, float, float]
"""Between two edges, or before the first, or after the last: the polynomial from the edge that it is told from,
c0 + c1 x + c2 x^2 + c3 x^3 counts after x clocks, and the least and greatest position there."""


class _Part(NamedTuple):
    """Some intervals one after the other: when each begins, or the edge is that it is told from; the bounds between
    them; and whether the encoder stood. ``open`` tells that those before the first edge and after the last are there,
    ``thinned`` that edges may be missing.
    """

    open: bool
    begins: list[int]
    bounds: list[int]
    intervals: list[_Interval]
    stops: list[bool]
    thinned: bool


class Curve:
    """Grows at its end.

    Attributes
    ----------
    edges : that it goes through, in order of time
    """

    def __init__(self) -> None:
        self.edges: list[Edge] = []
        # At each edge but the last, and after it: complete, whatever comes later, but for the last two intervals.
        self._slopes: list[float] = []
        self._intervals: list[_Interval] = []
        self._stops: list[bool] = []

    def extend(self, edges: Iterable[Edge]) -> None:
        """Take the next edges; what does not come after those that are there is left out."""
        for edge in edges:
            if not self.edges or edge.time > self.edges[-1].time:
                self.edges.append(edge)
                if len(self.edges) > 2:
                    self._complete(*self.edges[-3:])

    def forget(self, before: int) -> None:
        """Times before this, in clocks since reset, will not be asked for."""
        end = bisect_left(self.edges, before, key=_time) - _HISTORY
        if end >= _HISTORY:  # not a few at a time
            for kept in (self.edges, self._slopes, self._intervals, self._stops):
                del kept[:end]

    def at(
        self, times: Floats, origin: int, quiet_until: int, known: Iterable[Latched] = ()
    ) -> tuple[Floats, Booleans]:
        """Positions in counts, and where the encoder stood still: the position is the middle of its count there.

        Before the first and after the last edge the outermost parabola goes on, within the count. Needs an edge.

        Parameters
        ----------
        times : whole clocks after ``origin``, ascending
        origin : clocks since reset
        quiet_until : clocks since reset until which no edge came after the last one
        known : where latches tell the count, which edges may not: a log that was thinned leaves out its last ones
        """
        several = len(self.edges) > 1
        part = self._part(times, origin, quiet_until)
        ends = np.searchsorted(times, part.bounds)
        rows = np.empty(len(ends) + 1, np.intp)
        rows[:-1], rows[-1] = ends, len(times)
        rows[1:] -= ends
        # Each row takes its interval's numbers in one go: there are some ten intervals and a thousand rows.
        table = np.empty((7, len(rows)))
        table[0] = part.begins
        table[1:] = np.fromiter(chain.from_iterable(part.intervals), np.float64).reshape(-1, 6).T
        begin, c0, c1, c2, c3, low, high = table.repeat(rows, axis=1)
        x = np.subtract(times, begin, out=begin)
        position = c3  # ((c3 x + c2) x + c1) x + c0, in place
        for c in (c2, c1, c0):
            position *= x
            position += c
        if part.thinned:
            for latch in known:
                start = np.searchsorted(times, latch.start - origin)
                end = np.searchsorted(times, latch.end - origin, side="right")
                low[start:end] = latch.count
                high[start:end] = latch.count + 1
        np.maximum(position, low, out=position)
        np.minimum(position, high, out=position)
        standing = np.zeros(len(times), bool)
        if part.open or any(part.stops):
            standing |= np.repeat(part.stops, rows)
            if several and rows[0] and part.open:
                first, second = part.begins[1:3]
                standing[: rows[0]] = first - times[: rows[0]] > STANDSTILL_RATIO * (second - first)
            sure = standing & (high - low == 1)
            position[sure] = low[sure] + 0.5
            if several:
                standing = sure
        return position, standing

    def _part(self, times: Floats, origin: int, quiet_until: int) -> _Part:
        """The intervals of these times, where they are complete; all, where not."""
        edges, count = self.edges, len(times)
        first, last = (int(times[0]), int(times[-1])) if count else (0, 0)
        start = bisect_right(edges, origin + first, key=_time) - 1
        end = bisect_right(edges, origin + last, key=_time)
        if start >= 0 and end <= len(self._intervals):
            begins = [edge.time - origin for edge in edges[start:end]]
            thinned = any(edge.unlogged for edge in edges[start + 1 : end + 1])
            return _Part(False, begins, begins[1:], self._intervals[start:end], self._stops[start:end], thinned)
        begins = [edge.time - origin for edge in edges]
        intervals, stops = self._all(max(quiet_until, origin + last))
        return _Part(True, [begins[0], *begins], begins, intervals, stops, any(edge.unlogged for edge in edges))

    def _complete(self, a: Edge, b: Edge, c: Edge) -> None:
        """The interval from a to b, now that c is known."""
        slope, _ = _parabola(a, b, c)
        slopes = self._slopes
        if not slopes:
            slopes.append(2 * _speed(a, b) - slope)
        self._intervals.append(_between(a, b, slopes[-1], slope))
        slopes.append(slope)
        before = self.edges[-4].time if len(self.edges) > 3 else a.time
        self._stops.append(b.time - a.time > STANDSTILL_RATIO * max(a.time - before, c.time - b.time))

    def _all(self, latest: int) -> tuple[list[_Interval], list[bool]]:
        """All intervals, and whether each is so long that the encoder must have stood; that before the first edge is
        not judged. No edge came after the last one until ``latest``.
        """
        edges = self.edges
        first, last = edges[0], edges[-1]
        if len(edges) == 1:  # nothing tells its speed
            shown = first.before, first.shown
            return [(count + 0.5, 0, 0, 0, *_within(count, first.unlogged)) for count in shown], [True, True]
        before = edges[-2]
        length, speed = last.time - before.time, _speed(before, last)
        if len(edges) == 2:
            first_slope = slope_before = last_slope = speed
            first_bend = last_bend = 0.0
            stopped = False
        else:
            first_slope, slope_before = self._slopes[0], self._slopes[-1]
            last_slope = 2 * speed - slope_before
            _, first_bend = _parabola(*edges[:3])
            _, last_bend = _parabola(*edges[-3:])
            stopped = length > STANDSTILL_RATIO * (before.time - edges[-3].time)
        head = first.position, first_slope, first_bend / 2, 0, *_within(first.before, first.unlogged)
        closing = _between(before, last, slope_before, last_slope)
        tail = last.position, last_slope, last_bend / 2, 0, *_within(last.shown, last.unlogged)
        stops = [False, *self._stops, stopped, latest - last.time > STANDSTILL_RATIO * length]
        return [head, *self._intervals, closing, tail], stops


def _speed(a: Edge, b: Edge) -> float:
    """Counts a clock."""
    return (b.position - a.position) / (b.time - a.time)


def _parabola(a: Edge, b: Edge, c: Edge) -> tuple[float, float]:
    """First and second derivative at b of the parabola through three edges; the second is the same everywhere."""
    at, middle = a.time, b.time
    h, k = middle - at, c.time - middle
    s, r = (b.position - a.position) / h, (c.position - b.position) / k
    return (k * s + h * r) / (h + k), 2 * (r - s) / (h + k)


def _between(a: Edge, b: Edge, slope_a: float, slope_b: float) -> _Interval:
    """Hermite's cubic."""
    h, start = b.time - a.time, a.position
    s = (b.position - start) / h
    left = s - slope_a
    twist = (slope_b - s - left) / h
    return start, slope_a, left / h - twist, twist / h, *_within(a.shown, b.unlogged)


def _within(shown: int, unlogged: int) -> tuple[float, float]:
    """The least and greatest position where the encoder showed a count, and edges may be missing."""
    away = inf if unlogged < 0 else unlogged
    return shown - away, shown + 1 + away
