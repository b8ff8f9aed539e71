"""Camera and laser of the simulated rig: where the truth comes from.

This code shares nothing with the host's geometry, so that an error in one does not cancel in the other.
"""

from dataclasses import dataclass
from math import hypot
from typing import Any

import numpy as np
import numpy.typing as npt

from .surfaces import Floats


@dataclass(frozen=True)
class Camera:
    """A pinhole with Brown-Conrady distortion, as OpenCV defines it.

    Parameters
    ----------
    width, height : px
    matrix : 3 x 3; the centre of the first pixel is (0, 0)
    distortion : k1, k2, p1, p2 [, k3 [, k4, k5, k6]]
    noise : standard deviation of a pixel, grey levels
    gain : factor on all light
    black_level : grey levels without light
    blur_px : sigma of the picture of a point, out of focus or not
    """

    width: int
    height: int
    matrix: tuple[tuple[float, ...], ...]
    distortion: tuple[float, ...]
    noise: float
    gain: float
    black_level: float
    blur_px: float = 0.0

    def rays(self, u: npt.ArrayLike, v: npt.ArrayLike) -> Floats:
        """(N, 3) directions with Z = 1 that fall on the distorted pixel positions (N,), (N,)."""
        m = self.matrix
        y = (np.asarray(v, dtype=np.float64) - m[1][2]) / m[1][1]
        x = (np.asarray(u, dtype=np.float64) - m[0][2] - m[0][1] * y) / m[0][0]
        goal = np.stack([x, y], axis=-1)
        p = goal.copy()
        # Newton, with a numerical slope: quadratic, so that eight steps are plenty for any usable lens.
        small = 1e-6
        for _ in range(8):
            here = self._distort(p)
            along_x = (self._distort(p + np.array([small, 0.0])) - here) / small
            along_y = (self._distort(p + np.array([0.0, small])) - here) / small
            error = goal - here
            det = along_x[..., 0] * along_y[..., 1] - along_x[..., 1] * along_y[..., 0]
            p[..., 0] += (error[..., 0] * along_y[..., 1] - error[..., 1] * along_y[..., 0]) / det
            p[..., 1] += (along_x[..., 0] * error[..., 1] - along_x[..., 1] * error[..., 0]) / det
            if np.abs(error).max(initial=0.0) < 1e-12:
                break
        return np.concatenate([p, np.ones((*p.shape[:-1], 1))], axis=-1)

    def project(self, points: npt.ArrayLike) -> Floats:
        """(N, 2) distorted pixel positions of (N, 3) points before the camera."""
        p = np.asarray(points, dtype=np.float64)
        x = self._distort(p[..., :2] / p[..., 2:])
        m = np.asarray(self.matrix)
        return np.asarray(x @ m[:2, :2].T + m[:2, 2])

    def _distort(self, p: Floats) -> Floats:
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, *([0.0] * (8 - len(self.distortion))))
        x, y = p[..., 0], p[..., 1]
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return np.stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=-1,
        )


@dataclass(frozen=True)
class Laser:
    """A sheet of light that turns about an axis.

    The light leaves the origin of the laser frame L as a fan along +X_L at alpha = 0. Across the sheet it is
    Gaussian, with ``sigma = hypot(waist, divergence * range)``.

    Parameters
    ----------
    camera_from_laser : 4 x 4, from L to the camera frame, mm
    offset_mm, tilt_rad : the plane is n . P = offset, n = Rz(alpha) (0, cos tilt, sin tilt)
    zero_rad, sense : alpha = sense * motor angle + zero
    peak : grey levels of the brightest channel at the line's middle, on a white surface that faces the laser at
        ``reference_mm``, with gain 1
    reference_mm : see peak
    waist_mm, divergence_rad : see above
    response : R, G, B of the camera for the laser's wavelength, the greatest 1; what leaks into the other channels
        turns an over-exposed core white
    speckle : contrast of the light of a pixel
    """

    camera_from_laser: tuple[tuple[float, ...], ...]
    offset_mm: float
    tilt_rad: float
    zero_rad: float
    sense: int
    peak: float
    reference_mm: float
    waist_mm: float
    divergence_rad: float
    response: tuple[float, ...]
    speckle: float

    @property
    def origin(self) -> Floats:
        """Where the fan starts, in the camera frame."""
        return np.asarray(self.camera_from_laser)[:3, 3]

    def points(self, points: Floats) -> Floats:
        """(N, 3) points of the camera frame in L."""
        pose = np.asarray(self.camera_from_laser)
        return np.asarray((points - pose[:3, 3]) @ pose[:3, :3])

    def alpha(self, motor_rad: npt.ArrayLike) -> Floats:
        """Angle of the plane for angles of the motor."""
        return np.asarray(self.sense * np.asarray(motor_rad, dtype=np.float64) + self.zero_rad)

    def meets(self, points: Floats) -> tuple[Floats, Floats]:
        """The alpha at which the plane goes through each of (N, 3) points in L, and how many mm it moves there per rad.

        Points that the plane never reaches (inside its cone or near the axis) get a speed of 0. Alpha is
        continuous but for a cut opposite to the points' mean direction.
        """
        phi = np.arctan2(points[:, 1], points[:, 0])
        middle = np.arctan2(np.sin(phi).mean(), np.cos(phi).mean())
        phi = middle + np.mod(phi - middle + np.pi, 2 * np.pi) - np.pi
        # n . P = cos(tilt) rho sin(phi - alpha) + sin(tilt) Z; the emitter's half has |phi - alpha| < pi / 2.
        rho = np.cos(self.tilt_rad) * np.hypot(points[:, 0], points[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            sine = (self.offset_mm - np.sin(self.tilt_rad) * points[:, 2]) / rho
            reached = np.abs(sine) < 1
            lead = np.arcsin(np.where(reached, sine, 0.0))
        return phi - lead, np.where(reached, rho * np.cos(lead), 0.0)

    def sigma_mm(self, range_mm: npt.ArrayLike) -> Floats:
        """Half width of the sheet at a distance from its origin."""
        return np.asarray(np.hypot(self.waist_mm, self.divergence_rad * np.asarray(range_mm, dtype=np.float64)))

    def level(self, range_mm: npt.ArrayLike) -> Floats:
        """Grey levels of the brightest channel in the sheet's middle, on white that faces the laser.

        The fan thins the light with the range, and the sheet's width thins it once more.
        """
        r = np.asarray(range_mm, dtype=np.float64)
        reference = hypot(self.waist_mm, self.divergence_rad * self.reference_mm)
        return np.asarray(self.peak * (self.reference_mm / r) * (reference / self.sigma_mm(r)))


def calibration(camera: Camera, laser: Laser, counts_per_turn: int, time_offset_s: float) -> dict[str, Any]:
    """The rig as an ideal calibration would find it, in the format of calibration files."""
    return {
        "format": "magtrak-calibration",
        "version": 1,
        "camera": {
            "model": "brown-conrady",
            "width": camera.width,
            "height": camera.height,
            "time_offset_s": time_offset_s,
            "matrix": [list(row) for row in camera.matrix],
            "distortion": list(camera.distortion),
        },
        "laser": {
            "camera_from_laser": [list(row) for row in laser.camera_from_laser],
            "offset_mm": laser.offset_mm,
            "tilt_rad": laser.tilt_rad,
            "zero_rad": laser.zero_rad,
            "sense": laser.sense,
            "counts_per_turn": counts_per_turn,
        },
    }
