"""From observations to a calibration: a stepwise start, then everything at once.

The start goes step by step: camera and board poses from the corners (OpenCV's closed form), the swept plane from the
lines in closed form, its seven degrees of freedom by least squares with camera and poses held. Its sigmas are worth
nothing, for they know nothing of what was held; the joint fit's are the calibration's.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Floats
from ..errors import CalibrationError
from ..laser import Laser
from . import rig as rigs
from . import score
from .observations import Lines, Observations
from .problem import Noise
from .rig import Predictions, Rig
from .solve import Solution, Solver
from .sweep import Sweep, standard_form

K3_SIGMAS = 4.0
"""k3 stays 0 unless the data put it so many sigmas away from 0."""

MIN_RATE = 0.02
"""Time is determined where rates differ by more than this part of a turn per second."""


@dataclass(frozen=True)
class Estimates:
    """What a calibration is made of: the stepwise start to compare with, and the joint fit.

    Attributes
    ----------
    seen : the observations
    camera : camera and poses, without lines
    stepwise : laser alone, camera and poses held as in ``camera``; None where there are no lines
    joint : everything at once; None where there are no lines
    timed : whether the lines determine the time offset
    """

    seen: Observations
    camera: Solution
    stepwise: Solution | None = None
    joint: Solution | None = None
    timed: bool = False

    @property
    def best(self) -> Solution:
        return self.joint or self.camera


def estimate_camera(seen: Observations) -> Solution:
    """Camera and poses from corners alone; k3 only where the data demand it."""
    bare = replace(seen, views=[replace(view, lines=Lines()) for view in seen.views])
    start = start_camera(bare)
    solver = Solver(bare, frozenset({"k3"}))
    found = solver.solve(start)
    gain, _ = score.gain(found, {"k3": score.derivative(solver, found, "k3")})["k3"]
    if gain > K3_SIGMAS**2:
        freed = Solver(bare).solve(found.rig, found.noise)
        if abs(freed.rig.camera[8]) > K3_SIGMAS * freed.sigma("k3"):
            return freed
    return found


def start_camera(seen: Observations) -> Rig:
    """OpenCV's calibration of the pinhole, k3 held at 0."""
    import cv2

    objects = [np.c_[view.board.points(view.ids), np.zeros(len(view.ids))].astype(np.float32) for view in seen.views]
    images = [view.corners.astype(np.float32).reshape(-1, 1, 2) for view in seen.views]
    size = (seen.width, seen.height)
    try:
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            objects, images, size, None, None, flags=cv2.CALIB_FIX_K3
        )
    except cv2.error as error:
        raise CalibrationError(
            f"the corners of the {len(seen.views)} views fit no camera ({error.err or 'no solution'}): check that the"
            " board's description is that of the board in the pictures, and tilt it in some views"
        ) from None
    camera = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()[:5]])
    rotations = np.stack([cv2.Rodrigues(turn)[0] for turn in turns])
    translations = np.stack([shift.ravel() for shift in shifts])
    return Rig(camera, rotations, translations, np.ones(len(seen.boards)))


def start_poses(seen: Observations, camera: Floats) -> Rig:
    """Board poses for a camera (9,) that is known."""
    import cv2

    matrix = np.array([[camera[0], 0, camera[2]], [0, camera[1], camera[3]], [0, 0, 1]])
    turns, shifts = [], []
    for view in seen.views:
        flat = np.c_[view.board.points(view.ids), np.zeros(len(view.ids))]
        found, turn, shift = cv2.solvePnP(flat, view.corners, matrix, camera[4:], flags=cv2.SOLVEPNP_IPPE)
        if not found:
            raise CalibrationError(f"{view.name}: the board's pose cannot be found from its corners: leave it out")
        turns.append(cv2.Rodrigues(turn)[0])
        shifts.append(shift.ravel())
    return Rig(camera, np.stack(turns), np.stack(shifts), np.ones(len(seen.boards)))


