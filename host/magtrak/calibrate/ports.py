"""Flat ports from a board under water, when camera and laser are known from air.

What is known beforehand stays in force as a prior: a rule tells a pane's distance and the fan's start to some
millimetres, a table the water's index. The pictures and lines then move the nine numbers within that, together with
the boards' poses, until every corner is seen where it is and every lit point lies on its board.

A scale and a depth pull at the same numbers: without priors the distances of the panes and the index are nearly
interchangeable. So the sigmas that come back may be those of the priors; the points are good all the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import Floats
from ..calibration import Calibration
from ..errors import CalibrationError
from ..ports import Port, PortCamera, Ports, Sheet
from .observations import Observations, View

NAMES = (
    "camera.distance_mm",
    "camera.lean_1_rad",
    "camera.lean_2_rad",
    "laser.distance_mm",
    "laser.lean_1_rad",
    "laser.lean_2_rad",
    "laser.apex_beam_mm",
    "laser.apex_axis_mm",
    "water_index",
)
"""What is estimated. The leans turn a port's normal away from the given one, towards two directions across it."""

CORNER_PX, LINE_PX = 0.1, 0.05
MIN_VIEWS = 6
ROUNDS = 12
FARTHEST = 8.0
"""Nothing is farther from its prior than so many sigma."""

TOO_MUCH = 6.0
"""RMS of the residuals, in sigma, beyond which the model does not fit."""


@dataclass(frozen=True)
class Priors:
    """How well the ports are known beforehand, 1 sigma each."""

    distance_mm: float = 5.0
    lean_rad: float = 0.035
    apex_mm: float = 5.0
    water_index: float = 0.003

    def sigmas(self) -> Floats:
        """In the order of :data:`NAMES`."""
        lean, apex = self.lean_rad, self.apex_mm
        return np.array([self.distance_mm, lean, lean, self.distance_mm, lean, lean, apex, apex, self.water_index])


@dataclass(frozen=True)
class PortsFound:
    """What the fit found.

    Attributes
    ----------
    calibration : with the ports
    values, sigmas : by name, see :data:`NAMES`; leans are relative to the normals that were given
    corner_rms_px, line_rms_px : what is left
    poses : (V, 4, 4) of the boards in C
    """

    calibration: Calibration
    values: dict[str, float]
    sigmas: dict[str, float]
    corner_rms_px: float
    line_rms_px: float
    poses: Floats = field(repr=False)


def calibrate_ports(
    calibration: Calibration, nominal: Ports, observations: Observations, priors: Priors | None = None
) -> PortsFound:
    """Find the ports.

    Parameters
    ----------
    calibration : of camera and laser, made in air
    nominal : ports as measured by rule; also the glass, which stays as it is
    observations : boards under water, with the laser's line on some of them
    priors : of the nominal values

    Raises
    ------
    CalibrationError
        Too few views, no lines, or residuals that no port explains; names the likely cause.
    """
    from scipy.optimize import least_squares

    with_lines = sum(len(view.lines) > 0 for view in observations.views)
    if len(observations.views) < MIN_VIEWS or not with_lines:
        raise CalibrationError(
            f"{len(observations.views)} views of a board under water, {with_lines} of them with laser lines, are too"
            f" few: take at least {MIN_VIEWS}, near and far, with the laser's line on the blank band"
        )
    problem = _Problem(calibration, nominal, observations.views, (priors or Priors()).sigmas())
    start = problem.start()
    problem.weigh(start)
    free = np.full(len(start) - len(NAMES), np.inf)
    limits = np.concatenate([FARTHEST * problem.sigmas, free])
    # Squares first: from as far away as a rule leaves it, a robust loss would take everything for an outlier.
    for loss in ("linear", "soft_l1"):
        found = least_squares(
            problem.residuals, start, jac=problem.jacobian, x_scale=problem.scale(), loss=loss,
            bounds=(-limits, limits), max_nfev=ROUNDS, ftol=1e-7, xtol=1e-9,
        )  # fmt: skip
        start = found.x
        problem.weigh(start)
        corner_rms, line_rms = problem.left(start)
        if max(corner_rms / CORNER_PX, line_rms / LINE_PX) > TOO_MUCH:
            break
    if max(corner_rms / CORNER_PX, line_rms / LINE_PX) > TOO_MUCH:
        raise CalibrationError(
            f"no ports explain what was seen under water ({corner_rms:.2f} px of the corners, {line_rms:.2f} px of the"
            " lines are left): is the calibration in air that of this rig, and are the ports measured about right?"
        )
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    count = len(NAMES)
    sigmas = np.sqrt(np.diag(covariance)[:count])
    return PortsFound(
        replace(calibration, ports=problem.ports(found.x[:count])),
        dict(zip(NAMES, problem.describe(found.x[:count]).tolist(), strict=True)),
        dict(zip(NAMES, sigmas.tolist(), strict=True)),
        corner_rms,
        line_rms,
        np.array([_pose(six) for six in found.x[count:].reshape(-1, 6)]),
    )


