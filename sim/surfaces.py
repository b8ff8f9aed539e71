"""Ideal surfaces that a scene is made of: where rays hit them, and how far points lie from them.

Lengths are millimetres. A surface stands in its own frame; ``pose`` is the 4 x 4 matrix that takes
points of that frame to the scene's (the camera's). Rays are ``origin + t * direction`` with ``t > 0``;
directions need not have unit length.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

FACES_MAX = 8
"""Face f of surface s in a scene has the number ``s * FACES_MAX + f``."""

_NEAR = 1e-9  # hits nearer than this part of a direction are where the ray starts


@dataclass(frozen=True)
class Hits:
    """Where N rays hit.

    Members
    -------
    t : (N,) distance in units of the direction's length, infinite where nothing is hit
    face : (N,) number of the face, -1 where nothing is hit
    normal : (N, 3) unit normal on the side that the ray comes from, 0 where nothing is hit
    """

    t: Floats
    face: Ints
    normal: Floats


class Surface(ABC):
    """A surface with a pose.

    Parameters
    ----------
    pose : 4 x 4 rigid transformation from the surface's frame to the scene's
    """

    def __init__(self, pose: npt.ArrayLike | None = None) -> None:
        self.pose: Floats = np.eye(4) if pose is None else np.asarray(pose, dtype=np.float64)
        if self.pose.shape != (4, 4):
            raise ValueError(f"a pose is a 4 x 4 matrix, not {self.pose.shape}")
        if not np.allclose(self.pose[:3, :3] @ self.pose[:3, :3].T, np.eye(3), atol=1e-6):
            raise ValueError("the upper left 3 x 3 part of a pose has to be a rotation")

    def intersect(self, origin: npt.ArrayLike, directions: npt.ArrayLike) -> Hits:
        """Nearest hits of N rays that start at one point (3,) or at N points (N, 3)."""
        rotation, shift = self.pose[:3, :3], self.pose[:3, 3]
        d = np.asarray(directions, dtype=np.float64) @ rotation
        o = np.broadcast_to((np.asarray(origin, dtype=np.float64) - shift) @ rotation, d.shape)
        # Rays parallel to a face divide by zero; the infinities sort themselves out as misses.
        with np.errstate(divide="ignore", invalid="ignore"):
            t, face, normal = self._intersect(o, d)
        hit = np.isfinite(t)
        normal = np.where(np.sum(normal * d, axis=1, keepdims=True) > 0, -normal, normal)
        return Hits(t, np.where(hit, face, -1), np.where(hit[:, None], normal, 0.0) @ rotation.T)

    def distance(self, points: npt.ArrayLike) -> Floats:
        """Distance of (N, 3) points to the nearest point of the surface, not negative."""
        p = np.asarray(points, dtype=np.float64)
        return self._distance((p - self.pose[:3, 3]) @ self.pose[:3, :3])

    @abstractmethod
    def _intersect(self, o: Floats, d: Floats) -> tuple[Floats, Ints, Floats]:
        """Distance, face and normal (either sign) in the surface's own frame."""

    @abstractmethod
    def _distance(self, p: Floats) -> Floats: ...


def _positive(what: str, *values: float) -> None:
    for value in values:
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{what} has to be positive, not {value}")


class Plane(Surface):
    """The plane z = 0, or the rectangle of it with the given width (x) and height (y). One face."""

    def __init__(self, size: tuple[float, float] | None = None, pose: npt.ArrayLike | None = None) -> None:
        super().__init__(pose)
        if size is not None:
            _positive("the size of a plane", *size)
        self.size = size

    def _intersect(self, o: Floats, d: Floats) -> tuple[Floats, Ints, Floats]:
        t = -o[:, 2] / d[:, 2]
        ok = t > _NEAR
        if self.size is not None:
            p = o[:, :2] + t[:, None] * d[:, :2]
            ok &= np.all(np.abs(p) <= np.asarray(self.size) / 2, axis=1)
        normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), o.shape)
        return np.where(ok & np.isfinite(t), t, np.inf), np.zeros(len(o), np.int64), normal

    def _distance(self, p: Floats) -> Floats:
        if self.size is None:
            return np.abs(p[:, 2])
        beside = np.maximum(np.abs(p[:, :2]) - np.asarray(self.size) / 2, 0)
        return np.asarray(np.hypot(np.hypot(beside[:, 0], beside[:, 1]), p[:, 2]))


class Box(Surface):
    """A box about the origin. Faces -x, +x, -y, +y, -z, +z are 0 to 5."""

    def __init__(self, size: tuple[float, float, float], pose: npt.ArrayLike | None = None) -> None:
        super().__init__(pose)
        _positive("the size of a box", *size)
        self.size = size

    def _intersect(self, o: Floats, d: Floats) -> tuple[Floats, Ints, Floats]:
        half = np.asarray(self.size) / 2
        a, b = (-half - o) / d, (half - o) / d
        enter, leave = np.minimum(a, b), np.maximum(a, b)
        t_in, t_out = enter.max(axis=1), leave.min(axis=1)
        outside = t_in > _NEAR
        t = np.where(outside, t_in, t_out)
        axis = np.where(outside, enter.argmax(axis=1), leave.argmin(axis=1))
        every = np.arange(len(o))
        # Entering along +d meets the negative face, leaving the positive one.
        upper = (d[every, axis] > 0) != outside
        normal = np.zeros_like(o)
        normal[every, axis] = 1.0
        ok = (t_in <= t_out) & (t > _NEAR)
        return np.where(ok, t, np.inf), (2 * axis + upper).astype(np.int64), normal

    def _distance(self, p: Floats) -> Floats:
        return _shell(np.abs(p) - np.asarray(self.size) / 2)


