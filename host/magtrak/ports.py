"""Flat ports under water: rays that leave air through a pane of glass into water, and back.

A ray through a flat port bends twice, in the plane of the ray and the port's normal, and the sine of its angle to the
normal, times the index, is the same in air, glass and water. Rays of a camera behind a port no longer meet in one
point, and a plane of laser light becomes a curved sheet whose shape depends on where its fan starts.

The camera's port is described in the camera frame C, the laser's in the laser frame L, which does not turn with the
plane: ``normal . P = distance`` is the inner face, the normal points into the water. Light is taken as of one colour.

Source: A. Agrawal, S. Ramalingam, Y. Taguchi, V. Chari, "A theory of multi-layer flat refractive geometry", CVPR 2012,
for the camera; the sheet is a fan of such rays.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Booleans, Floats
from .camera import CameraModel
from .checked import Checked
from .laser import Laser
from .triangulate import MIN_SINE, Triangulated

WATER = 1.333
"""Index of fresh water at 20 degrees for green light; sea water has about 1.34."""

ACRYLIC = 1.49

MAX_STEPS = 60
TOLERANCE = 1e-13
TYPICAL_MM = 1500.0  # where the search for a point begins
FAR_MM = 1e5
SMALL_RAD = 1e-5


@dataclass(frozen=True)
class Port:
    """A flat pane.

    Parameters
    ----------
    distance_mm : from the origin of its frame to the inner face, along the normal
    normal : (3,) unit vector from air to water
    thickness_mm, glass_index : of the pane
    """

    distance_mm: float
    normal: Floats
    thickness_mm: float = 0.0
    glass_index: float = ACRYLIC

    def leave(self, start: Floats, directions: Floats, water_index: float) -> tuple[Floats, Floats]:
        """Where rays in air from ``start`` (3,) or (N, 3) along unit vectors (N, 3) enter the water, and the unit
        vectors (N, 3) along which they go on.

        NaN for rays that do not go towards the port.
        """
        cosine = directions @ self.normal
        cosine = np.where(cosine > 0, cosine, np.nan)
        inner = start + directions * ((self.distance_mm - start @ self.normal) / cosine)[..., None]
        in_glass = _bend(directions, self.normal, cosine, self.glass_index)
        outer = inner + in_glass * (self.thickness_mm / (in_glass @ self.normal))[..., None]
        return outer, _bend(directions, self.normal, cosine, water_index)

    def reach(self, start: Floats, points: Floats, water_index: float) -> Floats:
        """Unit directions in air (N, 3) of the rays from ``start``, (3,) or (N, 3), that reach points (N, 3) in water.

        With q the tangent in air, and a, t, w the thickness of air, glass and water, the ray ends
        ``a q + t q / sqrt(g^2 + (g^2 - 1) q^2) + w q / sqrt(n^2 + (n^2 - 1) q^2)`` from the normal through its start.
        That is increasing and concave in q, so that Newton's method rises from a lower bound to the one solution.
        NaN for points that are not in the water.
        """
        way = points - start
        along = way @ self.normal
        aside = way - along[:, None] * self.normal
        radius = np.linalg.norm(aside, axis=1)
        air = np.broadcast_to(self.distance_mm - start @ self.normal, radius.shape)
        wet = along - air - self.thickness_mm
        usable = (wet > 0) & (air > 0)
        air, wet = np.where(usable, air, 1.0), np.where(usable, wet, 1.0)
        g, n, t = self.glass_index, water_index, self.thickness_mm
        q = radius / (air + t / g + wet / n)
        for _ in range(MAX_STEPS):
            in_glass, in_water = g * g + (g * g - 1) * q * q, n * n + (n * n - 1) * q * q
            reached = q * (air + t / np.sqrt(in_glass) + wet / np.sqrt(in_water))
            slope = air + t * g * g * in_glass**-1.5 + wet * n * n * in_water**-1.5
            step = (radius - reached) / slope
            q = q + step
            if np.all(np.abs(step) <= TOLERANCE * (1 + q)):
                break
        towards = aside / np.where(radius > 0, radius, 1.0)[:, None]
        directions = _unit(self.normal + q[:, None] * towards)
        return np.where(usable[:, None], directions, np.nan)


class PortCamera:
    """A camera behind a flat port: the interface of :class:`magtrak.camera.CameraModel`, in water.

    Parameters
    ----------
    camera : in air; its rays meet in ``camera.centre``
    port : in the camera frame
    water_index : of the water
    """

    def __init__(self, camera: CameraModel, port: Port, water_index: float) -> None:
        self.camera, self.port, self.water_index = camera, port, water_index
        self.centre = camera.centre

    def ray(self, u: Floats, v: Floats) -> Floats:
        return self.rays(u, v)[1]

    def project(self, points: Floats) -> Floats:
        directions = self.port.reach(self.centre, np.asarray(points, dtype=np.float64), self.water_index)
        return self.camera.project(self.centre + 1000.0 * directions)

    def rays(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Where the rays of pixels enter the water, and their unit directions there; (N, 3) each."""
        return self.port.leave(self.centre, self.camera.ray(u, v), self.water_index)


