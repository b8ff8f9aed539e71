"""Is this calibration still good? Asked of one picture of the board, and of lines on it where there are some."""

from dataclasses import dataclass, replace

import numpy as np

from ..calibration import Calibration
from .findings import Finding, finding
from .procedure import known_camera
from .rig import Predictions
from .session import Session, on_bands

CORNER_PX = 0.35
"""RMS of the corners about their best pose; above, the camera is not what it was."""

LINE_PX = 0.3


@dataclass(frozen=True)
class Drift:
    """How well a calibration fits what is seen now.

    Attributes
    ----------
    corner_px : RMS of the corners about the board's best pose
    focal : relative change of the focal length that fits best; NaN with one view
    line_px : mean error of the laser's lines on the boards, signed; NaN without lines
    zero_rad : the turn of the laser's zero that explains it; NaN without lines
    findings : empty where the calibration is good
    """

    corner_px: float
    line_px: float
    zero_rad: float
    findings: list[Finding]


def drift(session: Session, known: Calibration) -> Drift:
    """Corners against the best pose; lines against the board that the corners show.

    One picture tells a changed lens, focus or picture size, and, with a line on the blank band, any movement between
    camera and laser. A camera that turned as a whole with its laser is no fault, and not seen.
    """
    found = known_camera(session.seen, known)
    corner = float(np.sqrt(np.mean(found.corners**2)))
    usual = float(known.extra.get("residuals", {}).get("corner_px", 0.1))
    findings = list(session.findings)
    limit = max(CORNER_PX, 3 * usual)
    if corner > limit:
        findings.append(
            finding(
                "drift", px=corner, times=corner / usual, cause="focus, zoom or lens changed, or it is another board"
            )
        )
    if not len(np.concatenate([view.lines.row for view in session.seen.views])):
        return Drift(corner, float("nan"), float("nan"), findings)
    seen, off_band = on_bands(session.seen, found.rig)
    findings += off_band
    if not seen.images:
        return Drift(corner, float("nan"), float("nan"), findings)
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
    return Drift(corner, line, zero, findings)