class Cylinder(Surface):
    """A closed cylinder about the y axis. Faces: 0 side, 1 cap at -y, 2 cap at +y."""

    def __init__(self, radius: float, height: float, pose: npt.ArrayLike | None = None) -> None:
        super().__init__(pose)
        _positive("the radius of a cylinder", radius)
        _positive("the height of a cylinder", height)
        self.radius = radius
        self.height = height

    def _intersect(self, o: Floats, d: Floats) -> tuple[Floats, Ints, Floats]:
        half = self.height / 2
        a = d[:, 0] ** 2 + d[:, 2] ** 2
        b = o[:, 0] * d[:, 0] + o[:, 2] * d[:, 2]
        c = o[:, 0] ** 2 + o[:, 2] ** 2 - self.radius**2
        root = np.sqrt(b * b - a * c)  # not a number where the ray misses: comparisons below are false
        best = np.full(len(o), np.inf)
        face = np.zeros(len(o), np.int64)
        for t in ((-b - root) / a, (-b + root) / a):
            ok = (t > _NEAR) & (np.abs(o[:, 1] + t * d[:, 1]) <= half) & (t < best)
            best = np.where(ok, t, best)
        for number, y in ((1, -half), (2, half)):
            t = (y - o[:, 1]) / d[:, 1]
            inside = np.hypot(o[:, 0] + t * d[:, 0], o[:, 2] + t * d[:, 2]) <= self.radius
            ok = (t > _NEAR) & inside & (t < best)
            best, face = np.where(ok, t, best), np.where(ok, number, face)
        p = o + np.where(np.isfinite(best), best, 0.0)[:, None] * d
        side = p * np.array([1.0, 0.0, 1.0]) / self.radius
        normal = np.where((face == 0)[:, None], side, np.array([0.0, 1.0, 0.0]))
        return best, face, normal

    def _distance(self, p: Floats) -> Floats:
        across = np.hypot(p[:, 0], p[:, 2]) - self.radius
        return _shell(np.stack([across, np.abs(p[:, 1]) - self.height / 2], axis=1))


class Sphere(Surface):
    """A sphere about the origin. One face."""

    def __init__(self, radius: float, pose: npt.ArrayLike | None = None) -> None:
        super().__init__(pose)
        _positive("the radius of a sphere", radius)
        self.radius = radius

    def _intersect(self, o: Floats, d: Floats) -> tuple[Floats, Ints, Floats]:
        a = np.sum(d * d, axis=1)
        b = np.sum(o * d, axis=1)
        root = np.sqrt(b * b - a * (np.sum(o * o, axis=1) - self.radius**2))
        first, second = (-b - root) / a, (-b + root) / a
        t = np.where(first > _NEAR, first, second)
        t = np.where(t > _NEAR, t, np.inf)
        normal = (o + np.where(np.isfinite(t), t, 0.0)[:, None] * d) / self.radius
        return t, np.zeros(len(o), np.int64), normal

    def _distance(self, p: Floats) -> Floats:
        return np.asarray(np.abs(np.linalg.norm(p, axis=1) - self.radius))


def _shell(q: Floats) -> Floats:
    """Distance to the shell of a body whose walls the point is ``q`` beyond (negative: inside)."""
    outside = np.linalg.norm(np.maximum(q, 0.0), axis=1)
    return np.asarray(np.abs(outside + np.minimum(q.max(axis=1), 0.0)))


def nearest(surfaces: Sequence[Surface], origin: npt.ArrayLike, directions: Floats) -> Hits:
    """Nearest hits on any of the surfaces; faces have their numbers in the scene (:data:`FACES_MAX`)."""
    count = len(directions)
    best = Hits(np.full(count, np.inf), np.full(count, -1, np.int64), np.zeros((count, 3)))
    for number, surface in enumerate(surfaces):
        hits = surface.intersect(origin, directions)
        nearer = hits.t < best.t
        best = Hits(
            np.where(nearer, hits.t, best.t),
            np.where(nearer, number * FACES_MAX + hits.face, best.face),
            np.where(nearer[:, None], hits.normal, best.normal),
        )
    return best


def visible(surfaces: Sequence[Surface], origin: npt.ArrayLike, points: Floats) -> npt.NDArray[np.bool_]:
    """Whether nothing stands between ``origin`` and each of the (N, 3) points of surfaces.

    The last 1e-6 of the way is not looked at, so that no point hides behind its own rounding.
    """
    directions = points - np.asarray(origin, dtype=np.float64)
    free = np.ones(len(points), dtype=np.bool_)
    for surface in surfaces:
        free &= ~(surface.intersect(origin, directions).t < 1 - 1e-6)
    return free


def distance(surfaces: Sequence[Surface], points: npt.ArrayLike) -> Floats:
    """Distance of (N, 3) points to the nearest point of any surface."""
    if not surfaces:
        raise ValueError("there is no surface to measure the distance to")
    return np.asarray(np.min([surface.distance(points) for surface in surfaces], axis=0))
