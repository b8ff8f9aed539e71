"""Calibrations of one rig from pictures, again and again: each session has other poses of the boards and other noise,
rendered and measured by the virtual card anew.

``SESSIONS=8 python -m tests.bench sessions`` for more than three; each takes five minutes of one processor, the first
are those of ``calibrated_scan`` with the same seeds.
"""

import csv
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from magtrak.calibrate.procedure import Result, calibrate_joint
from magtrak.calibrate.session import load
from sim.scene import Scene
from sim.session import timing_of
from tests.bench import Figure
from tests.support.calibrated_scan import RIG, Pictures, take_session
from tests.support.calibration_rig import TrueRig, deviations, plane_error

SESSIONS = int(os.environ.get("SESSIONS", "3"))
DISTANCE_MM = 2000.0


def run() -> Iterator[Figure]:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    scene = Scene.load(RIG)
    true = TrueRig(scene.camera, scene.laser, timing_of(scene).offset_s, counts_per_turn=scene.counts_per_turn)
    errors, within = [], []
    saturated: list[np.ndarray] = []
    others: list[np.ndarray] = []
    for seed in range(1, SESSIONS + 1):
        with tempfile.TemporaryDirectory() as name:
            session = take_session(Pictures(seed=seed), Path(name))
            result = calibrate_joint(load(session))
            bright = _saturated(session, result)
        saturated.append(result.solution.lines[bright])
        others.append(result.solution.lines[~bright])
        error = plane_error(true, result.calibration, DISTANCE_MM)
        errors.append((error.form, error.place, 100 * abs(error.scale)))
        good = [abs(value) <= 2 * sigma for value, sigma in deviations(true, result.solution).values()]
        within += good
        yield Figure(f"session {seed}: plane at 2 m, form error", error.form, "mm")
        yield Figure(f"session {seed}: plane at 2 m, greatest displacement", error.place, "mm")
        yield Figure(f"session {seed}: scale", 100 * abs(error.scale), "%")
        yield Figure(f"session {seed}: parameters within 2 sigma", 100 * float(np.mean(good)), "%")
    form, place, scale = np.max(errors, axis=0)
    what = f"worst of {SESSIONS} sessions"
    yield Figure(f"{what}: plane at 2 m, form error", form, "mm", goal="at most 0.2", met=bool(form <= 0.2))
    yield Figure(f"{what}: plane at 2 m, greatest displacement", place, "mm", goal="at most 2", met=bool(place <= 2))
    yield Figure(f"{what}: scale", scale, "%", goal="at most 0.03", met=bool(scale <= 0.03))
    share = 100 * float(np.mean(within))
    yield Figure("all parameters of all sessions within 2 sigma", share, "%", goal="90 to 99 %", met=90 <= share <= 99)
    bright, plain = np.concatenate(saturated), np.concatenate(others)
    share = 100 * len(bright) / (len(bright) + len(plain))
    yield Figure("rows on the bands that are saturated", share, "%")
    yield Figure("their scatter about the fit", _scatter(bright), "px", "rows that are not", _scatter(plain))


def _saturated(session: Path, result: Result) -> np.ndarray:
    """(M,) which of the rows of a fit were saturated."""
    with (session / "lines.csv").open(newline="") as file:
        flags = {(int(row["frame"]), float(row["row"])): "s" in row["flags"] for row in csv.DictReader(file)}
    lines = [view.lines for view in result.seen.views]
    return np.array([flags[int(f), float(r)] for part in lines for f, r in zip(part.image, part.row, strict=True)])


def _scatter(residuals: np.ndarray) -> float:
    return float(1.4826 * np.median(np.abs(residuals)))
