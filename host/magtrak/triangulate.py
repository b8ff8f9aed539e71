"""Rays and planes to points (eqs 8 to 10 of the paper, the sign of eq 10 corrected), and how good a point is."""

from dataclasses import dataclass

import numpy as np

from .arrays import Booleans, Floats

MIN_SINE = 0.01
"""Least sine of the angle between ray and plane (0.57 deg). Below, an error of 0.1 px grows to metres."""


@dataclass(frozen=True)
class Triangulated:
    """Points, and why some are none.

    Attributes
    ----------
    points : (N, 3) in C, mm; NaN where there is none
    valid : (N,) a point was found
    parallel : how many rays were too nearly parallel to their plane
    behind : how many met their plane behind the camera
    """

    points: Floats
    valid: Booleans
    parallel: int
    behind: int


def triangulate(
    centre: Floats, directions: Floats, normals: Floats, offsets: Floats, min_sine: float = MIN_SINE
) -> Triangulated:
    """Where rays meet planes.

    P = P0 + lambda v with lambda = (d - n . P0) / (n . v); d = n . P0' for any point P0' of the plane.

    Parameters
    ----------
    centre : P0, (3,), mm
    directions : v, (N, 3), of any length
    normals : n, unit vectors (N, 3)
    offsets : d, (N,), mm
    min_sine : rays with |n . v| / |v| below it are rejected
    """
    x, y, z = directions.T
    nx, ny, nz = normals.T
    slope = nx * x + ny * y + nz * z
    crossing = slope * slope >= min_sine * min_sine * (x * x + y * y + z * z)
    crosses = int(np.count_nonzero(crossing))
    height = offsets - normals @ centre if centre.any() else offsets
    distance = height / (slope if crosses == len(slope) else np.where(crossing, slope, 1.0))
    valid = crossing & (distance > 0)
    good = int(np.count_nonzero(valid))
    points = distance[:, None] * directions
    if centre.any():
        points += centre
    if good < len(valid):
        points[~valid] = np.nan
    return Triangulated(points, valid, len(valid) - crosses, crosses - good)


def quality(
    peak: Floats, width_px: Floats, ambiguous: Booleans, saturated: Booleans, cut: Booleans, overflow: Booleans
) -> Floats:
    """How far a point may be trusted, 0 to 1, for arrays of one shape.

    quality = min(1, peak / 64) * min(1, width / 3, 32 / width)
              * 0.2 if ambiguous * 0.8 if saturated * 0.5 if cut * 0 if overflow

    A peak of 64 grey levels above the floor stands well clear of noise; a run narrower than 3 px carries no fraction of
    a pixel, one wider than 32 px is hardly a line. An ambiguous row may be another thing altogether. An over-exposed
    line is still measured on its flanks. A row that broke the camera's contract may be anything.
    """
    width = np.maximum(width_px, 1.0)
    result = np.minimum(1.0, peak / 64) * np.minimum(1.0, np.minimum(width / 3, 32 / width))
    for flag, factor in ((ambiguous, 0.2), (saturated, 0.8), (cut, 0.5), (overflow, 0.0)):
        if flag.any():
            result = np.where(flag, factor * result, result)
    return result
