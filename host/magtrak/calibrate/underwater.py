"""From a session under water to a calibration with ports: camera and laser as in air, started from a rule."""

import json
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ..arrays import Booleans, Floats
from ..calibration import Calibration
from ..checked import Checked
from ..errors import CalibrationError
from ..ports import PortCamera, Ports
from .findings import Finding, finding, refuse
from .observations import Observations, View
from .ports import PortsFound, board_pose, calibrate_ports
from .session import DOWN_PX, REACH_PX, Session

LOOKED_AT = ((0.0, 0.0), (REACH_PX, 0.0), (-REACH_PX, 0.0), (0.0, DOWN_PX), (0.0, -DOWN_PX))
"""Columns and rows about a line's place that the detector looks at."""


@dataclass(frozen=True)
class UnderWater:
    """A calibration with ports, the fit it comes from, and what is to be said of it."""

    calibration: Calibration
    found: PortsFound
    findings: list[Finding]


def read_nominal(path: Path) -> Ports:
    """Ports as measured, from a JSON file with a section ``ports`` as calibrations have it.

    Raises
    ------
    CalibrationError
        Names file and field.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise CalibrationError(f"ports {path} cannot be read: {error}") from None
    return Ports.parse(Checked(str(path), values, CalibrationError).section("ports"))


def calibrate_under_water(session: Session, known: Calibration, nominal: Ports) -> UnderWater:
    """Find the ports from boards under water.

    Parameters
    ----------
    session : boards under water, with lines on their bands
    known : camera and laser, as calibrated in air; ports that it may have are not looked at
    nominal : ports as measured by rule

    Raises
    ------
    CalibrationError
        One of the refusals; the calibration is not of this rig.
    """
    seen, camera = session.seen, known.camera
    if (camera.width, camera.height) != (seen.width, seen.height):
        raise CalibrationError(
            f"the calibration is for pictures of {camera.width} x {camera.height}, these are {seen.width} x"
            f" {seen.height}: use the calibration of this camera"
        )
    if known.laser.counts_per_turn != seen.counts_per_turn:
        raise CalibrationError(
            f"the calibration has {known.laser.counts_per_turn} counts per turn, the session {seen.counts_per_turn}:"
            " use the calibration of this encoder"
        )
    in_air = replace(known, ports=None)
    seen, off_band = on_bands(seen, in_air, nominal)
    found = calibrate_ports(in_air, nominal, seen.thinned())
    findings = [*session.findings, *off_band]
    extra = {name: value for name, value in known.extra.items() if name != "expected"}
    extra["sigmas"] = {**extra.get("sigmas", {}), "ports": found.sigmas}
    extra["ports_fit"] = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "corner_px": found.corner_rms_px,
        "line_px": found.line_rms_px,
        "views": len(seen.views),
        "images": seen.images,
        "findings": [str(item) for item in findings],
    }
    return UnderWater(replace(found.calibration, extra=extra), found, findings)


def on_bands(seen: Observations, calibration: Calibration, ports: Ports) -> tuple[Observations, list[Finding]]:
    """Only rows whose line, with all that the detector looks at, lies on the blank band of its board, seen through the
    ports as measured.
    """
    camera = PortCamera(calibration.camera.build(), ports.camera, ports.water_index)
    views, findings = [], []
    for view in seen.views:
        if not len(view.lines):
            views.append(view)
            continue
        if view.board.band_mm is None:
            raise refuse("no-band", board=view.board.name)
        keep = _on_band(view, camera, board_pose(camera, view))
        if not keep.any():
            findings.append(finding("off-band", view=view.name))
        views.append(replace(view, lines=view.lines[keep]))
    return replace(seen, views=views), findings


def _on_band(view: View, camera: PortCamera, pose: Floats) -> Booleans:
    keep = np.ones(len(view.lines), bool)
    for across, down in LOOKED_AT:
        starts, directions = camera.rays(view.lines.column + across, view.lines.row + down)
        normal = pose[:3, 2]
        way = (pose[:3, 3] - starts) @ normal / (directions @ normal)
        local = (starts + way[:, None] * directions - pose[:3, 3]) @ pose[:3, :2]
        keep &= (way > 0) & view.board.on_band(local)
    return keep