class _Problem:
    """Residuals, in sigmas, of the vector of nine port parameters (as changes of the nominal ones) and six per pose."""

    def __init__(self, calibration: Calibration, nominal: Ports, views: Sequence[View], sigmas: Floats) -> None:
        self.calibration, self.nominal, self.views, self.sigmas = calibration, nominal, views, sigmas
        self.camera = calibration.camera.build()
        self.points = [_corners(view) for view in views]
        lines = [view.lines for view in views]
        offset_s = calibration.camera.time_offset_s
        self.alpha = np.concatenate([calibration.laser.alpha(line.counts + line.rate * offset_s) for line in lines])
        self.u, self.v = (np.concatenate([getattr(line, name) for line in lines]) for name in ("column", "row"))
        self.view_of_row = np.repeat(np.arange(len(views)), [len(line) for line in lines])
        self.mm_per_px = np.ones(len(self.u))

    def ports(self, change: Floats) -> Ports:
        near, sheet = self.nominal.camera, self.nominal.laser
        return Ports(
            _moved(near, change[0], change[1:3]),
            _moved(sheet, change[3], change[4:6]),
            self.nominal.apex_beam_mm + change[6],
            self.nominal.apex_axis_mm + change[7],
            self.nominal.water_index + change[8],
        )

    def describe(self, change: Floats) -> Floats:
        """The values themselves, in the order of :data:`NAMES`."""
        n = self.nominal
        base = [n.camera.distance_mm, 0, 0, n.laser.distance_mm, 0, 0, n.apex_beam_mm, n.apex_axis_mm, n.water_index]
        return np.array(base) + change

    def start(self) -> Floats:
        """Nominal ports; poses as for a camera whose rays in water met in one point."""
        camera = PortCamera(self.camera, self.nominal.camera, self.nominal.water_index)
        poses = [_six(camera, view) for view in self.views]
        return np.concatenate([np.zeros(len(NAMES)), *poses])

    def weigh(self, vector: Floats) -> None:
        """How far a point leaves its board for a pixel: lines are measured in pixels."""
        step = 0.25
        there, here = (self._heights(vector, self.u + side) for side in (step, -step))
        self.mm_per_px = np.maximum(np.nan_to_num(np.abs(there - here) / (2 * step), nan=1e3), 1e-3)

    def residuals(self, vector: Floats) -> Floats:
        corners, lines = self._misses(vector)
        priors = vector[: len(NAMES)] / self.sigmas
        return np.concatenate([priors, corners.ravel() / CORNER_PX, lines / LINE_PX])

    def left(self, vector: Floats) -> tuple[float, float]:
        """RMS of corners and lines, px."""
        return tuple(float(np.sqrt(np.mean(np.square(part)))) for part in self._misses(vector))  # type: ignore[return-value]

    def _misses(self, vector: Floats) -> tuple[Floats, Floats]:
        ports = self.ports(vector[: len(NAMES)])
        camera = PortCamera(self.camera, ports.camera, ports.water_index)
        poses = [_pose(six) for six in vector[len(NAMES) :].reshape(-1, 6)]
        there = [points @ pose[:3, :3].T + pose[:3, 3] for points, pose in zip(self.points, poses, strict=True)]
        corners = camera.project(np.concatenate(there)) - np.concatenate([view.corners for view in self.views])
        lines = self._heights(vector, self.u) / self.mm_per_px
        # A point that is nowhere is far away, but not so far as to spoil the numbers.
        return np.nan_to_num(corners, nan=100.0), np.nan_to_num(lines, nan=100.0)

    def _heights(self, vector: Floats, u: Floats) -> Floats:
        """Of the lit points above their boards, mm."""
        ports = self.ports(vector[: len(NAMES)])
        camera = PortCamera(self.camera, ports.camera, ports.water_index)
        starts, directions = camera.rays(u, self.v)
        points = Sheet(self.calibration.laser, ports).meet(starts, directions, self.alpha, 0.0).points
        poses = np.array([_pose(six) for six in vector[len(NAMES) :].reshape(-1, 6)])[self.view_of_row]
        return np.asarray(np.einsum("ij,ij->i", points - poses[:, :3, 3], poses[:, :3, 2]))

    def jacobian(self, vector: Floats) -> Floats:
        """Slopes of the residuals; a pose moves its own view alone, so that all poses are tried at once."""
        count = len(NAMES)
        corners = [2 * len(points) for points in self.points]
        view = np.concatenate([np.repeat(np.arange(len(self.views)), corners), self.view_of_row])
        here, steps = self.residuals(vector), 1e-4 * self.scale()
        slopes = np.zeros((len(here), len(vector)))
        for at in range(count):
            slopes[:, at] = self._slope(vector, here, [at], steps)
        rows = count + np.arange(len(view))
        for part in range(6):
            together = list(range(count + part, len(vector), 6))
            slopes[rows, count + 6 * view + part] = self._slope(vector, here, together, steps)[count:]
        return slopes

    def _slope(self, vector: Floats, here: Floats, which: list[int], steps: Floats) -> Floats:
        moved = vector.copy()
        moved[which] += steps[which]
        return np.asarray((self.residuals(moved) - here) / steps[which[0]])

    def scale(self) -> Floats:
        return np.concatenate([self.sigmas, np.tile([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0], len(self.views))])


