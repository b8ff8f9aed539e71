"""Finds artefacts in a cloud: pieces that hang together, and what shape each has.

Points of neighbouring rows and frames hang together where they are near each other; where the scan jumps from one body
to another they do not. A piece is taken for a sphere or cylinder of a nominal radius if most of its points lie on one,
whatever else stands in the scene. Nothing but the nominal size is asked of the user.
"""

from collections.abc import Sequence

import numpy as np

from ..arrays import Booleans, Floats, Integers, Records
from ..errors import MagtrakError
from .fits import CylinderFit, PlaneFit, SphereFit, fit_cylinder, fit_plane, fit_sphere, normals_of
from .light import light_source

GAP = 0.012
"""Neighbours farther apart than this part of their distance from the camera belong to different bodies."""

LEAST = 150
"""Points of a piece that is looked at."""

LIMB = 0.45
"""Cosine to the sight, and to the light, below which a surface is too steep to be measured. Grazing light spreads over
a round surface, brightest where it turns towards the laser: at a cosine of 0.3 the line lies 0.5 px off."""

SIZE_TOLERANCE = 0.05
"""A radius farther from the nominal one than this part of it is another thing."""

MOST_TRIMMED = 0.25
"""More points off the surface than this part, and the piece is no such surface."""

ROUGHLY = 3000
"""Points that are enough to see whether a piece is worth a closer look."""

LEAST_AROUND = 0.2
"""Part of a piece's points that lie on the side of a cylinder, at least; the others may be on its end."""

LEAST_TURN = 0.3
"""Sine of the angle between two normals from which an axis is told."""

BORDER = 2
"""Rows and frames at the border of a plane that are left out: the line may lie half on it."""

AXIS_END = 0.04
"""Part of a cylinder's length that is left out at each end."""


def positions(cloud: Records) -> Floats:
    """(N, 3) float64 of a cloud."""
    return np.stack([cloud[name] for name in "xyz"], axis=-1).astype(np.float64)


