"""The motor's angle as a function of time: a chain of cubics."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Segment:
    """``angle(t) = c[0] + c[1] s + c[2] s^2 + c[3] s^3`` with s from 0 at ``start_s`` to 1 at ``end_s``; radians."""

    start_s: float
    end_s: float
    c: tuple[float, float, float, float]

    @classmethod
    def line(cls, start_s: float, end_s: float, start_rad: float, end_rad: float) -> "Segment":
        """Constant speed."""
        return cls(start_s, end_s, (start_rad, end_rad - start_rad, 0.0, 0.0))

    @classmethod
    def hermite(
        cls, start_s: float, end_s: float, start_rad: float, end_rad: float, start_rad_s: float, end_rad_s: float
    ) -> "Segment":
        """The cubic with these angles and speeds at its ends."""
        length = end_s - start_s
        rise, v0, v1 = end_rad - start_rad, start_rad_s * length, end_rad_s * length
        return cls(start_s, end_s, (start_rad, v0, 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise))

    def at(self, s: float) -> float:
        """Angle at the part ``s`` of the segment."""
        c = self.c
        return c[0] + s * (c[1] + s * (c[2] + s * c[3]))

    def monotone(self) -> list[tuple[float, float]]:
        """Pieces (as parts of the segment, in order) in which the angle turns one way."""
        _, b, c, d = self.c
        if c == 0 and d == 0:
            return [(0.0, 1.0)]
        turns = [0.0, 1.0]
        # Roots of b + 2 c s + 3 d s^2, in the form that does not cancel.
        square = c * c - 3 * d * b
        if square > 0:
            q = -(c + (square**0.5 if c >= 0 else -(square**0.5)))
            turns += [s for s in ([q / (3 * d)] if d else []) + ([b / q] if q else []) if 0 < s < 1]
        turns.sort()
        return [(low, high) for low, high in pairwise(turns) if high > low]

    def solve(self, angle_rad: float, low: float, high: float) -> float:
        """The part of the segment at which the angle is met, within a monotone piece that contains it."""
        c0, c1, c2, c3 = self.c
        if c2 == 0 and c3 == 0:
            return min(max((angle_rad - c0) / c1, low), high)
        rising = self.at(high) >= self.at(low)
        s = 0.5 * (low + high)
        for _ in range(80):
            error = c0 - angle_rad + s * (c1 + s * (c2 + s * c3))
            if (error > 0) == rising:
                high = s
            else:
                low = s
            slope = c1 + s * (2 * c2 + s * 3 * c3)
            step = s - error / slope if slope else low
            # Newton where it stays inside, else bisection: sure to end, and quick.
            new = step if low < step < high else 0.5 * (low + high)
            if abs(new - s) < 1e-14:
                break
            s = new
        return s


class Trajectory:
    """What is known of the angle so far.

    Parameters
    ----------
    start_s, angle_rad : where the motor has stood until now
    history_s : how far back angles can be asked for, from the newest on
    """

    def __init__(self, start_s: float, angle_rad: float, history_s: float = float("inf")) -> None:
        self._history_s = history_s
        self._forgot = False
        self._rows = np.empty((1024, 7))  # start, end, 1 / length, c[0] ... c[3]
        self._count = 0
        self._last = Segment.line(start_s - 1.0, start_s, angle_rad, angle_rad)
        self.extend([self._last])

    @property
    def end_s(self) -> float:
        """Time up to which the angle is known."""
        return self._last.end_s

    @property
    def angle_rad(self) -> float:
        """Angle at :attr:`end_s`."""
        return self._last.at(1.0)

    def extend(self, segments: Sequence[Segment]) -> None:
        """Append segments that follow one another without a gap."""
        for segment in segments:
            if self._count == len(self._rows):
                self._make_room()
            length = segment.end_s - segment.start_s
            self._rows[self._count] = (segment.start_s, segment.end_s, 1 / length, *segment.c)
            self._count += 1
            self._last = segment

    def _make_room(self) -> None:
        """Forget what is older than the history; take more memory where that is less than half."""
        old = int(np.searchsorted(self._rows[:, 1], self.end_s - self._history_s))
        self._forgot |= old > 0
        kept = self._rows[old:]
        rows = np.empty((max(len(self._rows), 2 * len(kept)), 7))
        rows[: len(kept)] = kept
        self._rows, self._count = rows, len(kept)

    def at(self, times_s: npt.ArrayLike) -> Floats:
        """Angles at times. Before the start the motor stood; what is forgotten or still to come is a
        :exc:`ValueError`.
        """
        t = np.asarray(times_s, dtype=np.float64)
        starts = self._rows[: self._count, 0]
        if t.size and t.max() > self.end_s + 1e-9:
            raise ValueError(f"the angle is known until {self.end_s:.9f} s, not at {t.max():.9f} s")
        if self._forgot and t.size and t.min() < starts[0]:
            raise ValueError(f"the angle before {starts[0]:.9f} s is forgotten; {t.min():.9f} s was asked for")
        which = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, None)
        start, _, scale, c0, c1, c2, c3 = np.moveaxis(self._rows[which], -1, 0)
        s = np.clip((t - start) * scale, 0.0, 1.0)
        return np.asarray(c0 + s * (c1 + s * (c2 + s * c3)))
