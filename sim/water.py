"""Water around the rig: camera and laser look through flat panes, and the water dims and scatters.

The way of light is found by Fermat's principle where both ends are known, and by Snell's law for angles where one end
and the direction are. The host solves the same by other means, so that an error in one does not cancel in the other.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .optics import Laser
from .surfaces import Floats

STEPS = 30
RADIUS_MM = 1e-7
"""Within this the quickest way is found; the angles are within a hundredth of it per metre."""

ANGLE_RAD = 1e-10
NUDGE_MM = 0.5


@dataclass(frozen=True)
class Pane:
    """A flat port.

    Parameters
    ----------
    distance_mm : from the origin of its frame to the inner face, along the normal
    normal : towards the water
    thickness_mm, index : of the glass
    """

    distance_mm: float
    normal: tuple[float, ...]
    thickness_mm: float
    index: float

    def through(self, directions: Floats, water: float) -> tuple[Floats, Floats]:
        """Where rays (N, 3) from the origin enter the water, and their unit directions there."""
        n = np.asarray(self.normal)
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        in_air = np.arccos(np.clip(unit @ n, -1, 1))
        aside = unit - np.cos(in_air)[:, None] * n
        aside /= np.maximum(np.sin(in_air), 1e-300)[:, None]
        in_glass, in_water = np.arcsin(np.sin(in_air) / self.index), np.arcsin(np.sin(in_air) / water)
        radius = self.distance_mm * np.tan(in_air) + self.thickness_mm * np.tan(in_glass)
        start = (self.distance_mm + self.thickness_mm) * n + radius[:, None] * aside
        return start, np.cos(in_water)[:, None] * n + np.sin(in_water)[:, None] * aside

    def quickest(
        self, sources: Floats, points: Floats, water: float, near: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Where the quickest way from sources (N, 3) in air to points (N, 3) in water crosses the two faces.

        The time is a convex function of the two radii at which it does: Newton's method from the straight line, or from
        the radii ``near`` (2, N), which come back as the third result.
        """
        n = np.asarray(self.normal)
        way = points - sources
        depth = way @ n
        aside = way - depth[:, None] * n
        radius = np.linalg.norm(aside, axis=1)
        air = self.distance_mm - sources @ n
        glass = max(self.thickness_mm, 1e-6)
        wet = np.maximum(depth - air - glass, 1e-6)
        first, second = radius * np.stack([air, air + glass]) / (air + glass + wet) if near is None else near
        for _ in range(STEPS):
            (a, da), (b, db), (c, dc) = (
                _hurry(air, first, 1.0),
                _hurry(glass, second - first, self.index),
                _hurry(wet, radius - second, water),
            )
            g1, g2 = a - b, b - c
            det = (da + db) * (db + dc) - db * db
            step1 = ((db + dc) * g1 + db * g2) / det
            step2 = (db * g1 + (da + db) * g2) / det
            first, second = first - step1, second - step2
            if max(np.abs(step1).max(initial=0.0), np.abs(step2).max(initial=0.0)) < RADIUS_MM:
                break
        aside /= np.maximum(radius, 1e-300)[:, None]
        base = sources + air[:, None] * n
        return base + first[:, None] * aside, base + glass * n + second[:, None] * aside, np.stack([first, second])


def _hurry(thick: Floats | float, wide: Floats, index: float) -> tuple[Floats, Floats]:
    """First and second derivative of the time through a layer by the way aside."""
    square = thick * thick + wide * wide
    slowness = index / np.sqrt(square)
    return slowness * wide, slowness * (thick * thick) / square


