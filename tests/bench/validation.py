"""Accuracy on artefacts at 2 m with the true calibration: the card's own way beside the paper's, and under water."""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from magtrak.calibrate.ports import calibrate_ports
from magtrak.calibration import Calibration
from magtrak.cloud.ply import read_ply
from magtrak.locate import locator
from magtrak.validate import artefacts
from magtrak.validate.artefacts import Result
from magtrak.validate.fits import fit_plane
from magtrak.validate.segments import find_planes
from magtrak.validate.virtual import Recording, record
from sim.scene import Scene
from tests.bench import Figure
from tests.support.noise import column_noise_px
from tests.support.water import nominal, observe

PORTS_SEED = 4
RADII, DISTANCE = (75.0, 75.0, 60.0, 100.0), 502.4938


def recorded(scene: str, folder: Path, paper: bool) -> Recording:
    with (folder / f"{scene}.log").open("w") as log:
        return record(scene, folder / scene, paper=paper, log=log)


def worst(result: Result, what: str) -> float:
    return max(abs(line.error or 0.0) for line in result.lines if what in line.what)


def run() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flat = recorded("plane", folder, paper=True)
        assert flat.paper is not None
        cloud = read_ply(flat.clouds[0])
        ours, theirs = (artefacts.planes([them]).lines[0].value for them in (cloud, read_ply(flat.paper)))
        noise = column_noise_px(cloud)
        yield Figure("column noise, wall at 2 m", noise, "px", goal="at most 0.025", met=noise <= 0.025)
        yield Figure("form error of a wall at 2 m, RMS", ours, "mm", "paper's way", theirs, "at most 0.30", ours <= 0.3)

        bodies = recorded("artefacts", folder, paper=False)
        cloud = read_ply(bodies.clouds[0])
        spheres = artefacts.spheres([cloud], RADII, [DISTANCE])
        error = worst(spheres, "radius")
        yield Figure("worst radius of four spheres at 2 m", error, "mm", goal="at most 0.15", met=error <= 0.15)
        error = worst(spheres, "distance of spheres 1")
        yield Figure("distance of two spheres at 2 m", error, "mm", goal="at most 0.25", met=error <= 0.25)
        error = worst(artefacts.cylinders([cloud], 80.0), "radius")
        yield Figure("radius of a cylinder at 2 m", error, "mm", goal="at most 0.15", met=error <= 0.15)
        error = worst(artefacts.steps([cloud], 60.0), "step")
        yield Figure("step of 60 mm at 2 m", error, "mm")

        wet = recorded("water", folder, paper=False)
        cloud = read_ply(wet.clouds[0])
        wall = find_planes(cloud)[0]
        calibration = Calibration.load(wet.calibration)
        # The same points of the wall, as other models see them.
        on_wall = np.abs(wall.height(np.stack([cloud[axis] for axis in "xyz"], axis=-1).astype(float))) < 5
        seen = [cloud[field][on_wall].astype(float) for field in ("scalar_column", "scalar_row", "scalar_angle")]
        in_air = replace(calibration, ports=None)
        scene = Scene.load("water")
        found = calibrate_ports(in_air, nominal(scene, PORTS_SEED), observe(scene, 10, PORTS_SEED, 2))
        air, ours = _flatness(in_air, seen), _flatness(found.calibration, seen)
        yield Figure("form error of a wall under water, true ports", wall.rms, "mm")
        yield Figure("the same, ports as found", ours, "mm", "without ports", air, "at most 0.6", ours <= 0.6)


def _flatness(calibration: Calibration, seen: list[np.ndarray]) -> float:
    """RMS from the plane through rows (columns, rows, angles), by one model or another."""
    points = locator(calibration).locate(*seen)
    fit = fit_plane(points.points[points.valid])
    return float(np.sqrt(np.mean(fit.residuals**2)))
