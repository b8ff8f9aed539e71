"""The encoder's position at the time of each row.

A bare count is off by up to a whole one. The card logs when edges came; :mod:`magtrak.curve` tells what lies between.
"""

from collections import deque
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np

from .arrays import Booleans, Floats, joined
from .curve import Curve, Latched
from .edges import SAME_EDGE_CLOCKS, edges_of_frame, wrapped_difference
from .frames import Frame

TOGETHER = 8
"""Frames whose angles and points are computed together where they wait."""


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


def latches(frame: Frame, last_count: int) -> tuple[Latched, Latched]:
    """The latches of a frame at its first and last row; ``last_count`` is its own, unwrapped over the stream."""
    header = frame.header
    first_count = last_count + wrapped_difference(header["first_count"], header["last_count"])
    first, last = header["first_time"], header["last_time"]
    return (
        Latched(first - header["first_age"] + SAME_EDGE_CLOCKS, first, first_count),
        Latched(last - header["last_age"] + SAME_EDGE_CLOCKS, last, last_count),
    )


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
        self._curve = Curve()
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
        self._curve.extend(
            edges_of_frame(
                frame,
                self._last_count,
                follows=follows,
                shift_before=shift,
                count_before=None if before is None else count_before,
            )
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
        edges = self._curve.edges
        return len(edges) >= 2 and edges[-2].time > item.last

    def _release(self, count: int) -> list[tuple[Frame, RowAngles]]:
        """The first ones waiting."""
        items = [self._waiting.popleft() for _ in range(count)]
        self._known = max(self._known - count, 0)
        # Row times ascend over all of them only where their offset is the same.
        return [pair for _, some in groupby(items, lambda item: item.offset) for pair in self._angles(list(some))]

    def _angles(self, items: list[_Waiting]) -> list[tuple[Frame, RowAngles]]:
        first = items[0]
        self._curve.forget(min(first.first, first.frame.header["first_time"]))
        self._latches = [latch for latch in self._latches if latch.end >= first.first]
        origin = first.first
        times = joined([first.frame.row_times] + [item.frame.row_times + (item.first - origin) for item in items[1:]])
        assert self._last_frame is not None
        if self._curve.edges:
            quiet = self._last_frame.header["last_time"]
            position, standing = self._curve.at(times, origin, quiet, self._latches)
        else:
            position, standing = np.empty(len(times)), np.ones(len(times), bool)
        found, end = [], 0
        for item in items:
            header, last_count = item.frame.header, item.frame.header["last_count"]
            rows = slice(end, end := end + len(item.frame.rows))
            if not self._curve.edges:
                position[rows] = item.last_count + wrapped_difference(header["first_count"], last_count) + 0.5
            position[rows] -= item.last_count + wrapped_difference(header["index_count"], last_count)
            found.append((item.frame, RowAngles(position[rows], standing[rows])))
        return found


def bare_angles(frame: Frame) -> RowAngles:
    """One bare count for the whole image, as a card without edge log would have: the paper's way, to compare with."""
    header = frame.header
    counts = wrapped_difference(header["first_count"], header["index_count"])
    rows = len(frame.rows)
    return RowAngles(np.full(rows, float(counts)), np.zeros(rows, bool))
