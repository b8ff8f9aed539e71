"""The encoder's position at the time of each row.

A bare count is off by up to a whole one. The card logs when edges came, and an edge lies at a whole count: the position
between edges follows from a smooth curve through those before and after. The curve is a cubic between each two edges;
its slope at an edge is that of the parabola through the edge and its neighbours. So it is exact at constant speed and
at constant acceleration, reversals included (an edge passed twice lies at the same place both times), and it never
leaves the count that the encoder shows.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np

from .arrays import Booleans, Floats, joined
from .edges import SAME_EDGE_CLOCKS, Edges, edges_of_frame, wrapped_difference
from .frames import Frame

# An interval so many times as long as both its neighbours is a stop, not slow motion: turning round at constant
# acceleration makes a ratio of at most 4.9.
STANDSTILL_RATIO = 8.0

TOGETHER = 8
"""Frames whose angles and points are computed together where they wait."""

# Edges kept before the first row in need: the curve uses two.
_HISTORY = 8


@dataclass(frozen=True)
class RowAngles:
    """Where the encoder was when the light of each row was gathered.

    Attributes
    ----------
    counts : from the index, fractions included
    standing : the encoder stood still: the position is the middle of its count, and off by up to half a count
    """

    counts: Floats
    standing: Booleans


@dataclass(frozen=True, slots=True)
class Latched:
    """What a latch tells: no edge came from ``start`` to ``end`` (clocks since reset), and the count was ``count``."""

    start: int
    end: int
    count: int


def latches(frame: Frame, last_count: int) -> tuple[Latched, Latched]:
    """The latches of a frame at its first and last row; ``last_count`` is its own, unwrapped over the stream."""
    header = frame.header
    first_count = last_count + wrapped_difference(header["first_count"], header["last_count"])
    first, last = header["first_time"], header["last_time"]
    return (
        Latched(first - header["first_age"] + SAME_EDGE_CLOCKS, first, first_count),
        Latched(last - header["last_age"] + SAME_EDGE_CLOCKS, last, last_count),
    )


def interpolate(
    edges: Edges, times: Floats, origin: int, quiet_until: int, known: Iterable[Latched] = ()
) -> tuple[Floats, Booleans]:
    """Positions in counts, and where the encoder stood still, at ``times`` (clocks after ``origin``).

    Before the first and after the last edge the outermost parabola goes on, within the count. Needs an edge.

    Parameters
    ----------
    edges : all that are known around the times
    times : clocks after ``origin``, ascending; what is given for whole clocks does not depend on ``origin``
    origin : clocks since reset
    quiet_until : clocks since reset until which no edge came after the last one
    known : where latches tell the count, which edges may not: a log that was thinned leaves out its last ones
    """
    t = (edges.time - origin).astype(np.float64)
    count = len(t)
    ends = np.searchsorted(times, t)
    # Interval i lies before edge i; the first and the last are open. How many rows are in each:
    rows = np.empty(count + 1, np.intp)
    rows[0], rows[1:-1], rows[-1] = ends[0], ends[1:] - ends[:-1], len(times) - ends[-1]
    # Each row takes its interval's numbers in one go: there are some twenty intervals and a thousand rows.
    table = np.empty((7, count + 1))
    _, c0, _, _, _, low, high = table
    # What the encoder showed in each interval, and how far unlogged edges may have led away from it.
    low[0], low[1:] = edges.before[0], edges.count
    np.add(low, 1, out=high)
    thinned = bool(edges.unlogged.any())
    if thinned:
        away = np.append(edges.unlogged, edges.unlogged[-1:]).astype(np.float64)
        away[away < 0] = np.inf
        low -= away
        high += away
    if count > 1:
        _curves(t, edges.position.astype(np.float64), table[:5])
        still = _standing(t, times, quiet_until - origin)
    else:
        table[:5] = 0
        c0[:] = [edges.before[0] + 0.5, edges.count[0] + 0.5]
        still = np.ones(2, bool)
    begin, c0, c1, c2, c3, low, high = table.repeat(rows, axis=1)
    x = np.subtract(times, begin, out=begin)
    position = c3  # ((c3 x + c2) x + c1) x + c0, in place
    for c in (c2, c1, c0):
        position *= x
        position += c
    if thinned:
        for latch in known:
            start = np.searchsorted(times, latch.start - origin)
            end = np.searchsorted(times, latch.end - origin, side="right")
            low[start:end] = latch.count
            high[start:end] = latch.count + 1
    np.maximum(position, low, out=position)
    np.minimum(position, high, out=position)
    standing = np.zeros(len(times), bool)
    if still.any():
        standing |= still.repeat(rows)
    if count > 1 and rows[0]:
        early = times[: rows[0]]
        standing[: rows[0]] |= t[0] - early > STANDSTILL_RATIO * (t[1] - t[0])
    if standing.any():
        sure = standing & (high - low == 1)
        position[sure] = low[sure] + 0.5
        if count > 1:
            standing = sure
    return position, standing


def _curves(t: Floats, p: Floats, table: Floats) -> None:
    """For each interval, the open ones included: where it begins, and the coefficients of its polynomial from there.

    Parameters
    ----------
    t, p : time and position of each edge, (N,)
    table : takes them, (5, N + 1)
    """
    h = t[1:] - t[:-1]
    s = (p[1:] - p[:-1]) / h
    slope, bend = _derivatives(h, s)
    begin, c0, c1, c2, c3 = table
    begin[0], begin[1:] = t[0], t
    c0[0], c0[1:] = p[0], p
    c1[0], c1[1:] = slope[0], slope
    # Hermite's cubic between two edges; the outermost parabolas go on.
    left = s - slope[:-1]
    twist = (slope[1:] - s - left) / h
    c2[0], c2[1:-1], c2[-1] = bend[0] / 2, left / h - twist, bend[-1] / 2
    c3[0], c3[1:-1], c3[-1] = 0, twist / h, 0


def _derivatives(h: Floats, s: Floats) -> tuple[Floats, Floats]:
    """First and second derivative at each edge of the parabola through it and its neighbours; at an end, of the
    outermost parabola; of a straight line where there are but two edges.

    Parameters
    ----------
    h : clocks between edges
    s : counts a clock between them
    """
    slope, bend = np.zeros(len(h) + 1), np.zeros(len(h) + 1)
    if len(s) == 1:
        slope[:] = s
        return slope, bend
    both = h[:-1] + h[1:]
    slope[1:-1] = (h[1:] * s[:-1] + h[:-1] * s[1:]) / both
    bend[1:-1] = 2 * (s[1:] - s[:-1]) / both
    slope[0], slope[-1] = 2 * s[0] - slope[1], 2 * s[-1] - slope[-2]
    bend[0], bend[-1] = bend[1], bend[-2]
    return slope, bend


def _standing(t: Floats, times: Floats, quiet_until: float) -> Booleans:
    """Whether each interval is so long that the encoder must have stood; that before the first edge is not judged."""
    h = t[1:] - t[:-1]
    still = np.zeros(len(t) + 1, bool)
    lengths = h.tolist()
    if max(lengths) > STANDSTILL_RATIO * min(lengths):
        longer_neighbour = np.maximum(np.concatenate([[0.0], h[:-1]]), np.concatenate([h[1:], [0.0]]))
        still[1:-1] = (h > STANDSTILL_RATIO * longer_neighbour) & (longer_neighbour > 0)
    latest = max(quiet_until, float(times[-1]) if len(times) else 0.0)
    still[-1] = latest - t[-1] > STANDSTILL_RATIO * lengths[-1]
    return still


class _Waiting(NamedTuple):
    """A frame that is held back: its ``last_count`` unwrapped, its times' offset in whole clocks."""

    frame: Frame
    last_count: int
    offset: int

    @property
    def first(self) -> int:
        """When its first row's light was gathered."""
        return self.frame.header["first_time"] + self.offset

    @property
    def last(self) -> int:
        return self.frame.header["last_time"] + self.offset


