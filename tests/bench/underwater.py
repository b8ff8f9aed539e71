"""Under water from pictures alone: camera and laser by a session in air, the panes before them by a session of ten
views under water, and a scan with what was found, beside the calibration that knows of no water.
"""

import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from magtrak.cloud.ply import read_ply
from magtrak.validate.segments import find_planes, find_spheres
from sim.scene import Scene
from sim.surfaces import Plane, Sphere
from tests.bench import Figure
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
RULE_SEED = 4


def run() -> Iterator[Figure]:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    scene = Scene.load(WATER)
    wall = next(item for item in scene.surfaces if isinstance(item, Plane))
    balls = sorted((item for item in scene.surfaces if isinstance(item, Sphere)), key=lambda item: item.pose[0, 3])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        air, rule, found = folder / "air.json", folder / "rule.json", folder / "water.json"
        calibrate(take_session(Pictures(), folder / "in-air"), air)
        rule.write_text(json.dumps({"ports": nominal(scene, RULE_SEED).as_dict()}))
        session = take_session(Pictures(WATER, VIEWS, LIT), folder / "under-water")
        calibrate_ports(session, air, rule, found)
        recorded = recording(WATER)
        ours = replay(recorded, found, folder / "found.ply")
        truth = replay(recorded, true_calibration(session, folder / "truth.json"), folder / "truth.ply")
        theirs = replay(recorded, air, folder / "air.ply")
        fit, ideal, bent = (find_planes(read_ply(cloud))[0] for cloud in (ours, truth, theirs))
        what = f"wall at {wall.pose[2, 3] / 1000:g} m under water"
        yield Figure(
            f"{what}, form, RMS", fit.rms, "mm", "as in air", bent.rms, "at most 0.6", met=bool(fit.rms <= 0.6)
        )
        yield Figure("the same by the true calibration", ideal.rms, "mm")
        middle = fit.points[fit.kept].mean(axis=0)
        yield Figure(f"{what}, its place", float(wall.distance(middle[None])[0]), "mm")
        fits = find_spheres(read_ply(ours), [ball.radius for ball in balls])
        radius = max(abs(fit.radius - ball.radius) for fit, ball in zip(fits, balls, strict=True))
        yield Figure(f"{len(balls)} spheres under water, worst radius", radius, "mm")
