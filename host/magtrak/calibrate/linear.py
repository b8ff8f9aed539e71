"""The paper's camera calibration: a projection matrix from pairs of points, and the ten numbers in it.

Section 2.1 of the paper, eqs 1 to 3: pixels = ^I T_C ^C T_W (X, Y, Z, 1), with four intrinsic parameters (alpha_u,
alpha_v, u_0, v_0) and six extrinsic ones. From at least six pairs (five and a half are twelve numbers less their scale)
the matrix follows linearly; here it is then refined in the picture. The ten parameters come out by RQ decomposition,
whose eleventh number, the skew of the axes, is 0 for a real camera: how far it is from 0 tells how good the pairs are.
Source: R. Hartley and A. Zisserman, "Multiple View Geometry", 2nd edition, algorithm 7.1 and section 6.2.4.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats
from .findings import refuse

MIN_PAIRS = 6


@dataclass(frozen=True)
class Linear:
    """A projection matrix and what is in it.

    Attributes
    ----------
    matrix : (3, 4), from W in mm to pixels, third row of unit length
    intrinsics : (4,) alpha_u, alpha_v, u_0, v_0, px
    rotation, translation : (3, 3), (3,) of ^C T_W, mm
    skew : of the axes, px
    sigmas : (10,) of intrinsics, turn about X_C, Y_C, Z_C (rad), translation (mm); NaN with six pairs or fewer to spare
    rms_px : of the residuals
    """

    matrix: Floats
    intrinsics: Floats
    rotation: Floats
    translation: Floats
    skew: float
    sigmas: Floats
    rms_px: float

    @property
    def in_camera_frame(self) -> Floats:
        """(3, 4) the matrix for calibration files: from C to pixels."""
        au, av, u0, v0 = self.intrinsics
        return np.array([[au, 0, u0, 0], [0, av, v0, 0], [0, 0, 1, 0]])


def linear_camera(points: Floats, pixels: Floats) -> Linear:
    """From points (N, 3) in mm and where they are seen (N, 2).

    Raises
    ------
    CalibrationError
        Fewer than six pairs, or all in one plane.
    """
    import scipy.optimize

    points, pixels = np.asarray(points, dtype=np.float64), np.asarray(pixels, dtype=np.float64)
    if len(points) < MIN_PAIRS:
        raise refuse("few-pairs", pairs=len(points), needed=MIN_PAIRS)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    if spread[2] < 1e-2 * spread[0]:
        raise refuse("coplanar", mm=float(spread[2]))
    start = _decompose(_dlt(points, pixels))
    values = np.concatenate([start[0], np.zeros(3), start[2]])

    def residuals(p: Floats) -> Floats:
        return np.asarray((_project(p, start[1], points) - pixels).ravel())

    found = scipy.optimize.least_squares(residuals, values, method="lm", x_scale=np.maximum(np.abs(values), 1.0))
    p = found.x
    spare = 2 * len(points) - 10
    variance = 2 * found.cost / spare if spare > 0 else np.nan
    sigmas = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * variance)
    rotation = _turn(p[4:7]) @ start[1]
    k = np.array([[p[0], 0, p[2]], [0, p[1], p[3]], [0, 0, 1]])
    matrix = k @ np.c_[rotation, p[7:]]
    return Linear(matrix, p[:4], rotation, p[7:], start[3], sigmas, float(np.sqrt(np.mean(found.fun**2))))


def _dlt(points: Floats, pixels: Floats) -> Floats:
    """The matrix that solves the linear equations best, in normalised coordinates."""
    to_points, to_pixels = _normaliser(points), _normaliser(pixels)
    p = np.c_[points, np.ones(len(points))] @ to_points.T
    q = np.c_[pixels, np.ones(len(pixels))] @ to_pixels.T
    zero = np.zeros_like(p)
    rows = np.concatenate([np.c_[p, zero, -q[:, :1] * p], np.c_[zero, p, -q[:, 1:2] * p]])
    matrix = np.linalg.svd(rows)[2][-1].reshape(3, 4)
    return np.asarray(np.linalg.inv(to_pixels) @ matrix @ to_points)


def _normaliser(values: Floats) -> Floats:
    size = values.shape[1]
    middle = values.mean(axis=0)
    scale = np.sqrt(size) / np.sqrt(np.mean(np.sum((values - middle) ** 2, axis=1)))
    result: Floats = np.eye(size + 1) * scale
    result[:size, size] = -scale * middle
    result[size, size] = 1
    return result


def _decompose(matrix: Floats) -> tuple[Floats, Floats, Floats, float]:
    """Intrinsics (4,), rotation, translation, skew."""
    import scipy.linalg

    k, rotation = scipy.linalg.rq(matrix[:, :3])
    signs = np.diag(np.sign(np.diag(k)))
    k, rotation = k @ signs, signs @ rotation
    translation = np.linalg.solve(k, matrix[:, 3])
    if np.linalg.det(rotation) < 0:  # the matrix is known but for its sign
        rotation, translation = -rotation, -translation
    k = k / k[2, 2]
    return np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2]]), rotation, translation, float(k[0, 1])


def _turn(turn: Floats) -> Floats:
    from .rig import turned

    return turned(np.eye(3), turn)


def _project(p: Floats, rotation: Floats, points: Floats) -> Floats:
    seen = points @ (_turn(p[4:7]) @ rotation).T + p[7:]
    return np.asarray(p[:2] * seen[:, :2] / seen[:, 2:] + p[2:4])