def pieces(cloud: Records, gap: float = GAP) -> list[Integers]:
    """Indices of the points of each piece of a cloud with ``scalar_frame`` and ``scalar_row``, the largest first.

    Raises
    ------
    MagtrakError
        The cloud lacks frames and rows: it is no scan of ours.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    names = cloud.dtype.names or ()
    for name in ("scalar_frame", "scalar_row"):
        if name not in names:
            raise MagtrakError(f"the cloud has no property {name}: give a cloud as magtrak-recv writes it")
    if not len(cloud):
        raise MagtrakError("the cloud is empty: is the laser on, is it the right file?")
    points = positions(cloud)
    frame, row = cloud["scalar_frame"].astype(np.int64), cloud["scalar_row"].astype(np.int64)
    grid = np.full((frame.max() - frame.min() + 2, row.max() - row.min() + 2), -1)
    grid[frame - frame.min(), row - row.min()] = np.arange(len(cloud))
    links = []
    for a, b in ((grid[:-1], grid[1:]), (grid[:, :-1], grid[:, 1:])):
        both = (a >= 0) & (b >= 0)
        i, j = a[both], b[both]
        near = np.linalg.norm(points[i] - points[j], axis=1) < gap * np.linalg.norm(points[i], axis=1)
        links.append(np.stack([i[near], j[near]]))
    i, j = np.concatenate(links, axis=1)
    count = len(cloud)
    _, label = connected_components(coo_matrix((np.ones(len(i), bool), (i, j)), (count, count)), directed=False)
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    return _joined(points, sorted((group for group in groups if len(group) >= LEAST), key=len, reverse=True), gap)


def _joined(points: Floats, groups: list[Integers], gap: float) -> list[Integers]:
    """Groups with those put together that cover each other: one body, seen on the way there and on the way back."""
    from scipy.spatial import cKDTree

    result: list[Integers] = []
    for group in groups:
        some = points[group[:: max(len(group) // 200, 1)]]
        reach = 0.5 * gap * np.linalg.norm(some, axis=1)
        for at, other in enumerate(result):
            near = cKDTree(points[other]).query(some, distance_upper_bound=float(reach.max()))[0]
            if np.mean(near < reach) > 0.7:
                result[at] = np.concatenate([other, group])
                break
        else:
            result.append(group)
    return result


def find_spheres(cloud: Records, radii: Sequence[float]) -> list[SphereFit]:
    """A sphere for each nominal radius, in their order; equal ones from left to right.

    Raises
    ------
    MagtrakError
        One is not there.
    """
    points, light = positions(cloud), light_source(cloud)
    found: list[tuple[SphereFit, float]] = []
    for piece in pieces(cloud):
        for radius in sorted(set(radii)):
            fit = _as_sphere(points[piece], radius, light)
            if fit is not None:
                found.append((fit, radius))
                break
    found.sort(key=lambda pair: pair[0].centre[0])
    result = []
    for radius in radii:
        mine = [pair for pair in found if pair[1] == radius]
        if not mine:
            have = ", ".join(f"{fit.radius:.1f}" for fit, _ in found) or "none"
            raise MagtrakError(
                f"no sphere of radius {radius:g} mm was found (radii found: {have}): was it in view, is the radius"
                " right?"
            )
        result.append(mine[0][0])
        found = [pair for pair in found if pair is not mine[0]]
    return result


def _faces(points: Floats, outward: Floats, light: Floats | None) -> Booleans:
    """Whether a surface with ``outward`` (N, 3) at points (N, 3) is seen and lit at less than a slant."""
    faces = np.ones(len(points), bool)
    for place in (np.zeros(3), light):
        if place is not None:
            way = points - place
            lengths = np.linalg.norm(outward, axis=1) * np.linalg.norm(way, axis=1)
            faces &= -np.sum(outward * way, axis=1) > LIMB * lengths
    return faces


def _as_sphere(points: Floats, radius: float, light: Floats | None) -> SphereFit | None:
    """The piece as a sphere of about that radius, without the parts that are seen or lit at a slant; None where it is
    none.
    """
    try:
        start = _consensus(points, radius)
        if start is None:
            return None
        used = points
        for _ in range(3):
            fit = fit_sphere(used, start)
            start = np.append(fit.centre, fit.radius)
            outward = points - fit.centre
            on_it = np.abs(np.linalg.norm(outward, axis=1) - fit.radius) < 0.2 * radius
            used = points[_faces(points, outward, light) & on_it]
        fit = fit_sphere(used, start)
    except MagtrakError:
        return None
    return fit if abs(fit.radius / radius - 1) < SIZE_TOLERANCE and fit.trimmed < MOST_TRIMMED else None


def _consensus(points: Floats, radius: float, tries: int = 200) -> Floats | None:
    """Of spheres through four points, the one of about the radius that most points lie on; None with too few."""
    rng = np.random.default_rng(2)
    some = points[rng.integers(len(points), size=min(len(points), 1000))]
    best, most = None, 0.4
    for _ in range(tries):
        four = points[rng.choice(len(points), 4, replace=False)]
        matrix = 2 * (four[1:] - four[0])
        if abs(np.linalg.det(matrix)) < 1e-3 * radius**3 / 50:
            continue
        square = np.sum(four * four, axis=1)
        centre = np.linalg.solve(matrix, square[1:] - square[0])
        size = float(np.linalg.norm(four[0] - centre))
        if abs(size / radius - 1) > 3 * SIZE_TOLERANCE:
            continue
        on_it = float(np.mean(np.abs(np.linalg.norm(some - centre, axis=1) - size) < 0.02 * radius))
        if on_it > most:
            best, most = np.append(centre, size), on_it
    return best


def find_cylinder(cloud: Records, radius: float) -> CylinderFit:
    """The cylinder of a nominal radius; :exc:`MagtrakError` where there is none."""
    points, light = positions(cloud), light_source(cloud)
    seen = []
    for piece in pieces(cloud):
        fit = _as_cylinder(points[piece], radius, light)
        if isinstance(fit, CylinderFit):
            return fit
        if fit:
            seen.append(fit)
    have = ", ".join(f"{size:.1f}" for size in seen) or "none"
    raise MagtrakError(
        f"no cylinder of radius {radius:g} mm was found (radii found: {have}): was it in view, is the radius right?"
    )


def _as_cylinder(points: Floats, radius: float, light: Floats | None) -> CylinderFit | float | None:
    """The piece as a cylinder, without ends and slanting parts; its radius where that is another; None for neither."""
    try:
        some = points[:: max(len(points) // ROUGHLY, 1)]
        start = _cylinder_consensus(some, radius)
        if start is None:
            fit = fit_cylinder(some)
            looks_round = fit.rms < 0.05 * radius and fit.radius < 3 * radius
            return fit.radius if looks_round and fit.trimmed < MOST_TRIMMED else None
        axis, on_it = start
        fit = fit_cylinder(some[on_it], axis)
        for _ in range(3):
            along = (points - fit.point) @ fit.axis
            low, high = np.percentile(along, [0.5, 99.5])
            end = AXIS_END * (high - low)
            outward = points - fit.point - along[:, None] * fit.axis
            size = np.linalg.norm(outward, axis=1)
            good = (
                (along > low + end)
                & (along < high - end)
                & _faces(points, outward, light)
                & (np.abs(size - fit.radius) < 0.2 * radius)
            )
            fit = fit_cylinder(points[good], fit.axis)
    except (MagtrakError, np.linalg.LinAlgError):
        return None
    off = abs(fit.radius / radius - 1)
    if fit.trimmed > MOST_TRIMMED or fit.rms > 0.05 * radius or off > 6 * SIZE_TOLERANCE:
        return None
    return fit if off < SIZE_TOLERANCE else fit.radius


def _cylinder_consensus(points: Floats, radius: float, tries: int = 500) -> tuple[Floats, Booleans] | None:
    """Of cylinders through two points and their normals, the one of about the radius that most points lie on: its axis,
    and those points; None with too few.

    A flat end in sight may have as many points as the side, or more, all with one normal: they tell an axis only
    together with what is round. Source: R. Schnabel, R. Wahl, R. Klein, "Efficient RANSAC for Point-Cloud Shape
    Detection", 2007.
    """
    rng = np.random.default_rng(3)
    normals = normals_of(points)
    first, second = rng.integers(len(points), size=(2, tries))
    n, m, way = normals[first], normals[second], points[second] - points[first]
    axes = np.cross(n, m)
    sine = np.linalg.norm(axes, axis=1)
    usable = sine > LEAST_TURN
    axes[usable] /= sine[usable, None]
    # In the plane across the axis both normals lead to its foot: s n = way + t m.
    s, t = (np.sum(np.cross(way, other) * axes, axis=1) / np.maximum(sine, LEAST_TURN) for other in (m, n))
    usable &= np.all(np.abs(np.abs([s, t]) / radius - 1) < 3 * SIZE_TOLERANCE, axis=0)
    best, most = None, LEAST_AROUND * len(points)
    for foot, axis in zip((points[first] + s[:, None] * n)[usable], axes[usable], strict=True):
        on_it = np.abs(np.linalg.norm(np.cross(points - foot, axis), axis=1) / radius - 1) < SIZE_TOLERANCE
        if on_it.sum() > most:
            best, most = (axis, on_it), on_it.sum()
    return best


def _inner(cloud: Records, piece: Integers) -> Integers:
    """Those points of a piece that have neighbours in it on all sides, :data:`BORDER` rows and frames away."""
    frame, row = cloud["scalar_frame"][piece].astype(np.int64), cloud["scalar_row"][piece].astype(np.int64)
    frame, row = frame - frame.min() + BORDER, row - row.min() + BORDER
    there = np.zeros((frame.max() + 1 + BORDER, row.max() + 1 + BORDER), bool)
    there[frame, row] = True
    inside = np.ones(len(piece), bool)
    for step in range(1, BORDER + 1):
        for across, down in ((step, 0), (-step, 0), (0, step), (0, -step)):
            inside &= there[frame + across, row + down]
    return piece[inside]


def find_planes(cloud: Records, flat: float = 0.01) -> list[PlaneFit]:
    """The pieces that are flat, the largest first: less than ``flat`` of their size deep, and nearly whole."""
    points = positions(cloud)
    result = []
    for piece in pieces(cloud):
        try:
            fit = fit_plane(points[_inner(cloud, piece)])
        except MagtrakError:
            continue
        size = float(np.linalg.norm(np.ptp(points[piece], axis=0)))
        if fit.rms < flat * size and fit.trimmed < MOST_TRIMMED:
            result.append(fit)
    return result
