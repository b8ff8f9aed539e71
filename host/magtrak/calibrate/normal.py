"""Normal equations, scaled to a diagonal of 1 before anything is done with them, and robust sigmas."""

from typing import Any

import numpy as np

from ..arrays import Floats
from ..errors import CalibrationError

TRIM, TRIMMED = 3.0, 0.9733
"""Sigmas are estimated from residuals within 3 sigma, which have this part of the variance of all, were they normal."""


def normal(jacobian: Any, weights: Floats) -> Floats:
    """J^T W J."""
    weighted = jacobian.copy()
    weighted.data *= np.repeat(weights, np.diff(jacobian.indptr))
    return np.asarray((weighted.T @ jacobian).toarray())


def solve(normal: Floats, gradient: Floats, damping: float) -> Floats:
    """The step of Levenberg and Marquardt: damping on the scaled diagonal."""
    import scipy.linalg as linalg

    scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    scaled = normal / scale[:, None] / scale + damping * np.eye(len(scale))
    try:
        factor = linalg.cho_factor(scaled)
    except linalg.LinAlgError:
        factor = linalg.cho_factor(scaled + 1e-6 * np.eye(len(scale)))
    return np.asarray(linalg.cho_solve(factor, gradient / scale) / scale)


def scale(values: Floats, known: Floats) -> float:
    """Sigma of ``values``, each of which shows a part ``known`` of its variance, from those within 3 sigma."""
    size = np.abs(values) / np.sqrt(known)
    sigma = 1.4826 * float(np.median(size))
    for _ in range(20):
        inner = size < TRIM * sigma
        if not inner.any():
            break
        sigma = float(np.sqrt(np.sum(values[inner] ** 2) / np.sum(known[inner]) / TRIMMED))
    return max(sigma, 1e-9)


def invert(normal: Floats) -> Floats:
    """The covariance.

    Raises
    ------
    CalibrationError : nothing of the inverse would be left in double precision
    """
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    scaled = normal / scale[:, None] / scale
    try:
        inverse = np.linalg.inv(scaled)
    except np.linalg.LinAlgError:
        inverse = np.full_like(scaled, np.inf)
    # Condition number in the 1-norm.
    condition = np.abs(scaled).sum(axis=0).max() * np.abs(inverse).sum(axis=0).max()
    if not condition < 1e13 or (np.diag(inverse) <= 0).any():
        raise CalibrationError(
            "the observations do not determine the calibration: add views with the board tilted, at other distances and"
            " at other laser angles"
        )
    return np.asarray(inverse / scale[:, None] / scale)