@dataclass(frozen=True)
class Ports:
    """All that water changes.

    Parameters
    ----------
    camera : port in the camera frame
    laser : port in the laser frame
    apex_beam_mm, apex_axis_mm : where the fan starts at alpha = 0: X_L and Z_L of a point of the plane
    water_index : of the water
    """

    camera: Port
    laser: Port
    apex_beam_mm: float = 0.0
    apex_axis_mm: float = 0.0
    water_index: float = WATER

    @classmethod
    def parse(cls, table: Checked) -> "Ports":
        """From the section ``ports`` of a calibration file; its errors name what is wrong."""
        laser = table.section("laser")
        return cls(
            _port(table.section("camera")),
            _port(laser),
            laser.number("apex_beam_mm", -1000, 1000, 0.0),
            laser.number("apex_axis_mm", -1000, 1000, 0.0),
            table.number("water_index", 1, 2, WATER),
        )

    def as_dict(self) -> dict[str, Any]:
        """What :meth:`parse` reads."""
        laser = _written(self.laser) | {"apex_beam_mm": self.apex_beam_mm, "apex_axis_mm": self.apex_axis_mm}
        return {"camera": _written(self.camera), "laser": laser, "water_index": self.water_index}


class Sheet:
    """The laser's light in water: for each angle a fan of rays that start at one point and bend at the port.

    Parameters
    ----------
    laser, ports : of the calibration
    """

    def __init__(self, laser: Laser, ports: Ports) -> None:
        self.laser, self.ports = laser, ports
        cosine, sine = np.cos(laser.tilt_rad), np.sin(laser.tilt_rad)
        # At alpha = 0: two directions in the plane, and the fan's start on it.
        self._along, self._across = np.array([1.0, 0.0, 0.0]), np.array([0.0, -sine, cosine])
        y = (laser.offset_mm - sine * ports.apex_axis_mm) / cosine
        self._apex = np.array([ports.apex_beam_mm, y, ports.apex_axis_mm])

    def rays(self, alpha: Floats, phi: Floats) -> tuple[Floats, Floats]:
        """Where the rays at fan angles ``phi`` (N,) of the sheets ``alpha`` (N,) enter the water, and their unit
        directions there, in C. phi is 0 across the axis, in the plane.
        """
        flat = np.cos(phi)[:, None] * self._along + np.sin(phi)[:, None] * self._across
        starts = _turn(np.broadcast_to(self._apex, flat.shape), alpha)
        points, directions = self.ports.laser.leave(starts, _turn(flat, alpha), self.ports.water_index)
        pose = self.laser.camera_from_laser
        return points @ pose[:3, :3].T + pose[:3, 3], directions @ pose[:3, :3].T

    def meet(self, starts: Floats, directions: Floats, alpha: Floats, min_sine: float = MIN_SINE) -> Triangulated:
        """Where rays in water, from (N, 3) along unit vectors (N, 3), meet the sheets ``alpha`` (N,).

        Newton's method in the fan angle and the way along the fan's ray: the sight ray meets the plane that touches the
        sheet, and the point where it does gives the next fan angle and way.
        """
        phi = np.zeros_like(alpha)
        way = np.full_like(alpha, TYPICAL_MM)
        with np.errstate(divide="ignore", invalid="ignore"):
            for _ in range(MAX_STEPS):
                points, light, tangent = self._touch(alpha, phi, way)
                normal = np.cross(tangent, light)
                square = np.einsum("ij,ij->i", normal, normal)
                across = np.einsum("ij,ij->i", normal, directions)
                distance = np.einsum("ij,ij->i", normal, points - starts) / across
                miss = starts + distance[:, None] * directions - points
                turn = np.einsum("ij,ij->i", np.cross(miss, light), normal) / square
                onward = np.einsum("ij,ij->i", np.cross(tangent, miss), normal) / square
                phi = phi + np.clip(turn, -0.2, 0.2)
                way = np.clip(way + onward, 1.0, FAR_MM)
                if not np.any(np.abs(turn) + np.abs(onward) / TYPICAL_MM > 1e-11):
                    break
            sine = np.abs(across) / np.sqrt(square)
            crossing = (sine >= min_sine) & (np.linalg.norm(miss, axis=1) < 1e-6)
        valid: Booleans = crossing & (distance > 0)
        found = np.where(valid[:, None], starts + distance[:, None] * directions, np.nan)
        return Triangulated(found, valid, int((~crossing).sum()), int((crossing & ~valid).sum()))

    def _touch(self, alpha: Floats, phi: Floats, way: Floats) -> tuple[Floats, Floats, Floats]:
        """A point of each sheet, and the two directions in which the sheet goes on there: a unit vector along its ray,
        and the way to the next ray, mm per rad.
        """
        start, light = self.rays(alpha, phi)
        left, right = (self.rays(alpha, phi + side) for side in (-SMALL_RAD, SMALL_RAD))
        tangent = (right[0] - left[0] + way[:, None] * (right[1] - left[1])) / (2 * SMALL_RAD)
        return start + way[:, None] * light, light, tangent


def _bend(directions: Floats, normal: Floats, cosine: Floats, index: float) -> Floats:
    """Unit vectors in air, at ``cosine`` to the normal, as they go on in another medium (Snell's law as vectors)."""
    onward = np.sqrt(1 - (1 - cosine**2) / index**2)
    return np.asarray(directions / index + (onward - cosine / index)[..., None] * normal)


def _turn(vectors: Floats, alpha: Floats) -> Floats:
    """Vectors (N, 3) turned about Z by angles (N,)."""
    c, s = np.cos(alpha), np.sin(alpha)
    x, y, z = vectors.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def _unit(vectors: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _port(table: Checked) -> Port:
    normal = table.array("normal", (3,))
    if not 0.999 < np.linalg.norm(normal) < 1.001:
        table.refuse("normal", "a vector of length 1 that points into the water")
    return Port(
        table.number("distance_mm", 0, 10_000),
        _unit(normal),
        table.number("thickness_mm", 0, 1000, 0.0),
        table.number("glass_index", 1, 3, ACRYLIC),
    )


def _written(port: Port) -> dict[str, Any]:
    return {
        "distance_mm": port.distance_mm,
        "normal": port.normal.tolist(),
        "thickness_mm": port.thickness_mm,
        "glass_index": port.glass_index,
    }
