"""Camera models: pixels to rays and back.

Camera frame C: X right, Y down, Z forward, millimetres. Pixel (0, 0) is the centre of the first pixel, as in OpenCV.
"""

from typing import Protocol

import numpy as np

from .arrays import Floats
from .errors import CalibrationError


class CameraModel(Protocol):
    """What the triangulation needs of a camera.

    Attributes
    ----------
    centre : point of C in which all rays meet, (3,), mm (behind a port, :mod:`magtrak.ports`, they do so in air only)
    """

    centre: Floats

    def direction(self, u: Floats, v: Floats) -> Floats:
        """Vectors (N, 3) of any length from the centre along the rays of the pixels (u, v), (N,) each, forward."""
        ...

    def ray(self, u: Floats, v: Floats) -> Floats:
        """The same as unit vectors."""
        ...

    def project(self, points: Floats) -> Floats:
        """Pixels (N, 2) of points (N, 3) in mm; NaN for points at or behind the centre's plane."""
        ...


class BrownConrady:
    """Pinhole with radial and tangential distortion: 4, 5 or 8 coefficients, k1 k2 p1 p2 [k3 [k4 k5 k6]].

    The distortion is taken out by fixed-point steps, as in ``cv2.undistortPoints``. How many is found once, on the
    border of the picture, where distortion is largest: until the pixel comes back within 0.0001 px.

    Parameters
    ----------
    matrix : (3, 3), [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in px
    distortion : (4,), (5,) or (8,)
    width, height : size of the picture, px
    steps : fixed-point steps, where they shall not be found here

    Attributes
    ----------
    steps : fixed-point steps in use

    Raises
    ------
    CalibrationError
        The distortion cannot be taken out at the border of the picture.

    Source: D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971, in the form of
    OpenCV's ``calib3d``.
    """

    TOLERANCE_PX = 1e-4
    MAX_STEPS = 60

    def __init__(self, matrix: Floats, distortion: Floats, width: int, height: int, steps: int | None = None) -> None:
        self.matrix = np.asarray(matrix, dtype=np.float64)
        self.distortion = np.zeros(8)
        self.distortion[: len(distortion)] = distortion
        self.centre: Floats = np.zeros(3)
        # As Python's numbers, with which numpy's arithmetic is twice as fast as with its own.
        self._parts = tuple(float(self.matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        self._coefficients = tuple(self.distortion.tolist())
        self._tangential = self.distortion[[3, 2], None]
        self.steps = self._find_steps(width, height) if steps is None else steps

    def direction(self, u: Floats, v: Floats) -> Floats:
        directions = np.empty((3, len(u)))  # component by component, as the arithmetic on many rays likes it
        self._undistort(self._normalise(u, v), self.steps, directions[:2])
        directions[2] = 1
        return directions.T

    def ray(self, u: Floats, v: Floats) -> Floats:
        return _unit(self.direction(u, v))

    def project(self, points: Floats) -> Floats:
        points = np.asarray(points, dtype=np.float64)
        z = np.where(points[:, 2] > 0, points[:, 2], np.nan)
        return self._pixels(self._distort(points.T[:2] / z)).T

    # Points below are (2, N): x and y, where z is 1.

    def _normalise(self, u: Floats, v: Floats) -> Floats:
        fx, fy, cx, cy = self._parts
        xy = np.empty((2, len(u)))
        np.multiply(u, 1 / fx, out=xy[0])
        np.multiply(v, 1 / fy, out=xy[1])
        xy[0] -= cx / fx
        xy[1] -= cy / fy
        return xy

    def _pixels(self, xy: Floats) -> Floats:
        fx, fy, cx, cy = self._parts
        return np.asarray([[fx], [fy]] * xy + [[cx], [cy]])

    def _terms(self, xy: Floats) -> tuple[Floats, Floats]:
        """Radial factor (N,) and tangential shift (2, N) at undistorted points."""
        k1, k2, p1, p2, k3, k4, k5, k6 = self._coefficients
        x, y = xy
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if k4 or k5 or k6:
            radial = radial / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        # x: 2 p1 x y + p2 (r2 + 2 x^2); y: p1 (r2 + 2 y^2) + 2 p2 x y
        shift = (2 * p2 * x + 2 * p1 * y) * xy
        shift += r2 * self._tangential
        return radial, shift

    def _distort(self, xy: Floats) -> Floats:
        radial, shift = self._terms(xy)
        return xy * radial + shift

    def _undistort(self, distorted: Floats, steps: int, out: Floats) -> None:
        out[:] = distorted
        for _ in range(steps):
            radial, shift = self._terms(out)
            np.subtract(distorted, shift, out=out)
            out /= radial

    def _find_steps(self, width: int, height: int) -> int:
        along = np.linspace(0, 1, 17)
        zero, one = np.zeros_like(along), np.ones_like(along)
        u = np.concatenate([along, along, zero, one]) * (width - 1)
        v = np.concatenate([zero, one, along, along]) * (height - 1)
        distorted = self._normalise(u, v)
        undistorted, error = np.empty_like(distorted), np.full_like(u, np.inf)
        with np.errstate(all="ignore"):  # what diverges shows in the error
            for steps in range(1, self.MAX_STEPS + 1):
                self._undistort(distorted, steps, undistorted)
                back_u, back_v = self._pixels(self._distort(undistorted))
                error = np.nan_to_num(np.hypot(back_u - u, back_v - v), nan=np.inf)
                if error.max() < self.TOLERANCE_PX:
                    return steps
        worst = int(error.argmax())
        raise CalibrationError(
            f"camera.distortion cannot be taken out at pixel ({u[worst]:.0f}, {v[worst]:.0f}) of {width} x {height}:"
            " calibrate again with views that reach the corners, or with fewer coefficients"
        )


class Projection:
    """The linear model of the paper (eqs 1 to 3): pixels = matrix * (X, Y, Z, 1), divided by the third.

    Parameters
    ----------
    matrix : (3, 4), from C in mm to pixels; any scale and sign

    Raises
    ------
    CalibrationError
        The left 3 x 3 of the matrix is singular: no camera at a finite place.
    """

    def __init__(self, matrix: Floats) -> None:
        matrix = np.asarray(matrix, dtype=np.float64)
        if np.linalg.cond(matrix[:, :3]) > 1e12:
            raise CalibrationError("camera.matrix has a singular left 3 x 3: no camera at a finite place projects so")
        # Z of C points forward: the third homogeneous coordinate shall grow with it.
        self.matrix: Floats = matrix if matrix[2, 2] > 0 else -matrix
        self._inverse = np.asarray(np.linalg.inv(self.matrix[:, :3]), dtype=np.float64)
        self.centre: Floats = -self._inverse @ self.matrix[:, 3]

    def direction(self, u: Floats, v: Floats) -> Floats:
        return np.stack([a * u + b * v + c for a, b, c in self._inverse]).T

    def ray(self, u: Floats, v: Floats) -> Floats:
        return _unit(self.direction(u, v))

    def project(self, points: Floats) -> Floats:
        h = np.asarray(points, dtype=np.float64) @ self.matrix[:, :3].T + self.matrix[:, 3]
        w = np.where(h[:, 2] > 0, h[:, 2], np.nan)
        return np.asarray(h[:, :2] / w[:, None])


def _unit(directions: Floats) -> Floats:
    x, y, z = directions.T
    return np.asarray(directions / np.sqrt(x * x + y * y + z * z)[:, None])
