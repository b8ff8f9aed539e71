"""What a calibration's covariance means in millimetres: how far off a plane would be that faces the camera."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats
from ..camera import BrownConrady
from ..triangulate import triangulate
from .rig import Rig, harmonic
from .solve import Solution

DISTANCES_MM = (500.0, 1000.0, 2000.0, 3000.0)
SAMPLES = 100
GRID = (16, 12)


@dataclass(frozen=True)
class Accuracy:
    """Of a plane Z = ``distance_mm``, 95 % of calibrations like this one are better.

    Attributes
    ----------
    form_mm : RMS from the plane fitted to it
    place_mm : greatest displacement of a point
    scale : relative error of lengths on it
    """

    distance_mm: float
    form_mm: float
    place_mm: float
    scale: float


def accuracy(found: Solution, width: int, height: int, seed: int = 1) -> list[Accuracy]:
    """Drawn from the covariance, the boards' scale included; one for each of :data:`DISTANCES_MM`."""
    names = found.rig.names()
    free = [names.index(name) for name in found.names]
    rng = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(found.covariance)
    draws = rng.standard_normal((SAMPLES, len(free))) * np.sqrt(np.maximum(values, 0)) @ vectors.T
    result = []
    for distance in DISTANCES_MM:
        columns, rows, counts, real = _plane(found.rig, width, height, distance)
        errors = []
        for draw in draws:
            step = np.zeros(len(names))
            step[free] = draw
            points = _points(found.rig.moved(step), width, height, columns, rows, counts)
            errors.append(_errors(points, real))
        form, place, scale = np.percentile(np.array(errors), 95, axis=0)
        result.append(Accuracy(distance, float(form), float(place), float(scale)))
    return result


def _plane(rig: Rig, width: int, height: int, distance_mm: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Pixels, the counts at which the laser passes what they see of the plane, and where that is."""
    assert rig.laser is not None
    across, down = np.meshgrid(np.linspace(0, width - 1, GRID[0]), np.linspace(0, height - 1, GRID[1]))
    columns, rows = across.ravel(), down.ravel()
    rays = BrownConrady(rig.matrix, rig.camera[4:], width, height).ray(columns, rows)
    real = rays / rays[:, 2:] * distance_mm
    laser = rig.laser
    local = (real - laser.camera_from_laser[:3, 3]) @ laser.camera_from_laser[:3, :3]
    # n . P = cos(tilt) rho sin(phi - alpha) + sin(tilt) z = offset, in the half where the light goes.
    rho = np.cos(laser.tilt_rad) * np.hypot(local[:, 0], local[:, 1])
    sine = np.clip((laser.offset_mm - np.sin(laser.tilt_rad) * local[:, 2]) / rho, -1, 1)
    alpha = np.arctan2(local[:, 1], local[:, 0]) - np.arcsin(sine)
    counts = laser.sense * (alpha - laser.zero_rad) / (2 * np.pi) * laser.counts_per_turn
    shown = counts.copy()
    for _ in range(4):
        corrected = laser.corrected(shown + harmonic(shown, rig.harmonics, laser.counts_per_turn))
        shown -= corrected - counts
    return columns, rows, shown, real


def _points(rig: Rig, width: int, height: int, columns: Floats, rows: Floats, counts: Floats) -> Floats:
    assert rig.laser is not None
    camera = BrownConrady(rig.matrix, rig.camera[4:], width, height, steps=25)
    counts = counts + harmonic(counts, rig.harmonics, rig.laser.counts_per_turn)
    planes = rig.laser.planes(rig.laser.alpha(counts))
    return triangulate(camera.centre, camera.ray(columns, rows), *planes).points


def _errors(points: Floats, real: Floats) -> tuple[float, float, float]:
    good = np.isfinite(points).all(axis=1)
    points, real = points[good], real[good]
    middle, real_middle = points.mean(axis=0), real.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    form = float(np.sqrt(np.mean(((points - middle) @ normal) ** 2)))
    place = float(np.linalg.norm(points - real, axis=1).max())
    size = np.sqrt(np.sum((points - middle) ** 2) / np.sum((real - real_middle) ** 2))
    return form, place, abs(float(size) - 1)
