"""The calibrations that the commands make: from a session to a calibration and what is to be said of it."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import gcd
from typing import Any

import numpy as np

from ..arrays import Floats
from ..calibration import Calibration, CameraCalibration
from ..errors import CalibrationError
from ..laser import Laser
from . import assess
from .accuracy import accuracy
from .findings import Finding, finding
from .joint import Estimates, estimate, estimate_camera, estimate_laser, held_parts, is_timed, standard_solution
from .observations import Observations
from .rig import CAMERA, ENCODER, LASER, Rig, harmonic
from .session import Session, on_bands
from .solve import Solution, Solver

TABLE_LINES = 256


@dataclass(frozen=True)
class Result:
    """A calibration, the fit it comes from, and what is to be said of it."""

    calibration: Calibration
    solution: Solution
    seen: Observations
    findings: list[Finding]
    estimates: Estimates | None = None


def calibrate_camera(session: Session, previous: Calibration | None = None) -> Result:
    """Camera alone; the laser of ``previous`` stays, or none that could be used.

    Raises
    ------
    CalibrationError
        One of the refusals.
    """
    seen = assess.seen_without_lines(session.seen)
    findings = [*session.findings, *assess.before_camera(seen)]
    found = estimate_camera(seen)
    findings += assess.after_camera(seen, found)
    laser = Laser(np.eye(4)) if previous is None else previous.laser
    time_s = 0.0 if previous is None else previous.camera.time_offset_s
    extra: dict[str, Any] = {} if previous is None else dict(previous.extra)
    calibration = Calibration(_camera_of(found.rig, seen, time_s), laser, extra | _extra(found, seen, findings))
    return Result(calibration, found, seen, findings)


def calibrate_joint(session: Session, previous: Calibration | None = None, measured_mm: float | None = None) -> Result:
    """Camera, boards, laser, encoder and time together.

    Parameters
    ----------
    previous : its error table is the start, and its sense is compared
    measured_mm : hand-measured distance of the laser's axis from the camera
    """
    findings = [*session.findings, *assess.before_camera(session.seen)]
    camera = estimate_camera(assess.seen_without_lines(session.seen))
    findings += assess.after_camera(session.seen, camera)
    seen, off_band = on_bands(session.seen, camera.rig)
    findings += off_band
    findings += assess.before_laser(seen, camera.rig, is_timed(seen))
    seen = seen.thinned()
    table = None if previous is None or not len(previous.laser.error_table) else previous.laser.error_table
    stepwise = estimate_laser(seen, camera, error_table=table)
    assess.after_laser(seen, camera, stepwise)
    estimates = estimate(seen, table, camera=camera, stepwise=stepwise)
    assert estimates.joint is not None
    findings += assess.after_joint(estimates)
    if measured_mm is not None:
        findings += assess.against_measured(estimates.joint, seen, measured_mm)
    return _result(estimates.joint, seen, findings, previous, estimates)


def calibrate_laser(session: Session, previous: Calibration, *, zero_only: bool = False) -> Result:
    """The laser with a camera that is known and held; or its zero alone.

    Raises
    ------
    CalibrationError
        One of the refusals; the camera is not of this size or model.
    """
    camera = known_camera(session.seen, previous)
    findings = list(session.findings)
    seen, off_band = on_bands(session.seen, camera.rig)
    findings += off_band
    seen = seen.thinned()
    if zero_only:
        start = replace(
            camera.rig,
            laser=previous.laser,
            time_s=previous.camera.time_offset_s,
            angles=np.zeros(seen.images),
        )
        if not seen.images:
            raise CalibrationError("the session has no laser lines on the board's band: the zero cannot be renewed")
        solver = Solver(seen, frozenset(start.names()) - {"zero"})
        return _result(standard_solution(seen, solver.solve(start)), seen, findings, previous)
    findings += assess.before_laser(seen, camera.rig, is_timed(seen))
    table = previous.laser.error_table if len(previous.laser.error_table) else None
    stepwise = estimate_laser(seen, camera, error_table=table)
    assess.after_laser(seen, camera, stepwise)
    found = Solver(seen, held_parts(seen, camera.rig, camera=True)).solve(stepwise.rig, stepwise.noise)
    estimates = Estimates(seen, camera, stepwise, standard_solution(seen, found))
    findings += assess.after_joint(estimates)
    return _result(standard_solution(seen, found), seen, findings, previous, estimates)


def known_camera(seen: Observations, known: Calibration) -> Solution:
    """Poses of the boards with a camera that is held."""
    from .joint import start_poses

    camera = known.camera
    if camera.model != "brown-conrady" or len(camera.distortion) > 5:
        raise CalibrationError(
            f"the calibration's camera is {camera.model} with {len(camera.distortion)} coefficients: a joint or camera"
            " calibration takes its place"
        )
    if (camera.width, camera.height) != (seen.width, seen.height):
        raise CalibrationError(
            f"the calibration is for pictures of {camera.width} x {camera.height}, these are {seen.width} x"
            f" {seen.height}: use the calibration of this camera"
        )
    k = camera.matrix
    distortion = np.zeros(5)
    distortion[: len(camera.distortion)] = camera.distortion
    values = np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *distortion])
    bare = assess.seen_without_lines(seen)
    start = start_poses(bare, values)
    held = frozenset({*CAMERA, *(f"scale{number}" for number in range(len(seen.boards)))})
    return Solver(bare, held).solve(start)


def _result(
    found: Solution,
    seen: Observations,
    findings: list[Finding],
    previous: Calibration | None,
    estimates: Estimates | None = None,
) -> Result:
    rig = found.rig
    assert rig.laser is not None
    if previous is not None and previous.extra.get("sigmas") and previous.laser.sense != rig.laser.sense:
        findings = [*findings, finding("swapped", file="the previous calibration")]
    laser = replace(rig.laser, error_table=error_table(rig))
    extra: dict[str, Any] = {} if previous is None else dict(previous.extra)
    calibration = Calibration(_camera_of(rig, seen, rig.time_s), laser, extra | _extra(found, seen, findings))
    return Result(calibration, found, seen, findings, estimates)


def _camera_of(rig: Rig, seen: Observations, time_s: float) -> CameraCalibration:
    return CameraCalibration("brown-conrady", seen.width, seen.height, rig.matrix, rig.camera[4:].copy(), time_s)


def error_table(rig: Rig) -> Floats:
    """The encoder's error, what was known and what was found, as a table of at most 256 lines or as many as before."""
    laser = rig.laser
    assert laser is not None
    if not rig.harmonics.any():
        return laser.error_table
    lines = max(len(laser.error_table), gcd(laser.counts_per_turn, TABLE_LINES))
    counts = np.arange(lines, dtype=np.float64) * (laser.counts_per_turn / lines)
    shift = harmonic(counts, rig.harmonics, laser.counts_per_turn)
    return np.asarray(laser.corrected(counts + shift) - counts)


