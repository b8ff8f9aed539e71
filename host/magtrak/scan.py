"""From frames to a cloud: angles, rays, planes, points, and the count of everything that gave none."""

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from .angle import TOGETHER, AngleTracker, RowAngles, bare_angles
from .arrays import Booleans, Records, joined
from .calibration import Calibration
from .cloud.points import POINT
from .errors import CalibrationError, CardResetError
from .frames import Frame
from .locate import locator
from .protocol import Phase
from .rows import Rows
from .triangulate import MIN_SINE


@dataclass
class Counts:
    """What became of the frames and rows so far.

    Attributes
    ----------
    frames : received
    lost_frames : images between the first and the last received that did not arrive
    dropped_frames : those of them that the card dropped because no buffer was free
    unreferenced_frames : without points because the index had not been passed
    dark_frames : taken without the laser, or while it was switched, to subtract the room's light
    unsubtracted_frames : without points because no background had been taken yet
    points : in the cloud
    parallel, behind : rows whose ray is parallel to the laser plane, or meets it behind the camera
    poor : rows below the least quality asked for
    restarts : times that the scan went on after the card was away
    standing : points whose angle is the middle of a count, because the encoder stood still
    encoder_errors : that the card counted since the first frame
    """

    frames: int = 0
    lost_frames: int = 0
    dropped_frames: int = 0
    unreferenced_frames: int = 0
    dark_frames: int = 0
    unsubtracted_frames: int = 0
    points: int = 0
    parallel: int = 0
    behind: int = 0
    poor: int = 0
    standing: int = 0
    restarts: int = 0
    encoder_errors: int = 0


_BLOCK = 1 << 18
"""Points whose memory is taken at once: some megabytes come in large pages, and most of the time that it takes to get
memory page by page is saved."""