@dataclass(frozen=True)
class Water:
    """The water and the ports.

    Parameters
    ----------
    index : of the water
    camera : pane in the camera's frame
    laser : pane in the laser's frame
    apex_beam_mm, apex_axis_mm : where the fan starts at alpha = 0, along X_L and Z_L
    attenuation_per_m : of red, green and blue light, exp(-attenuation * way)
    veil : part of the room's light that endless water sends back, red, green and blue
    scatter_mrad : by which the sheet widens, beside its own divergence
    glow : grey levels of the brightest channel that the sheet's light scatters back where it crosses the sight at 1 m
    """

    index: float
    camera: Pane
    laser: Pane
    apex_beam_mm: float
    apex_axis_mm: float
    attenuation_per_m: tuple[float, ...]
    veil: tuple[float, ...]
    scatter_mrad: float
    glow: float

    def sight(self, directions: Floats) -> tuple[Floats, Floats]:
        """Starts and unit directions in the water of rays (N, 3) of the camera."""
        return self.camera.through(directions, self.index)

    def dimmed(self, light: Floats, way_mm: Floats) -> Floats:
        """What is left of light (N, 3) after ways (N,), with what the water on them sends back of the room's light."""
        kept = np.exp(-np.asarray(self.attenuation_per_m) * way_mm[:, None] / 1000)
        return np.asarray(light * kept + np.asarray(self.veil) * (1 - kept))

    def laser_kept(self, laser: Laser, way_mm: Floats) -> Floats:
        """Part of the laser's light that is left after ways (N,)."""
        per_m = self.attenuation_per_m[int(np.argmax(laser.response))]
        return np.asarray(np.exp(-per_m * way_mm / 1000))

    def meets(self, laser: Laser, points: Floats) -> tuple[Floats, Floats, Floats]:
        """For points (N, 3) of the camera's frame: alpha of the sheet through each, mm by which it moves there per rad,
        and (N, 3) where its light enters the water.

        The speed is 0 where the sheet does not get to.
        """
        pose = np.asarray(laser.camera_from_laser)
        local = laser.points(points)
        start, _ = laser.meets(local)
        alpha, exits, radii = self._alpha(laser, local, start, None, 6)
        # The sheet's normal lies across the ray, and nearly across the axis.
        across = np.cross(np.array([0.0, 0.0, 1.0]), local - exits)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        # The derivatives along both directions across a ray that is nearly across the axis.
        beside = self._alpha(laser, local + NUDGE_MM * across, alpha, radii, 2)[0]
        along = self._alpha(laser, local + NUDGE_MM * np.array([0.0, 0.0, 1.0]), alpha, radii, 2)[0]
        gradient = np.hypot(beside - alpha, along - alpha) / NUDGE_MM
        inside = (local - exits) @ np.asarray(self.laser.normal) > 0
        with np.errstate(divide="ignore"):
            speed = np.where(inside & np.isfinite(gradient) & (gradient > 0), 1 / gradient, 0.0)
        return alpha, speed, exits @ pose[:3, :3].T + pose[:3, 3]

    def _alpha(
        self, laser: Laser, points: Floats, alpha: Floats, radii: Floats | None, rounds: int
    ) -> tuple[Floats, Floats, Floats]:
        """Angles of the sheets through points of L, where the light leaves the glass, and its radii at the faces.

        The start of the fan turns with the sheet by a little; the direction in which it has to shine tells the angle.
        """
        cosine, sine = np.cos(laser.tilt_rad), np.sin(laser.tilt_rad)
        x, z = self.apex_beam_mm, self.apex_axis_mm
        y = (laser.offset_mm - sine * z) / cosine
        for _ in range(rounds):
            c, s = np.cos(alpha), np.sin(alpha)
            apex = np.stack([c * x - s * y, s * x + c * y, np.full_like(alpha, z)], axis=1)
            inner, exits, radii = self.laser.quickest(apex, points, self.index, radii)
            shine = inner - apex
            rho = np.hypot(shine[:, 0], shine[:, 1])
            # n . shine = 0 with n = (-cos t sin a, cos t cos a, sin t).
            lead = np.arcsin(np.clip(-sine * shine[:, 2] / (cosine * rho), -1, 1))
            before, alpha = alpha, np.arctan2(shine[:, 1], shine[:, 0]) - lead
            alpha = before + np.mod(alpha - before + np.pi, 2 * np.pi) - np.pi
            if np.abs(alpha - before).max(initial=0.0) < ANGLE_RAD:
                break
        assert radii is not None
        return alpha, exits, radii

    def calibration(self) -> dict[str, Any]:
        """The section ``ports`` of the calibration file."""

        def port(pane: Pane) -> dict[str, Any]:
            known = {"distance_mm": pane.distance_mm, "normal": list(pane.normal)}
            return known | {"thickness_mm": pane.thickness_mm, "glass_index": pane.index}

        laser = port(self.laser) | {"apex_beam_mm": self.apex_beam_mm, "apex_axis_mm": self.apex_axis_mm}
        return {"camera": port(self.camera), "laser": laser, "water_index": self.index}
