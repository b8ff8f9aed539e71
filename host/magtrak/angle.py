"""The encoder's position at the time of each row.

A bare count is off by up to a whole one. The card logs when edges came, and an edge lies at a whole count: the position
between edges follows from a smooth curve through those before and after. The curve is a cubic between each two edges;
its slope at an edge is that of the parabola through the edge and its neighbours. So it is exact at constant speed and
at constant acceleration, reversals included (an edge passed twice lies at the same place both times), and it never
leaves the count that the encoder shows.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .arrays import Booleans, Floats
from .edges import SAME_EDGE_CLOCKS, Edges, edges_of_frame, wrapped_difference
from .frames import Frame

# An interval so many times as long as both its neighbours is a stop, not slow motion: turning round at constant
# acceleration makes a ratio of at most 4.9.
STANDSTILL_RATIO = 8.0

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


@dataclass(frozen=True)
class Latched:
    """What a latch tells: no edge came from ``start`` to ``end`` (clocks since reset), and the count was ``count``."""

    start: int
    end: int
    count: int


def latches(frame: Frame, last_count: int) -> list[Latched]:
    """The latches of a frame at its first and last row; ``last_count`` is its own, unwrapped over the stream."""
    header = frame.header
    first_count = last_count + wrapped_difference(header["first_count"], header["last_count"])
    return [
        Latched(header[f"{row}_time"] - header[f"{row}_age"] + SAME_EDGE_CLOCKS, header[f"{row}_time"], count)
        for row, count in (("first", first_count), ("last", last_count))
    ]


def interpolate(
    edges: Edges, times: Floats, origin: int, quiet_until: int, known: Sequence[Latched] = ()
) -> tuple[Floats, Booleans]:
    """Positions in counts, and where the encoder stood still, at ``times`` (clocks after ``origin``).

    Before the first and after the last edge the outermost parabola goes on, within the count. Needs an edge.

    Parameters
    ----------
    edges : all that are known around the times
    times : clocks after ``origin``, ascending
    origin : clocks since reset
    quiet_until : clocks since reset until which no edge came after the last one
    known : where latches tell the count, which edges may not: a log that was thinned leaves out its last ones
    """
    t = (edges.time - origin).astype(np.float64)
    p = edges.position.astype(np.float64)
    # Interval i lies before edge i; the first and the last are open. How many rows are in each:
    bounds = np.concatenate([[0], np.searchsorted(times, t), [len(times)]])
    rows = bounds[1:] - bounds[:-1]
    # What the encoder showed in each interval, and how far unlogged edges may have led away from it.
    shown = np.append(edges.before[:1], edges.count).astype(np.float64)
    away = np.append(edges.unlogged, edges.unlogged[-1:]).astype(np.float64)
    away[away < 0] = np.inf
    curves = _curves(t, p) if len(edges) > 1 else np.stack([np.append(t, t), shown + 0.5, *np.zeros((3, 2))])
    still = _standing(t, times, quiet_until - origin) if len(edges) > 1 else np.ones(2, bool)
    table = np.vstack([curves, shown - away, shown + 1 + away])
    # Each row takes its interval's numbers in one go: there are some twenty intervals and a thousand rows.
    begin, c0, c1, c2, c3, low, high = table.repeat(rows, axis=1)
    x = times - begin
    position = c0 + x * (c1 + x * (c2 + x * c3))
    if len(known):
        starts = np.searchsorted(times, [latch.start - origin for latch in known])
        ends = np.searchsorted(times, [latch.end - origin for latch in known], side="right")
        for latch, start, end in zip(known, starts, ends, strict=True):
            low[start:end] = latch.count
            high[start:end] = latch.count + 1
    np.maximum(position, low, out=position)
    np.minimum(position, high, out=position)
    standing = still.repeat(rows)
    if len(edges) > 1 and rows[0]:
        early = times[: rows[0]]
        standing[: rows[0]] |= t[0] - early > STANDSTILL_RATIO * (t[1] - t[0])
    if standing.any():
        sure = standing & (high - low == 1)
        position[sure] = low[sure] + 0.5
        if len(edges) > 1:
            standing = sure
    return position, standing


def _curves(t: Floats, p: Floats) -> Floats:
    """For each interval, the open ones included: where it begins, and the coefficients of its polynomial from there."""
    h = t[1:] - t[:-1]
    s = (p[1:] - p[:-1]) / h
    slope, bend = _derivatives(h, s)
    begin, c0, c1, c2, c3 = curves = np.zeros((5, len(t) + 1))
    begin[0], begin[1:] = t[0], t
    c0[0], c0[1:] = p[0], p
    c1[0], c1[1:] = slope[0], slope
    # Hermite's cubic between two edges; the outermost parabolas go on.
    c2[0], c2[1:-1], c2[-1] = bend[0] / 2, (3 * s - 2 * slope[:-1] - slope[1:]) / h, bend[-1] / 2
    c3[1:-1] = (slope[:-1] + slope[1:] - 2 * s) / (h * h)
    return curves


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
    if h.max() > STANDSTILL_RATIO * h.min():
        longer_neighbour = np.maximum(np.concatenate([[0.0], h[:-1]]), np.concatenate([h[1:], [0.0]]))
        still[1:-1] = (h > STANDSTILL_RATIO * longer_neighbour) & (longer_neighbour > 0)
    latest = max(quiet_until, float(times[-1]) if len(times) else 0.0)
    still[-1] = latest - t[-1] > STANDSTILL_RATIO * h[-1]
    return still


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
        self._waiting: deque[tuple[Frame, int]] = deque()
        self._last_frame: Frame | None = None
        self._last_count = 0

    def push(self, frame: Frame) -> list[tuple[Frame, RowAngles]]:
        """Take the next frame; give those whose angles are known now, in order."""
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
        self._waiting.append((frame, self._last_count))
        ready = []
        while self._waiting and self._is_ready():
            ready.append(self._release())
        return ready

    def flush(self) -> list[tuple[Frame, RowAngles]]:
        """The frames held back, by what is known: nothing more will come."""
        return [self._release() for _ in range(len(self._waiting))]

    def _offset_clocks(self, frame: Frame) -> float:
        return (self.time_offset_s + frame.header["time_offset_ns"] * 1e-9) * self.clock_hz

    def _is_ready(self) -> bool:
        frame = self._waiting[0][0]
        end = frame.header["last_time"] + self._offset_clocks(frame)
        newest = self._waiting[-1][0].header["last_time"]
        two_after = len(self._edges) >= 2 and bool(self._edges.time[-2] > end)
        return two_after or newest - end > self.patience_s * self.clock_hz

    def _release(self) -> tuple[Frame, RowAngles]:
        frame, last_count = self._waiting.popleft()
        header = frame.header
        offset = self._offset_clocks(frame)
        start = int(np.searchsorted(self._edges.time, header["first_time"] + min(offset, 0.0)))
        self._edges = self._edges[max(start - _HISTORY, 0) :]
        times = frame.row_times() + offset
        if len(self._edges):
            newest = self._waiting[-1][0] if self._waiting else frame
            known = [latch for item in [(frame, last_count), *self._waiting] for latch in latches(*item)]
            position, standing = interpolate(
                self._edges, times, header["first_time"], newest.header["last_time"], known
            )
        else:
            first = last_count + wrapped_difference(header["first_count"], header["last_count"])
            position, standing = np.full(len(times), first + 0.5), np.ones(len(times), bool)
        index = last_count + wrapped_difference(header["index_count"], header["last_count"])
        return frame, RowAngles(position - index, standing)


def bare_angles(frame: Frame) -> RowAngles:
    """One bare count for the whole image, as a card without edge log would have: the paper's way, to compare with."""
    header = frame.header
    counts = wrapped_difference(header["first_count"], header["index_count"])
    rows = len(frame.rows.row)
    return RowAngles(np.full(rows, float(counts)), np.zeros(rows, bool))
