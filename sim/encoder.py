"""Incremental encoder and index barrier: when their outputs change.

Both are marks on a turning disc. Moving over a mark changes one output, at the same angle in both
directions, so one algorithm finds the times of all.

Angle 0 is the encoder line that the index names. Count k spans the angles [k, k + 1) counts; A leads B
while the angle grows: (A, B) is 00, 10, 11, 01 for k % 4 = 0, 1, 2, 3. The barrier is high from
half a count after the zero line on.
"""

import enum
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, pi
from typing import NamedTuple

import numpy as np

from .trajectory import Segment


class Signal(enum.IntEnum):
    """An output that can change."""

    A = 0
    B = 1
    INDEX = 2


class Event(NamedTuple):
    """``signal`` becomes ``level`` at ``time_s``."""

    time_s: float
    signal: Signal
    level: int


class Disc(ABC):
    """Marks on a disc, numbered along the angle; mark n separates zone n - 1 from zone n.

    Parameters
    ----------
    angle_rad : where the disc stands
    """

    def __init__(self, angle_rad: float) -> None:
        self.zone = self._zone(angle_rad)

    @abstractmethod
    def _mark(self, number: int) -> float:
        """Angle of a mark, in radians; increases with its number."""

    @abstractmethod
    def _zone(self, angle_rad: float) -> int:
        """Number of the zone that holds an angle; a mark belongs to the zone above."""

    @abstractmethod
    def _change(self, time_s: float, old: int, new: int) -> Event:
        """What changes between two neighbouring zones."""

    def follow(self, segments: Sequence[Segment]) -> list[Event]:
        """Events of a movement that goes on from where the last one ended."""
        events = []
        for segment in segments:
            for low, high in segment.monotone():
                end = segment.at(high)
                length = segment.end_s - segment.start_s
                while True:
                    if end >= self._mark(self.zone + 1):
                        mark, new = self._mark(self.zone + 1), self.zone + 1
                    elif end < self._mark(self.zone):
                        mark, new = self._mark(self.zone), self.zone - 1
                    else:
                        break
                    time_s = segment.start_s + length * segment.solve(mark, low, high)
                    events.append(self._change(time_s, self.zone, new))
                    self.zone = new
        return events


@dataclass(frozen=True)
class Flaws:
    """What an encoder has that an ideal one has not.

    Parameters
    ----------
    line_error_counts : RMS by which each edge lies off its place on the disc, the same in every turn
    jitter_s : RMS by which each edge comes early or late
    seed : of both
    """

    line_error_counts: float = 0.0
    jitter_s: float = 0.0
    seed: int = 0


class Encoder(Disc):
    """A and B of an encoder.

    Parameters
    ----------
    counts_per_turn : edges of A and B in a turn; divisible by 4
    angle_rad : where it stands
    flaws : none by default
    """

    def __init__(self, counts_per_turn: int, angle_rad: float, flaws: Flaws | None = None) -> None:
        flaws = flaws or Flaws()
        if counts_per_turn < 4 or counts_per_turn % 4:
            raise ValueError(f"the counts of a turn have to be a positive multiple of 4, not {counts_per_turn}")
        self.counts_per_turn = counts_per_turn
        self._pitch = 2 * pi / counts_per_turn
        self._rng = np.random.default_rng(flaws.seed)
        self._jitter_s = flaws.jitter_s
        # Marks stay in order: no displacement reaches half a count.
        errors = flaws.line_error_counts * self._rng.standard_normal(counts_per_turn)
        self.line_errors_counts = np.clip(errors, -0.45, 0.45)
        super().__init__(angle_rad)

    @property
    def count(self) -> int:
        """The count that a decoder without errors has, from the zero line."""
        return self.zone

    def levels(self) -> dict[Signal, int]:
        """Levels of A and B."""
        return {signal: self._level(signal, self.zone) for signal in (Signal.A, Signal.B)}

    @staticmethod
    def _level(signal: Signal, count: int) -> int:
        return int(count % 4 in ((1, 2) if signal is Signal.A else (2, 3)))

    def follow(self, segments: Sequence[Segment]) -> list[Event]:
        """As for any disc, with jitter; within the time of the segments and in the order of the edges."""
        events = super().follow(segments)
        if not self._jitter_s or not events:
            return events
        start, end = segments[0].start_s, segments[-1].end_s
        times = np.array([event.time_s for event in events])
        times += self._jitter_s * self._rng.standard_normal(len(times))
        times = np.maximum.accumulate(np.clip(times, start, end))
        return [event._replace(time_s=float(time_s)) for event, time_s in zip(events, times, strict=True)]

    def _mark(self, number: int) -> float:
        return (number + float(self.line_errors_counts[number % self.counts_per_turn])) * self._pitch

    def _zone(self, angle_rad: float) -> int:
        zone = floor(angle_rad / self._pitch)
        return zone + 1 if angle_rad >= self._mark(zone + 1) else zone - 1 if angle_rad < self._mark(zone) else zone

    def _change(self, time_s: float, old: int, new: int) -> Event:
        # Of two neighbouring counts, A changes at odd marks and B at even ones.
        signal = Signal.A if max(old, new) % 2 else Signal.B
        return Event(time_s, signal, self._level(signal, new))


class IndexBarrier(Disc):
    """A light barrier that is high once a turn.

    Parameters
    ----------
    counts_per_turn : of the encoder
    width_counts : how long it is high; a whole number keeps both its edges clear of the encoder's
    angle_rad : where it stands
    """

    def __init__(self, counts_per_turn: int, width_counts: int, angle_rad: float) -> None:
        if not 1 <= width_counts < counts_per_turn:
            raise ValueError(f"the index is high for 1 to {counts_per_turn - 1} counts, not {width_counts}")
        pitch = 2 * pi / counts_per_turn
        self._rise, self._width = 0.5 * pitch, width_counts * pitch
        super().__init__(angle_rad)

    def levels(self) -> dict[Signal, int]:
        """Level of the index."""
        return {Signal.INDEX: self._level(self.zone)}

    @staticmethod
    def _level(zone: int) -> int:
        return int(zone % 2 == 0)

    def _mark(self, number: int) -> float:
        return self._rise + 2 * pi * (number // 2) + (self._width if number % 2 else 0.0)

    def _zone(self, angle_rad: float) -> int:
        turn, rest = divmod(angle_rad - self._rise, 2 * pi)
        return 2 * floor(turn) + int(rest >= self._width)

    def _change(self, time_s: float, old: int, new: int) -> Event:
        return Event(time_s, Signal.INDEX, self._level(new))