def board_pose(camera: PortCamera, view: View) -> Floats:
    """(4, 4) of a view's board in C, as for a camera whose rays in water met in one point: right within millimetres."""
    return _pose(_six(camera, view))


def _six(camera: PortCamera, view: View) -> Floats:
    """Axis times angle, and shift."""
    import cv2

    rays = camera.ray(view.corners[:, 0].astype(float), view.corners[:, 1].astype(float))
    flat = np.ascontiguousarray(rays[:, :2] / rays[:, 2:])
    good, turn, shift = cv2.solvePnP(_corners(view), flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not good:
        raise CalibrationError(f"{view.name}: no pose of the board explains its corners; leave the view out")
    return np.concatenate([turn.ravel(), shift.ravel()])


def _corners(view: View) -> Floats:
    """(N, 3) in the board's frame."""
    return np.column_stack([view.board.points(view.ids), np.zeros(len(view.ids))])


def _moved(port: Port, distance_mm: float, lean_rad: Floats) -> Port:
    """A port farther away, its normal turned towards two directions across it."""
    helper = np.eye(3)[int(np.argmin(np.abs(port.normal)))]
    first = np.cross(port.normal, helper)
    first /= np.linalg.norm(first)
    normal = port.normal + lean_rad[0] * first + lean_rad[1] * np.cross(port.normal, first)
    return replace(port, distance_mm=port.distance_mm + distance_mm, normal=normal / np.linalg.norm(normal))


def _pose(six: Floats) -> Floats:
    """4 x 4, of an axis times an angle and a shift."""
    import cv2

    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(six[:3])[0], six[3:]
    return pose
