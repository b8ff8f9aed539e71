"""Under water from rendered pictures alone: camera and laser from the session in air of ``calibrated_scan``, the panes
before them from a session of ten views under water and what a rule says, and a scan with what was found. Beside it
the calibration that knows of no water.

``SEEDS=2,3 python -m tests.bench underwater`` for other sessions, in air and under water, and other errors of the rule.
"""

import json
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np

from magtrak.cloud.ply import read_ply
from magtrak.validate.fits import PlaneFit, fit_plane
from magtrak.validate.segments import find_planes, find_spheres, positions
from sim.scene import FOLDER, Scene
from sim.surfaces import Plane, Sphere
from tests.bench import Figure
from tests.bench._seeds import by_seeds
from tests.support.calibrated_scan import (
    Pictures,
    calibrate,
    calibrate_ports,
    recording,
    replay,
    take_session,
    true_calibration,
)
from tests.support.water import nominal

WATER = "water"
VIEWS, LIT = 10, 3

ON_WALL_MM = 5.0

FAR_WALL = """[[object]]
shape = "plane"
position_mm = [0, 0, 3600]
albedo = [0.5, 0.5, 0.5]
"""


def run() -> Iterator[Figure]:
    yield from by_seeds(_seed)


def _seed(seed: int, folder: Path) -> Iterator[Figure]:
    scene = Scene.load(WATER)
    air, rule, found = folder / "air.json", folder / "rule.json", folder / "water.json"
    calibrate(take_session(Pictures(seed=seed), folder / "in-air"), air)
    rule.write_text(json.dumps({"ports": nominal(scene, seed).as_dict()}))
    session = take_session(Pictures(_empty(folder), VIEWS, LIT, seed), folder / "under-water")
    calibrate_ports(session, air, rule, found)
    truth = true_calibration(session, folder / "truth.json")
    ruled = folder / "ruled.json"
    ruled.write_text(json.dumps(json.loads(air.read_text()) | json.loads(rule.read_text())))
    recorded = recording(WATER)
    clouds = [read_ply(replay(recorded, file, file.with_suffix(".ply"))) for file in (found, truth, air, ruled)]
    fit, ideal = (find_planes(cloud)[0] for cloud in clouds[:2])
    bent, rough = (_same_rows(clouds[0], fit, cloud) for cloud in clouds[2:])
    wall = next(item for item in scene.surfaces if isinstance(item, Plane))
    what = f"wall at {wall.pose[2, 3] / 1000:g} m under water"
    yield Figure(f"{what}, form, RMS", fit.rms, "mm", "as in air", _rms(bent), "at most 0.6", bool(fit.rms <= 0.6))
    yield Figure("the same by the true calibration", ideal.rms, "mm")
    yield Figure("the same with the ports as measured by a rule", _rms(rough), "mm")
    middles = (one.points[one.kept].mean(axis=0) for one in (fit, bent))
    place, wrong = (float(wall.distance(middle[None])[0]) for middle in middles)
    yield Figure(f"{what}, its place", place, "mm", "as in air", wrong)
    balls = sorted((item for item in scene.surfaces if isinstance(item, Sphere)), key=lambda item: item.pose[0, 3])
    fits = find_spheres(clouds[0], [ball.radius for ball in balls])
    radius = max(abs(fit.radius - ball.radius) for fit, ball in zip(fits, balls, strict=True))
    yield Figure(f"{len(balls)} spheres under water, worst radius", radius, "mm")
    places = [(fit.centre, ball.pose[:3, 3]) for fit, ball in zip(fits, balls, strict=True)]
    place = max(float(np.linalg.norm(mine - its)) for mine, its in places)
    yield Figure(f"{len(balls)} spheres under water, worst place", place, "mm")
    gaps = [abs(float(np.linalg.norm(a[0] - b[0]) - np.linalg.norm(a[1] - b[1]))) for a, b in combinations(places, 2)]
    yield Figure(f"{len(balls)} spheres under water, worst distance", max(gaps), "mm")


def _same_rows(cloud: np.ndarray, wall: PlaneFit, other: np.ndarray) -> PlaneFit:
    """The plane through those points of another cloud of the scan whose rows lie on the wall by this one: what is bent
    is not found as a plane.
    """
    near = np.abs(wall.height(positions(cloud))) < ON_WALL_MM
    return fit_plane(positions(other[np.isin(_rows(other), _rows(cloud[near]))]))


def _rows(cloud: np.ndarray) -> np.ndarray:
    """A number (N,) for the frame and row of each point."""
    return cloud["scalar_frame"].astype(np.int64) * 4096 + cloud["scalar_row"].astype(np.int64)


def _rms(fit: PlaneFit) -> float:
    """Of all points: those farthest off are no outliers here."""
    return float(np.sqrt(np.mean(fit.residuals**2)))


def _empty(folder: Path) -> str:
    """A scene with the rig of ``water`` and nothing near before it, where boards are held; its file."""
    path = folder / "water-rig.toml"
    path.write_text((FOLDER / f"{WATER}.toml").read_text().split("[[object]]")[0] + FAR_WALL)
    return f"{path}"
