"""From simulated pictures only: a session of 30 views through the virtual card, a joint calibration by its command, and
an unseen wall at 2 m scanned with it. Takes a quarter of an hour of processor time.

``CALIBRATED_SCAN=DIR`` keeps the session, and uses it again.
"""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from magtrak.calibration import Calibration
from tests.bench import Figure
from tests.support.calibrated_scan import calibrate, measure_lines, scan_plane, take_session, true_rig
from tests.support.calibration_rig import plane_error

VIEWS = 30
DISTANCE_MM = 2000.0


def run() -> Iterator[Figure]:
    keep = os.environ.get("CALIBRATED_SCAN")
    if keep is not None:
        yield from _run(Path(keep))
        return
    with tempfile.TemporaryDirectory() as folder:
        yield from _run(Path(folder))


def _run(folder: Path) -> Iterator[Figure]:
    session = take_session(folder, VIEWS)
    if not (session / "lines.csv").exists():
        measure_lines(session)
    path = folder / "calibration.json"
    calibrate(session, path)
    found = Calibration.load(path)
    for distance in (500.0, 1000.0, DISTANCE_MM, 3000.0):
        error = plane_error(true_rig(), found, distance)
        at = f"calibration alone, plane at {distance / 1000:g} m"
        here = distance == DISTANCE_MM
        yield Figure(
            f"{at}, form", error.form, "mm", goal="at most 0.2 mm" * here, met=error.form <= 0.2 if here else None
        )
        yield Figure(
            f"{at}, place", error.place, "mm", goal="at most 2 mm" * here, met=error.place <= 2 if here else None
        )
        scale = 100 * abs(error.scale)
        yield Figure(f"{at}, scale", scale, "%", goal="at most 0.03 %" * here, met=scale <= 0.03 if here else None)
    points = scan_plane(folder, path, DISTANCE_MM, 100)
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    form = float(np.sqrt(np.mean(((points - middle) @ normal) ** 2)))
    yield Figure("scanned wall at 2 m, form, RMS", form, "mm", goal="at most 0.3 mm", met=form <= 0.3)
    place = abs(float(middle[2]) - DISTANCE_MM)
    yield Figure("scanned wall at 2 m, its distance", place, "mm", goal="at most 2 mm", met=place <= 2)