class Scan:
    """Turns the frames of one run of a card into points.

    Parameters
    ----------
    calibration : of camera and laser
    clock_hz : the card's clock
    bare : one bare count for each image instead of an angle for each row
    min_quality : points of less quality are left out
    min_sine : see :func:`magtrak.triangulate.triangulate`

    Attributes
    ----------
    counts : see :class:`Counts`
    chunks : points so far, an array of ``POINT`` for a frame or some; begins with an empty one
    """

    def __init__(
        self,
        calibration: Calibration,
        clock_hz: float,
        *,
        bare: bool = False,
        min_quality: float = 0.0,
        min_sine: float = MIN_SINE,
    ) -> None:
        self.calibration = calibration
        self.clock_hz = clock_hz
        self.bare = bare
        self.min_quality = min_quality
        self.counts = Counts()
        self.chunks: list[Records] = [np.zeros(0, POINT)]
        self._locator = locator(calibration, min_sine)
        self._tracker = AngleTracker(clock_hz, calibration.camera.time_offset_s)
        self._ready: list[tuple[Frame, RowAngles]] = []
        self._room = np.empty(0, POINT)
        self._encoder_errors_before = 0
        # Of the first frame after a restart: what the points of the frame have.
        self._frame_base, self._time_base_s = 0, 0.0
        self._first: Frame | None = None
        self._last: Frame | None = None

    def push(self, frame: Frame, *, more: bool = False) -> None:
        """Take the next frame. Its points come a few frames later.

        With ``more`` the next frame is waiting already: points of some frames may be computed together, which takes
        half the time and gives the same points.

        Raises
        ------
        CalibrationError
            The picture is not of the calibration's size.
        CardResetError
            The card was reset since the frame before.
        """
        self._check(frame)
        header = frame.header
        if self._first is None:
            self._first = frame
        if self._last is not None:
            # Frame numbers and counters wrap at 32 bits.
            self.counts.lost_frames += (frame.number - self._last.number - 1) & 0xFFFF_FFFF
            self.counts.dropped_frames += (header["dropped"] - self._last.header["dropped"]) & 0xFFFF_FFFF
        self._last = frame
        self.counts.frames += 1
        errors = max(frame.encoder_errors - self._first.encoder_errors, 0)
        self.counts.encoder_errors = self._encoder_errors_before + errors
        self._ready += [(frame, bare_angles(frame))] if self.bare else self._tracker.push(frame, more=more)
        if not more or len(self._ready) >= TOGETHER:
            self._settle()

    def restart(self, after_s: float) -> None:
        """The card was away and may have been reset: its next frame comes ``after_s`` after the last one."""
        self.finish()
        self._tracker = AngleTracker(self.clock_hz, self.calibration.camera.time_offset_s)
        self._encoder_errors_before = self.counts.encoder_errors
        if self._first is not None and self._last is not None:
            self._frame_base = self._number(self._last) + 1
            self._time_base_s = self._seconds(self._last) + after_s
            self.counts.restarts += 1
        self._first = self._last = None

    def finish(self) -> None:
        """No more frames will come: use those held back."""
        self._ready += self._tracker.flush()
        self._settle()

    def cloud(self) -> Records:
        """All points so far."""
        return np.concatenate(self.chunks)

    def _number(self, frame: Frame) -> int:
        """Number of a frame in the scan."""
        assert self._first is not None
        return self._frame_base + ((frame.number - self._first.number) & 0xFFFF_FFFF)

    def _seconds(self, frame: Frame) -> float:
        """Time of the frame's first row in the scan."""
        assert self._first is not None
        clocks: int = frame.header["first_time"] - self._first.header["first_time"]
        return self._time_base_s + clocks / self.clock_hz

    def _check(self, frame: Frame) -> None:
        camera = self.calibration.camera
        header = frame.header
        last_row = header["first_row"] + (header["rows"] - 1) * header["row_step"]
        if header["columns"] != camera.width or last_row >= camera.height:
            raise CalibrationError(
                f"the calibration is for pictures of {camera.width} x {camera.height}, the card sends"
                f" {header['columns']} columns and rows up to {last_row}:"
                " use the calibration of this camera"
            )
        if self._last is not None and header["first_time"] <= self._last.header["first_time"]:
            raise CardResetError("the card was reset during the scan: check its power, then start again")

    def _settle(self) -> None:
        """Points of the frames whose angles are known."""
        measured = [(frame, angles) for frame, angles in self._ready if self._is_measured(frame)]
        self._ready = []
        for _, some in groupby(measured, lambda pair: pair[0].rows.form):
            self._add(*zip(*some, strict=True))

    def _is_measured(self, frame: Frame) -> bool:
        phase = frame.header["phase"]
        if phase == Phase.UNSUBTRACTED:
            self.counts.unsubtracted_frames += 1
        elif phase != Phase.MEASURED:
            self.counts.dark_frames += 1
        elif not frame.flags["index_seen"]:
            self.counts.unreferenced_frames += 1
        else:
            return True
        return False

    def _add(self, frames: tuple[Frame, ...], angles: tuple[RowAngles, ...]) -> None:
        rows = Rows.joined([frame.rows for frame in frames])
        use = rows.valid
        if self.min_quality > 0:
            use = use & (rows.quality >= self.min_quality)
            self.counts.poor += int(np.count_nonzero(rows.valid)) - int(np.count_nonzero(use))
        some = _all_or(use)
        column, row = rows.column_px[some], rows.row[some]
        alpha = self.calibration.laser.alpha(joined([each.counts for each in angles])[some])
        found = self._locator.locate(column, row.astype(np.float64), alpha)
        self.counts.parallel += found.parallel
        self.counts.behind += found.behind
        good = _all_or(found.valid)
        where = found.points[good]
        times = [self._seconds(frame) + frame.row_times / self.clock_hz for frame in frames]
        numbers = np.repeat([self._number(frame) for frame in frames], [len(frame.rows) for frame in frames])
        points = self._take_room(len(where))
        points["x"], points["y"], points["z"] = where.T
        points["intensity"] = rows.peak[some][good] / 255
        points["quality"] = rows.quality[some][good]
        points["scalar_frame"] = numbers[some][good]
        points["scalar_row"] = row[good]
        points["scalar_column"] = column[good]
        points["scalar_angle"] = alpha[good]
        points["scalar_width"] = rows.width_px[some][good]
        points["scalar_time"] = joined(times)[some][good]
        self.counts.points += len(points)
        self.counts.standing += int(np.count_nonzero(joined([each.standing for each in angles])[some][good]))
        if len(points):
            self.chunks.append(points)

    def _take_room(self, count: int) -> Records:
        """Memory for so many points."""
        if count > len(self._room):
            self._room = np.empty(max(count, _BLOCK), POINT)
        room, self._room = self._room[:count], self._room[count:]
        return room


def _all_or(mask: Booleans) -> Booleans | slice:
    """A mask as an index; where it leaves nothing out, a slice, which copies nothing."""
    return slice(None) if np.count_nonzero(mask) == len(mask) else mask
