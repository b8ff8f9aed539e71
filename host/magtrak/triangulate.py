"""Rays and planes to points (eqs 8 to 10 of the paper, the sign of eq 10 corrected)."""

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
    centre: Floats | None, directions: Floats, normals: Floats, offsets: Floats, min_sine: float = MIN_SINE
) -> Triangulated:
    """Where rays meet planes.

    P = P0 + lambda v with lambda = (d - n . P0) / (n . v); d = n . P0' for any point P0' of the plane.

    Parameters
    ----------
    centre : P0, (3,), mm; None for the origin
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
    height = offsets if centre is None else offsets - normals @ centre
    distance = height / (slope if crosses == len(slope) else np.where(crossing, slope, 1.0))
    valid = crossing & (distance > 0)
    good = int(np.count_nonzero(valid))
    points = distance[:, None] * directions
    if centre is not None:
        points += centre
    if good < len(valid):
        points[~valid] = np.nan
    return Triangulated(points, valid, len(valid) - crosses, crosses - good)
