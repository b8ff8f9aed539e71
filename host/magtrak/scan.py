"""From frames to a cloud: angles, rays, planes, points, and the count of everything that gave none."""

from dataclasses import dataclass

import numpy as np

from .angle import AngleTracker, RowAngles, bare_angles
from .arrays import Records
from .calibration import Calibration
from .cloud.points import POINT
from .errors import CalibrationError, CardError
from .frames import Frame
from .locate import locator
from .triangulate import MIN_SINE, quality


@dataclass
class Counts:
    """What became of the frames and rows so far.

    Attributes
    ----------
    frames : received
    lost_frames : images between the first and the last received that did not arrive
    dropped_frames : those of them that the card dropped because no buffer was free
    unreferenced_frames : without points because the index had not been passed
    points : in the cloud
    parallel, behind : rows whose ray is parallel to the laser plane, or meets it behind the camera
    poor : rows below the least quality asked for
    standing : points whose angle is the middle of a count, because the encoder stood still
    encoder_errors : that the card counted since the first frame
    """

    frames: int = 0
    lost_frames: int = 0
    dropped_frames: int = 0
    unreferenced_frames: int = 0
    points: int = 0
    parallel: int = 0
    behind: int = 0
    poor: int = 0
    standing: int = 0
    encoder_errors: int = 0


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
    chunks : points so far, an array of ``POINT`` per frame that gave some; begins with an empty one
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
        self._first: Frame | None = None
        self._last: Frame | None = None

    def push(self, frame: Frame) -> None:
        """Take the next frame. Its points come a few frames later.

        Raises
        ------
        CalibrationError
            The picture is not of the calibration's size.
        CardError
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
        self.counts.encoder_errors = max(frame.encoder_errors - self._first.encoder_errors, 0)
        if self.bare:
            self._add(frame, bare_angles(frame))
            return
        for ready, angles in self._tracker.push(frame):
            self._add(ready, angles)

    def finish(self) -> None:
        """No more frames will come: use those held back."""
        for frame, angles in self._tracker.flush():
            self._add(frame, angles)

    def cloud(self) -> Records:
        """All points so far."""
        return np.concatenate(self.chunks)

    def _check(self, frame: Frame) -> None:
        camera = self.calibration.camera
        header = frame.header
        if header["columns"] != camera.width or header["first_row"] + header["rows"] > camera.height:
            raise CalibrationError(
                f"the calibration is for pictures of {camera.width} x {camera.height}, the card sends"
                f" {header['columns']} columns and rows up to {header['first_row'] + header['rows'] - 1}:"
                " use the calibration of this camera"
            )
        if self._last is not None and header["first_time"] <= self._last.header["first_time"]:
            raise CardError("the card was reset during the scan: check its power, then start again")

    def _add(self, frame: Frame, angles: RowAngles) -> None:
        assert self._first is not None
        if not frame.flags["index_seen"]:
            self.counts.unreferenced_frames += 1
            return
        rows = frame.rows
        grade = quality(rows.peak, rows.width_px, rows.ambiguous, rows.saturated, rows.cut, rows.overflow)
        use = rows.valid & (grade >= self.min_quality)
        self.counts.poor += int((rows.valid & ~use).sum())
        alpha = self.calibration.laser.alpha(angles.counts[use])
        found = self._locator.locate(rows.column_px[use], rows.row[use].astype(np.float64), alpha)
        self.counts.parallel += found.parallel
        self.counts.behind += found.behind
        good = np.flatnonzero(use)[found.valid]
        start = frame.header["first_time"] - self._first.header["first_time"]
        points = np.zeros(len(good), POINT)
        points["x"], points["y"], points["z"] = found.points[found.valid].T
        points["intensity"] = rows.peak[good] / 255
        points["quality"] = grade[good]
        points["scalar_frame"] = (frame.number - self._first.number) & 0xFFFF_FFFF
        points["scalar_row"] = rows.row[good]
        points["scalar_column"] = rows.column_px[good]
        points["scalar_angle"] = alpha[found.valid]
        points["scalar_width"] = rows.width_px[good]
        points["scalar_time"] = (start + frame.row_times()[good]) / self.clock_hz
        self.counts.points += len(points)
        self.counts.standing += int(angles.standing[good].sum())
        if len(points):
            self.chunks.append(points)
