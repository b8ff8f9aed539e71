"""Is this calibration still good? Asked of one picture of the board, and of lines on it where there are some."""

from dataclasses import dataclass, replace

import numpy as np

from ..calibration import Calibration
from ..errors import CalibrationError
from . import assess
from .findings import Finding, finding
from .observations import Observations
from .procedure import known_camera
from .rig import CAMERA, Predictions
from .session import Session, on_bands
from .solve import Solution, Solver

CORNER_PX = 0.35
"""RMS of the corners about their best pose; above, the camera is not what it was."""

LINE_PX = 0.3
FOCAL, SURE = 0.003, 5.0
"""A focal length is another where it differs by this part and by so many of its sigmas, a stretch by half the part."""


@dataclass(frozen=True)
class Drift:
    """How well a calibration fits what is seen now.

    Attributes
    ----------
    corner_px : RMS of the corners about the board's best pose
    focal, focal_sigma : relative change of the focal lengths that fits best, and how well the pictures tell it
    stretch, stretch_sigma : relative change of the picture's width over its height, likewise
    line_px : mean error of the laser's lines on the boards, signed; NaN without lines
    zero_rad : the turn of the laser's zero that explains it; NaN without lines
    findings : empty where the calibration is good
    """

    corner_px: float
    focal: float
    focal_sigma: float
    stretch: float
    stretch_sigma: float
    line_px: float
    zero_rad: float
    findings: list[Finding]


def drift(session: Session, known: Calibration) -> Drift:
    """Corners against the best pose; lines against the board that the corners show.

    A picture tells a changed lens, and one that is stretched to one side. A focal length that changed, or a picture
    that was scaled, look like a board at another distance where the board faces the camera: how steep it was held
    decides how well they are told, and ``focal_sigma`` says it. A board of another size looks like the same board at
    another distance in any number of pictures; only a line on its blank band tells, which lies beside its place then.
    The line tells any movement between camera and laser as well. A camera that turned as a whole with its laser is no
    fault, and not seen.
    """
    found = known_camera(session.seen, known)
    corner = float(np.sqrt(np.mean(found.corners**2)))
    usual = float(known.extra.get("residuals", {}).get("corner_px", 0.1))
    findings = list(session.findings)
    optics = _optics(session.seen, found)
    focal, focal_sigma, stretch, stretch_sigma = optics
    if abs(stretch) > max(FOCAL / 2, SURE * stretch_sigma):
        cause = f"it is stretched by {100 * stretch:+.2f} % across: a picture of another shape, or a stretched print"
        findings.append(finding("drift", px=corner, times=corner / usual, cause=cause))
    elif abs(focal) > max(FOCAL, SURE * focal_sigma):
        cause = f"the focal length differs by {100 * focal:+.2f} %: focus or zoom was changed, or the picture scaled"
        findings.append(finding("drift", px=corner, times=corner / usual, cause=cause))
    if corner > max(CORNER_PX, 3 * usual) and not any(item.key == "drift" for item in findings):
        cause = "focus, zoom or lens changed, or it is another board"
        findings.append(finding("drift", px=corner, times=corner / usual, cause=cause))
    nothing = float("nan")
    if not len(np.concatenate([view.lines.row for view in session.seen.views])):
        return Drift(corner, *optics, nothing, nothing, findings)
    seen, off_band = on_bands(session.seen, found.rig)
    findings += off_band
    if not seen.images:
        return Drift(corner, *optics, nothing, nothing, findings)
    at = Predictions(seen)
    rig = replace(found.rig, laser=known.laser, time_s=known.camera.time_offset_s, angles=np.zeros(at.images))
    slopes = at.slopes(rig)
    errors = -at.heights(rig) / slopes
    line = float(np.median(errors))
    step = 1e-5
    moved = replace(known.laser, zero_rad=known.laser.zero_rad + step)
    by_zero = (-at.heights(replace(rig, laser=moved)) / slopes - errors) / step
    zero = -float(np.sum(by_zero * errors) / np.sum(by_zero**2))
    if abs(line) > LINE_PX:
        usual = float(known.extra.get("residuals", {}).get("line_px", 0.05))
        cause = (
            f"camera and laser moved against each other, as by {np.degrees(zero):+.3f} degrees of the laser's zero"
            " (--zero-only renews it if nothing else moved)"
        )
        findings.append(finding("drift", px=abs(line), times=abs(line) / usual, cause=cause))
    return Drift(corner, *optics, line, zero, findings)


def _optics(seen: Observations, found: Solution) -> tuple[float, float, float, float]:
    """Change of the focal length and its sigma, of width over height and its sigma, all relative."""
    bare = assess.seen_without_lines(seen)
    held = {*CAMERA, *(f"scale{number}" for number in range(len(seen.boards)))} - {"fx", "fy"}
    try:
        freed = Solver(bare, frozenset(held)).solve(found.rig)
    except CalibrationError:
        return 0.0, float("inf"), 0.0, float("inf")
    change = freed.rig.camera[:2] / found.rig.camera[:2] - 1
    at = [freed.names.index(name) for name in ("fx", "fy")]
    spread = freed.covariance[np.ix_(at, at)] / np.outer(found.rig.camera[:2], found.rig.camera[:2])
    mean, across = np.array([0.5, 0.5]), np.array([1.0, -1.0])
    return (
        float(mean @ change),
        float(np.sqrt(mean @ spread @ mean)),
        float(across @ change),
        float(np.sqrt(across @ spread @ across)),
    )