def _extra(found: Solution, seen: Observations, findings: list[Finding]) -> dict[str, Any]:
    """Sigmas, residuals, coverage, date: what a file carries beside the calibration itself."""
    sigmas: dict[str, Any] = {
        "camera": {name: found.sigma(name) for name in CAMERA},
        "board_scale": {board.name: found.sigma(f"scale{number}") for number, board in enumerate(seen.boards)},
    }
    extra: dict[str, Any] = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "sigmas": sigmas,
        "residuals": {"corner_px": found.noise.corner, "views": len(seen.views)},
        "coverage": {"cells_of_8_by_6": cells(seen).tolist()},
        "findings": [str(item) for item in findings],
    }
    if found.rig.laser is not None:
        units = dict(zip(LASER, ("rad", "rad", "mm", "mm", "rad", "mm", "rad"), strict=True))
        sigmas["laser"] = {f"{name}_{unit}": found.sigma(name) for name, unit in units.items()}
        sigmas["time_offset_s"] = found.sigma("time")
        sigmas["encoder_counts"] = {name: found.sigma(name) for name in ENCODER[1:]}
        extra["residuals"] |= {
            "line_px": found.noise.line,
            "angle_counts": found.noise.angle,
            "images": seen.images,
        }
        extra["expected"] = [vars(item) for item in accuracy(found, seen.width, seen.height)]
    return extra


def cells(seen: Observations) -> Floats:
    """(6, 8) how many corners lie in each cell of the picture."""
    corners = np.concatenate([view.corners for view in seen.views])
    x = np.clip(corners[:, 0] / seen.width * 8, 0, 7).astype(int)
    y = np.clip(corners[:, 1] / seen.height * 6, 0, 5).astype(int)
    return np.asarray(np.bincount(y * 8 + x, minlength=48).reshape(6, 8))
