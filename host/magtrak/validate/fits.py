"""Planes, spheres and cylinders through points.

Least squares of the distances along the normal (Gaussian association, as VDI/VDE 2634 part 2 and ISO 10360 ask for),
after points that belong to something else were left out: a fit with a robust loss finds the surface, points farther
from it than :data:`TRIM` robust standard deviations go, and so again until none does. How many went is told.

Sources: A. B. Forbes, "Least-squares best-fit geometric elements", NPL report DITC 140/89, 1989, for the parameters;
F. R. Hampel et al., "Robust statistics", 1986, for the median absolute deviation.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import Booleans, Floats
from ..errors import MagtrakError

TRIM = 4.0
"""Robust standard deviations beyond which a point is left out."""

ROUNDS = 10
MAD_TO_SIGMA = 1.4826
LEAST_POINTS = 30
FORM_PART = 0.003
"""Part of the points that VDI/VDE 2634 part 2 lets out of the range of the form error."""


@dataclass(frozen=True, eq=False)
class Fit:
    """What is common to all.

    Attributes
    ----------
    points : (N, 3) that were given
    residuals : (N,) distances of all points from the surface, mm; positive on the side of the normal, or outside
    kept : (N,) points that the fit used
    """

    points: Floats
    residuals: Floats
    kept: Booleans

    @property
    def rms(self) -> float:
        """Form error: RMS of the points in use, mm."""
        return float(np.sqrt(np.mean(self.residuals[self.kept] ** 2)))

    @property
    def form(self) -> float:
        """Form error as a range, mm: from the least to the greatest residual but :data:`FORM_PART` of them."""
        ordered = np.sort(self.residuals[self.kept])
        out = int(FORM_PART * len(ordered))
        # Those are left out that make the range smallest.
        spans = ordered[len(ordered) - 1 - out :] - ordered[: out + 1]
        return float(spans.min())

    @property
    def trimmed(self) -> float:
        """Part of the points that were left out."""
        return float(1 - self.kept.mean())


@dataclass(frozen=True, eq=False)
class PlaneFit(Fit):
    """``normal . P = distance``; the normal points towards the origin (the camera)."""

    normal: Floats
    distance: float

    def height(self, points: Floats) -> Floats:
        """Signed distances of (N, 3) points, positive towards the camera."""
        return np.asarray(points @ self.normal - self.distance)


@dataclass(frozen=True, eq=False)
class SphereFit(Fit):
    """Centre (3,) and radius, with the radius's sigma if the residuals were independent."""

    centre: Floats
    radius: float
    radius_sigma: float


@dataclass(frozen=True, eq=False)
class CylinderFit(Fit):
    """A point of the axis (3,), its direction (3,), the radius, and its sigma if the residuals were independent."""

    point: Floats
    axis: Floats
    radius: float
    radius_sigma: float


def fit_plane(points: Floats) -> PlaneFit:
    """Plane through (N, 3) points; :exc:`MagtrakError` where there are too few."""

    def solve(used: Floats, start: Floats | None) -> Floats:
        if start is None:
            return _plane_of_many(used)
        return _plane(used)

    vector, residuals, kept = _trimmed(points, solve, lambda p, x: p @ x[:3] - x[3])
    sign = 1.0 if vector[3] <= 0 else -1.0  # the origin has a positive height
    return PlaneFit(points, sign * residuals, kept, sign * vector[:3], float(sign * vector[3]))


def fit_sphere(points: Floats, start: Floats | None = None) -> SphereFit:
    """Sphere through (N, 3) points.

    Parameters
    ----------
    points : of one sphere, with some that are not
    start : (4,) centre and radius from which to begin

    Raises
    ------
    MagtrakError
        There are too few points.
    """
    begin = _sphere(points) if start is None else start

    def distance(p: Floats, x: Floats) -> Floats:
        return np.asarray(np.linalg.norm(p - x[:3], axis=1) - x[3])

    vector, residuals, kept = _trimmed(points, _solver(distance, begin), distance)
    sigma = _sigma(distance, points[kept], vector)[3]
    return SphereFit(points, residuals, kept, vector[:3], float(abs(vector[3])), float(sigma))


def fit_cylinder(points: Floats, axis: Floats | None = None) -> CylinderFit:
    """Cylinder through (N, 3) points of its side; ``axis`` (3,) is its rough direction, by default from the normals.

    Raises
    ------
    MagtrakError
        There are too few points.
    """
    _enough(points)
    rough = axis_of(points) if axis is None else np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    middle = np.median(points, axis=0)
    # A frame whose Z is the rough axis: two slopes of the axis, two coordinates of its foot, and the radius.
    frame = np.linalg.svd(rough[None])[2][[1, 2, 0]]
    frame[2] = rough
    local = (points - middle) @ frame.T

    def distance(p: Floats, x: Floats) -> Floats:
        along = np.array([x[2], x[3], 1.0]) / np.sqrt(1 + x[2] ** 2 + x[3] ** 2)
        from_foot = p - np.array([x[0], x[1], 0.0])
        return np.asarray(np.linalg.norm(np.cross(from_foot, along), axis=1) - x[4])

    circle = _sphere(local * np.array([1.0, 1.0, 0.0]), flat=True)
    begin = np.array([circle[0], circle[1], 0.0, 0.0, circle[3]])
    vector, residuals, kept = _trimmed(local, _solver(distance, begin), distance)
    sigma = _sigma(distance, local[kept], vector)[4]
    direction = np.array([vector[2], vector[3], 1.0]) @ frame
    foot = np.array([vector[0], vector[1], 0.0]) @ frame + middle
    return CylinderFit(
        points, residuals, kept, foot, direction / np.linalg.norm(direction), float(abs(vector[4])), float(sigma)
    )


