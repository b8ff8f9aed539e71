"""A movement given in advance: the angle at the first and the last row of every picture."""

import csv
from dataclasses import dataclass
from math import isfinite, pi, radians
from pathlib import Path

import numpy as np

from .errors import SimError
from .motor import INDEX_WIDTH_COUNTS, Drive
from .timing import Timing
from .trajectory import Segment

HEADER = ["frame", "angle_start_deg", "angle_end_deg"]

START_COUNTS = -7.5
"""Where the motor stands before it is started: a little before the index mark, in counts."""


@dataclass(frozen=True)
class Angles:
    """Angles of the motor at row 0 and at the last row of each picture, in radians from the index mark."""

    start_rad: tuple[float, ...]
    end_rad: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.start_rad)


def read_angles(path: Path, frames: int) -> Angles:
    """Read a CSV file with the header ``frame,angle_start_deg,angle_end_deg``.

    Lines may stand in any order; each frame from 0 to ``frames`` - 1 needs one.

    Raises
    ------
    SimError : the file can't be read, or a line is wrong, missing or doubled; names it
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SimError(f"the angles {path} can't be read: {error}") from error
    if not lines or [name.strip() for name in lines[0]] != HEADER:
        found = ",".join(lines[0]) if lines else "nothing"
        raise SimError(f"{path} line 1: the header has to be {','.join(HEADER)}, not {found}")
    found_at: dict[int, int] = {}
    start, end = [0.0] * frames, [0.0] * frames
    for number, line in enumerate(lines[1:], 2):
        if not any(cell.strip() for cell in line):
            continue
        where = f"{path} line {number}"
        if len(line) != len(HEADER):
            raise SimError(f"{where}: {len(HEADER)} values are needed, not {len(line)}")
        try:
            frame = int(line[0])
        except ValueError:
            raise SimError(f"{where}: the frame has to be a whole number, not {line[0]!r}") from None
        if not 0 <= frame < frames:
            raise SimError(f"{where}: there is no picture for frame {frame}; the pictures are 0 to {frames - 1}")
        if frame in found_at:
            raise SimError(f"{where}: frame {frame} is given again; it stands already in line {found_at[frame]}")
        found_at[frame] = number
        start[frame] = _degrees(where, HEADER[1], line[1])
        end[frame] = _degrees(where, HEADER[2], line[2])
    missing = [frame for frame in range(frames) if frame not in found_at]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise SimError(f"{path}: frame {missing[0]}{more} is missing; each of the {frames} pictures needs a line")
    return Angles(tuple(start), tuple(end))


def _degrees(where: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise SimError(f"{where}: {name} has to be a number of degrees, not {text!r}")
    return radians(value)


class Playback(Drive):
    """A motor that is where it has to be at every picture, whatever the PWM.

    It stands just before the index mark until :meth:`start`; crosses the mark; travels at a bounded rate to
    where it can reach picture 0 within one frame period at that picture's speed; follows the given angles
    (straight lines between them); runs on for one period at the last picture's speed; and stands.

    Parameters
    ----------
    angles : of the pictures
    timing : of the pictures
    counts_per_turn : of the encoder
    edge_rate_hz : encoder edges per second on the way to picture 0; faster pictures are refused

    Raises
    ------
    SimError : a picture turns faster than ``edge_rate_hz``
    """

    def __init__(
        self,
        angles: Angles,
        timing: Timing,
        counts_per_turn: int,
        edge_rate_hz: float,
        index_width_counts: int = INDEX_WIDTH_COUNTS,
    ) -> None:
        if not len(angles):
            raise ValueError("there is no picture to play back")
        self.angles = angles
        self.timing = timing
        self._pitch = 2 * pi / counts_per_turn
        self._rate_rad_s = edge_rate_hz * self._pitch
        super().__init__(START_COUNTS * self._pitch, counts_per_turn, index_width_counts)
        self._plan: list[Segment] = []
        # Relative to the arrival of row 0 of picture 0.
        row_0 = np.arange(len(angles)) * timing.period_s
        times = np.stack([row_0, row_0 + (timing.height - 1) * timing.row_period_s], axis=1).ravel()
        values = np.stack([angles.start_rad, angles.end_rad], axis=1).ravel()
        if timing.height == 1:
            times, values = times[::2], values[::2]
        first_speed = self._speed(times, values, 0)
        last_speed = self._speed(times, values, -1)
        self._times = np.concatenate([[-timing.period_s], times, [times[-1] + timing.period_s]])
        self._angles = np.concatenate(
            [
                [values[0] - first_speed * timing.period_s],
                values,
                [values[-1] + last_speed * timing.period_s],
            ]
        )
        fastest = np.max(np.abs(np.diff(self._angles) / np.diff(self._times)))
        if fastest > self._rate_rad_s * (1 + 1e-9):
            raise SimError(
                f"the angles turn at up to {fastest / self._pitch:.0f} encoder counts a second, and this card takes "
                f"{edge_rate_hz:.0f}; take a lower frame rate or fewer counts per turn"
            )

    @staticmethod
    def _speed(times: np.ndarray, values: np.ndarray, picture: int) -> float:
        """Speed of the first (0) or last (-1) picture; 0 where one row alone gives none."""
        if len(times) < 2:
            return 0.0
        step = np.diff(values) / np.diff(times)
        return float(step[picture])

    @property
    def preroll_s(self) -> float:
        """Time that it needs from a start now to row 0 of picture 0."""
        return sum(length for length, _ in self._approach()) + self.timing.period_s

    def _approach(self) -> list[tuple[float, float]]:
        """(duration, target) of the way to where picture 0 can be reached from."""
        at = self.trajectory.angle_rad
        way = []
        # Past the mark first, always upward and far enough for the barrier to settle.
        targets = [-START_COUNTS * self._pitch] if at <= 0 else []
        for target in [*targets, float(self._angles[0])]:
            if target != at:
                way.append((abs(target - at) / self._rate_rad_s, target))
                at = target
        return way

    def start(self, at_s: float | None = None) -> float:
        """Set off (again) at ``at_s``, by default now; the time at which row 0 of picture 0 arrives."""
        now = self.time_s if at_s is None else max(at_s, self.time_s)
        at = self.trajectory.angle_rad
        plan = []
        for length, target in self._approach():
            plan.append(Segment.line(now, now + length, at, target))
            now, at = now + length, target
        begin = now + self.timing.period_s
        times = begin + self._times
        for i in range(len(times) - 1):
            start = now if i == 0 else float(times[i])
            plan.append(Segment.line(start, float(times[i + 1]), float(self._angles[i]), float(self._angles[i + 1])))
        self._plan = plan[::-1]
        return begin

    def _move(self, until_s: float, duty: float) -> list[Segment]:
        segments: list[Segment] = []
        now, at = self.time_s, self.trajectory.angle_rad
        while now < until_s:
            if not self._plan:
                segments.append(Segment.line(now, until_s, at, at))
                break
            line = self._plan[-1]
            if line.start_s > now:
                piece = Segment.line(now, min(until_s, line.start_s), at, at)
            else:
                end = min(until_s, line.end_s)
                angle = line.at((end - line.start_s) / (line.end_s - line.start_s))
                piece = Segment.line(now, end, at, angle)
            segments.append(piece)
            now, at = piece.end_s, piece.at(1.0)
            if now >= line.end_s:
                self._plan.pop()
        return segments


def steady(frames: int, start_rad: float, end_rad: float, timing: Timing) -> Angles:
    """Angles of a movement at constant speed from the first row of all to the last."""
    row_0 = np.arange(frames) * timing.period_s
    length = (timing.height - 1) * timing.row_period_s
    speed = (end_rad - start_rad) / max(row_0[-1] + length, 1e-12)
    return Angles(tuple((start_rad + speed * row_0).tolist()), tuple((start_rad + speed * (row_0 + length)).tolist()))
