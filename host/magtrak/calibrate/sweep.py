"""The swept laser plane from lines on known boards, in closed form; and its standard form for files.

In the camera's frame the plane at the encoder's angle theta = 2 pi counts / counts_per_turn is

    n(theta) . P = d(theta),  n = a cos(theta) + b sin(theta) + c,  d = p cos(theta) + q sin(theta) + r,

linear in twelve numbers that are known but for their scale: each measured point gives one homogeneous equation, and the
singular vector of the least singular value solves them all. a, b, c are then made perpendicular, as a turning plane has
them. The direction of the turn falls out: a x b points along the axis about which theta turns the plane.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats
from ..errors import CalibrationError
from ..laser import Laser


@dataclass(frozen=True)
class Sweep:
    """a, b, c and p, q, r of the module's equation; n is of unit length."""

    a: Floats
    b: Floats
    c: Floats
    p: float
    q: float
    r: float

    @classmethod
    def fit(cls, points: Floats, theta: Floats, *, leaning: bool = True) -> "Sweep":
        """From points (N, 3) in C and the encoder's angle at each.

        Parameters
        ----------
        leaning : False for a plane through its axis (c = 0, r = p-q's own): eight numbers, for narrow sweeps

        Raises
        ------
        CalibrationError
            The points determine no sweep.
        """
        size = float(np.abs(points).max())
        rows = np.concatenate([points / size, -np.ones((len(points), 1))], axis=1)
        parts = [rows * np.cos(theta)[:, None], rows * np.sin(theta)[:, None]]
        if leaning:
            parts.append(rows)
        _, values, vectors = np.linalg.svd(np.concatenate(parts, axis=1), full_matrices=False)
        if len(points) < 12 or values[-2] < 1e-9 * values[0]:
            raise CalibrationError(
                "the laser lines do not determine how the plane turns: take lines at more angles, and boards at more"
                " distances"
            )
        solved = vectors[-1].reshape(-1, 4)
        solved[:, 3] *= size
        a, b = solved[0], solved[1]
        c = solved[2] if leaning else np.zeros(4)
        return cls._orthogonal(a, b, c)

    @classmethod
    def _orthogonal(cls, a: Floats, b: Floats, c: Floats) -> "Sweep":
        axis = np.cross(a[:3], b[:3])
        if np.linalg.norm(axis) < 1e-12:
            raise CalibrationError(
                "the laser plane does not turn with the encoder's counts: check that motor and encoder move together"
            )
        axis = axis / np.linalg.norm(axis)
        # The two perpendicular vectors of one length that are nearest to a and b (polar decomposition).
        u, _, vt = np.linalg.svd(np.stack([a[:3], b[:3]]), full_matrices=False)
        pair = u @ vt
        length = (np.linalg.norm(a[:3]) + np.linalg.norm(b[:3])) / 2
        lean = float(c[:3] @ axis)
        norm = float(np.hypot(length, lean))
        return cls(
            pair[0] * length / norm,
            pair[1] * length / norm,
            axis * lean / norm,
            float(a[3] / norm),
            float(b[3] / norm),
            float(c[3] / norm),
        )

    @classmethod
    def of(cls, laser: Laser) -> "Sweep":
        """Of a laser in any of its forms."""
        x, y, z = laser.camera_from_laser[:3, :3].T
        t = laser.camera_from_laser[:3, 3]
        cos_tilt, sin_tilt = np.cos(laser.tilt_rad), np.sin(laser.tilt_rad)
        cos_zero, sin_zero = np.cos(laser.zero_rad), np.sin(laser.zero_rad)
        a = cos_tilt * (cos_zero * y - sin_zero * x)
        b = laser.sense * cos_tilt * (-sin_zero * y - cos_zero * x)
        c = sin_tilt * z
        return cls(a, b, c, float(a @ t), float(b @ t), float(c @ t) + laser.offset_mm)

    def laser(self, counts_per_turn: int, lit: Floats, theta: float, error_table: Floats | None = None) -> Laser:
        """In the form that files have, see ``interfaces``: L's origin at the axis point nearest to the camera's centre,
        X_L along the light and as near as can be to Z_C, Z_L . Y_C > 0.

        Parameters
        ----------
        lit : (3,) a point in C that the light reaches ...
        theta : ... about at this angle of the encoder, rad
        """
        z = np.cross(self.a, self.b)
        z = z / np.linalg.norm(z)
        sense = 1
        if z[1] < 0:
            z, sense = -z, -1
        x = np.array([0.0, 0.0, 1.0]) - z[2] * z
        if np.linalg.norm(x) < 1e-6:
            raise CalibrationError("the laser's axis points along the camera's: the rig cannot measure depth so")
        x = x / np.linalg.norm(x)
        y = np.cross(z, x)
        sign = 1.0
        for _ in range(2):
            a, c = sign * self.a, sign * self.c
            t = np.linalg.solve(np.stack([self.a, self.b, z]), [self.p, self.q, 0.0])
            zero = float(np.arctan2(-a @ x, a @ y))
            alpha = sense * theta + zero
            along = np.cos(alpha) * x + np.sin(alpha) * y
            if along @ (lit - t) > 0:
                break
            sign = -sign
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = x, y, z, t
        return Laser(
            camera_from_laser=pose,
            offset_mm=float(sign * self.r - c @ t),
            tilt_rad=float(np.arcsin(np.clip(c @ z, -1, 1))),
            zero_rad=zero,
            sense=sense,
            counts_per_turn=counts_per_turn,
            error_table=np.zeros(0) if error_table is None else error_table,
        )


def standard_form(laser: Laser, lit: Floats, counts: float) -> Laser:
    """The same laser in the form that files have; ``lit`` and ``counts`` as in :meth:`Sweep.laser`."""
    theta = 2 * np.pi * counts / laser.counts_per_turn
    return Sweep.of(laser).laser(laser.counts_per_turn, lit, theta, laser.error_table)