class AngleTracker:
    """Gives each frame of a stream the encoder's position at its rows, a few frames late.

    A row's curve needs edges after it, which come with the frames that follow. A frame is held back until two edges
    after its last row are known, or ``patience_s`` has passed: turning round takes as long.

    Parameters
    ----------
    clock_hz : of the card
    time_offset_s : added to row times, the calibration's; the frame's own ``time_offset_ns`` comes on top
    patience_s : how long a frame is held back at most, by the card's time
    """

    def __init__(self, clock_hz: float, time_offset_s: float = 0.0, patience_s: float = 0.5) -> None:
        self.clock_hz = clock_hz
        self.time_offset_s = time_offset_s
        self.patience_s = patience_s
        self._edges = Edges.none()
        self._waiting: deque[_Waiting] = deque()
        self._known = 0  # of those waiting, from the first: two edges after them are there
        self._latches: list[Latched] = []
        self._last_frame: Frame | None = None
        self._last_count = 0

    def push(self, frame: Frame, *, more: bool = False) -> list[tuple[Frame, RowAngles]]:
        """Take the next frame; give those whose angles are known now, in order.

        With ``more`` the next one is there already: up to ``TOGETHER`` are kept to be done at once, with the same
        angles.
        """
        before, count_before = self._last_frame, self._last_count
        if before is None:
            self._last_count = frame.header["last_count"]
        else:
            self._last_count += wrapped_difference(frame.header["last_count"], before.header["last_count"])
        follows = before is not None and frame.number == before.number + 1
        shift = before.header["edge_shift"] if before is not None else 0
        self._edges += edges_of_frame(
            frame,
            self._last_count,
            follows=follows,
            shift_before=shift,
            count_before=None if before is None else count_before,
        )
        self._last_frame = frame
        self._latches += latches(frame, self._last_count)
        offset = round((self.time_offset_s + frame.header["time_offset_ns"] * 1e-9) * self.clock_hz)
        self._waiting.append(_Waiting(frame, self._last_count, offset))
        ready = []
        while self._known < len(self._waiting):
            if self._two_edges_after(self._waiting[self._known]):
                self._known += 1
            elif frame.header["last_time"] - self._waiting[self._known].last > self.patience_s * self.clock_hz:
                ready += self._release(self._known) + self._release(1)
            else:
                break
        if not more or self._known >= TOGETHER:
            ready += self._release(self._known)
        return ready

    def flush(self) -> list[tuple[Frame, RowAngles]]:
        """The frames held back, by what is known: nothing more will come."""
        ready = self._release(self._known)
        while self._waiting:
            ready += self._release(1)
        return ready

    def _two_edges_after(self, item: _Waiting) -> bool:
        return len(self._edges) >= 2 and bool(self._edges.time[-2] > item.last)

    def _release(self, count: int) -> list[tuple[Frame, RowAngles]]:
        """The first ones waiting."""
        items = [self._waiting.popleft() for _ in range(count)]
        self._known = max(self._known - count, 0)
        # Row times ascend over all of them only where their offset is the same.
        return [pair for _, some in groupby(items, lambda item: item.offset) for pair in self._angles(list(some))]

    def _angles(self, items: list[_Waiting]) -> list[tuple[Frame, RowAngles]]:
        first = items[0]
        start = int(np.searchsorted(self._edges.time, min(first.first, first.frame.header["first_time"])))
        self._edges = self._edges[max(start - _HISTORY, 0) :]
        self._latches = [latch for latch in self._latches if latch.end >= first.first]
        origin = first.first
        times = joined([item.frame.row_times + (item.first - origin) for item in items])
        if len(self._edges):
            assert self._last_frame is not None
            quiet = self._last_frame.header["last_time"]
            position, standing = interpolate(self._edges, times, origin, quiet, self._latches)
        else:
            position, standing = np.empty(len(times)), np.ones(len(times), bool)
        found, end = [], 0
        for item in items:
            header = item.frame.header
            rows = slice(end, end := end + len(item.frame.rows))
            if not len(self._edges):
                position[rows] = item.last_count + wrapped_difference(header["first_count"], header["last_count"]) + 0.5
            position[rows] -= item.last_count + wrapped_difference(header["index_count"], header["last_count"])
            found.append((item.frame, RowAngles(position[rows], standing[rows])))
        return found


def bare_angles(frame: Frame) -> RowAngles:
    """One bare count for the whole image, as a card without edge log would have: the paper's way, to compare with."""
    header = frame.header
    counts = wrapped_difference(header["first_count"], header["index_count"])
    rows = len(frame.rows)
    return RowAngles(np.full(rows, float(counts)), np.zeros(rows, bool))