def normals_of(points: Floats, neighbours: int = 20) -> Floats:
    """(N, 3) unit normals, of either sign, at (N, 3) points of a surface: across what their nearest neighbours span."""
    from scipy.spatial import cKDTree

    near = cKDTree(points).query(points, min(neighbours, len(points)))[1]
    spread = points[near] - points[near].mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))[1][:, :, 0])


def axis_of(points: Floats) -> Floats:
    """Direction that is across most normals of (N, 3) points: the axis, where they lie on the side of a cylinder."""
    some = points if len(points) <= 4000 else points[np.linspace(0, len(points) - 1, 4000).astype(int)]
    normals = normals_of(some)
    weights = np.ones(len(normals))
    axis = np.zeros(3)
    for _ in range(ROUNDS):
        axis = np.linalg.eigh((normals * weights[:, None]).T @ normals)[1][:, 0]
        weights = 1 / (1 + ((normals @ axis) / 0.1) ** 2)
    return np.asarray(axis)


def _enough(points: Floats) -> None:
    if len(points) < LEAST_POINTS:
        raise MagtrakError(f"{len(points)} points are too few for a surface: scan it more closely, or nearer")


def _trimmed(
    points: Floats, solve: Callable[[Floats, Floats | None], Floats], distance: Callable[[Floats, Floats], Floats]
) -> tuple[Floats, Floats, Booleans]:
    """Parameters, residuals of all points and which were used; ``solve`` gets the points in use and the last result."""
    _enough(points)
    kept = np.ones(len(points), bool)
    vector: Floats | None = None
    for number in range(ROUNDS):
        vector = solve(points[kept], vector)
        residuals = distance(points, vector)
        middle = np.median(residuals[kept])
        spread = MAD_TO_SIGMA * np.median(np.abs(residuals[kept] - middle))
        new = np.abs(residuals - middle) <= max(TRIM * spread, 1e-9)
        if number and np.array_equal(new, kept):
            break  # not before the start, which is robust and rough, was refined
        kept = new
        _enough(points[kept])
    assert vector is not None
    return vector, distance(points, vector), kept


def _solver(distance: Callable[[Floats, Floats], Floats], begin: Floats) -> Callable[[Floats, Floats | None], Floats]:
    """Robust at first, least squares once outliers are out."""
    from scipy.optimize import least_squares

    def solve(points: Floats, last: Floats | None) -> Floats:
        def misses(x: Floats) -> Floats:
            return distance(points, x)

        if last is None:
            scale = max(MAD_TO_SIGMA * float(np.median(np.abs(misses(begin)))), 0.05)
            begun = least_squares(misses, begin, loss="soft_l1", f_scale=min(scale, 1.0), x_scale="jac")
            return np.asarray(begun.x)
        return np.asarray(least_squares(misses, last, x_scale="jac", xtol=1e-12, ftol=1e-12).x)

    return solve


def _sigma(distance: Callable[[Floats, Floats], Floats], points: Floats, vector: Floats) -> Floats:
    """Standard deviations of the parameters for independent residuals."""
    step = 1e-4
    slopes = np.stack(
        [
            (distance(points, vector + side) - distance(points, vector - side)) / (2 * step)
            for side in step * np.eye(len(vector))
        ],
        axis=1,
    )
    noise = np.sum(distance(points, vector) ** 2) / max(len(points) - len(vector), 1)
    return np.asarray(np.sqrt(noise * np.diag(np.linalg.inv(slopes.T @ slopes))))


def _plane(points: Floats) -> Floats:
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    return np.append(normal, normal @ middle)


def _plane_of_many(points: Floats, tries: int = 60) -> Floats:
    """The plane of three of the points that the median point lies nearest to (least median of squares)."""
    rng = np.random.default_rng(1)
    best, least = _plane(points), np.inf
    some = points[rng.integers(len(points), size=min(len(points), 2000))]
    for _ in range(tries):
        try_ = _plane(points[rng.choice(len(points), 3, replace=False)])
        middle = np.median(np.abs(some @ try_[:3] - try_[3]))
        if middle < least:
            best, least = try_, middle
    near = np.abs(points @ best[:3] - best[3]) <= max(2 * MAD_TO_SIGMA * least, 1e-9)
    return _plane(points[near])


def _sphere(points: Floats, flat: bool = False) -> Floats:
    """Centre and radius by algebra: |P|^2 = 2 c . P + (r^2 - |c|^2). A circle in X and Y where ``flat``."""
    _enough(points)
    middle = points.mean(axis=0)
    p = (points - middle)[:, : 2 if flat else 3]
    matrix = np.column_stack([2 * p, np.ones(len(p))])
    solution = np.linalg.lstsq(matrix, np.sum(p * p, axis=1), rcond=None)[0]
    centre = np.append(solution[:2], 0.0) if flat else solution[:3]
    radius = np.sqrt(max(solution[-1] + centre @ centre, 1e-9))
    return np.append(centre + middle, radius)