def start_laser(seen: Observations, rig: Rig, counts_per_turn: int, error_table: Floats | None = None) -> list[Laser]:
    """Candidates for the laser from its lines, camera and poses being known."""
    at = Predictions(seen)
    points = at.on_board(rig, at.model(rig).ray(at.column, at.row))
    theta = 2 * np.pi * at.counts / counts_per_turn
    found = []
    middle = int(np.argsort(theta)[len(theta) // 2])
    for leaning in (True, False):
        try:
            sweep = Sweep.fit(points, theta, leaning=leaning)
            found.append(sweep.laser(counts_per_turn, points[middle], float(theta[middle]), error_table))
        except (CalibrationError, np.linalg.LinAlgError):
            continue
    return found


def estimate_laser(
    seen: Observations, camera: Solution, starts: Iterable[Laser] = (), error_table: Floats | None = None
) -> Solution:
    """The laser's seven degrees of freedom, and time, with camera and poses held: the stepwise way.

    Raises
    ------
    CalibrationError
        The lines fit no swept plane.
    """
    held = held_parts(seen, camera.rig, camera=True)
    coarse = Solver(seen, held | {"cos1", "sin1", "cos2", "sin2"}, poses=False, angles=False)
    best: Solution | None = None
    for laser in [*starts, *start_laser(seen, camera.rig, seen.counts_per_turn, error_table)]:
        start = replace(camera.rig, laser=laser, angles=np.zeros(coarse.predictions.images))
        try:
            found = coarse.solve(start, Noise(camera.noise.corner, 1.0), rounds=2)
        except CalibrationError:
            continue
        if best is None or found.noise.line < best.noise.line:
            best = found
    if best is None:
        raise CalibrationError(
            "the laser lines fit no plane that turns with the encoder: check that the lines lie on the board's blank"
            " band, that the encoder counts, and that neither camera nor laser was moved between views"
        )
    # A count is about a pixel: what the rows scatter by may be the images' angles as well.
    noise = Noise(best.noise.corner, min(best.noise.line, 0.3), max(2 * best.noise.line, 0.02))
    return Solver(seen, held, poses=False).solve(best.rig, noise)


def held_parts(seen: Observations, rig: Rig, *, camera: bool = False) -> frozenset[str]:
    """What the observations cannot tell: k3 where it is 0, time where the motor never turned both ways."""
    held = {"k3"} if rig.camera[8] == 0 else set()
    if camera:
        held |= {*rigs.CAMERA, *(f"scale{number}" for number in range(len(rig.scales)))}
    if not is_timed(seen):
        held.add("time")
    return frozenset(held)


def is_timed(seen: Observations) -> bool:
    """Whether forward and backward movement tell the time offset."""
    rates = np.concatenate([view.lines.rate for view in seen.views])
    return bool(len(rates)) and float(np.ptp(rates)) > MIN_RATE * seen.counts_per_turn


def estimate(
    seen: Observations,
    error_table: Floats | None = None,
    *,
    camera: Solution | None = None,
    stepwise: Solution | None = None,
) -> Estimates:
    """The whole: camera, stepwise laser, joint fit; the first two, where they are not given.

    Raises
    ------
    CalibrationError
        The observations fit no camera, no laser, or do not determine them.
    """
    seen = seen.thinned()
    camera = camera or estimate_camera(seen)
    if not seen.images:
        return Estimates(seen, camera)
    stepwise = stepwise or estimate_laser(seen, camera, error_table=error_table)
    noise = Noise(camera.noise.corner, stepwise.noise.line, stepwise.noise.angle)
    joint = Solver(seen, held_parts(seen, camera.rig)).solve(stepwise.rig, noise)
    return Estimates(seen, camera, standard_solution(seen, stepwise), standard_solution(seen, joint), is_timed(seen))


def standard_solution(seen: Observations, found: Solution) -> Solution:
    """With the laser in the form that files have. The axis' local coordinates turn with X_L, and their covariance."""
    rig = found.rig
    assert rig.laser is not None
    at = Predictions(seen)
    points = at.on_board(rig, at.model(rig).ray(at.column, at.row))
    middle = int(np.argsort(at.counts)[len(at.counts) // 2])
    laser = standard_form(rig.laser, points[middle], float(at.counts[middle]))
    change = local_change(rig.laser, laser)
    covariance = found.covariance.copy()
    mine = [found.names.index(name) for name in rigs.LASER if name in found.names]
    if len(mine) == len(rigs.LASER):
        whole = np.eye(len(covariance))
        whole[np.ix_(mine, mine)] = change
        covariance = whole @ covariance @ whole.T
    return replace(found, rig=replace(rig, laser=laser), covariance=covariance)


def local_change(old: Laser, new: Laser) -> Floats:
    """(7, 7): what a step in the old laser's local coordinates is in those of the same laser in another form."""
    change = np.zeros((7, 7))
    for column in range(7):
        step = 1e-6 * np.eye(7)[column]
        change[:, column] = (difference(rigs.moved_laser(old, step), new) - difference(old, new)) / 1e-6
    return change


def difference(laser: Laser, base: Laser) -> Floats:
    """(7,) the step in ``base``'s local coordinates (:data:`magtrak.calibrate.rig.LASER`) that leads to ``laser``, to
    first order; whatever form either has.
    """
    sweep, mine = Sweep.of(laser), Sweep.of(base)
    x, y, z = base.camera_from_laser[:3, :3].T
    origin = base.camera_from_laser[:3, 3]
    # One plane has two normals: take that of the base.
    sign = 1.0 if sweep.a @ mine.a + sweep.b @ mine.b > 0 else -1.0
    axis = np.cross(sweep.a, sweep.b)
    axis = axis / np.linalg.norm(axis)
    axis = axis if axis @ z > 0 else -axis
    # a . t = p and b . t = q on the axis: where it pierces the base's plane Z_L = 0.
    through = np.linalg.solve(np.stack([sweep.a, sweep.b, z]), [sweep.p, sweep.q, origin @ z])
    a, c = sign * sweep.a, sign * sweep.c
    zero = float(np.arctan2(-a @ x, a @ y)) - base.zero_rad
    return np.array(
        [
            -axis @ y,
            axis @ x,
            (through - origin) @ x,
            (through - origin) @ y,
            float(np.arcsin(np.clip(c @ axis, -1, 1))) - base.tilt_rad,
            float(sign * sweep.r - c @ through) - base.offset_mm,
            (zero + np.pi) % (2 * np.pi) - np.pi,
        ]
    )
