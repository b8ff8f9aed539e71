"""The picture of a point is no point: a Gaussian smear, the same all over the picture."""

from math import ceil
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Real = TypeVar("Real", np.float32, np.float64)

REACH = 4.0
"""Beyond so many sigma nothing is smeared."""


def smear(picture: npt.NDArray[Real], sigma: float, axis: int, step: int = 1) -> npt.NDArray[Real]:
    """A picture (height, width, ...) smeared along one axis; beyond its border it goes on as at the border.

    Every ``step`` values (sigma counts them) are then averaged to one: a pixel gathers its samples. Both are one sum of
    neighbours, and only the sums that are asked for are made.
    """
    if sigma <= 0 and step == 1:
        return picture
    reach = ceil(REACH * max(sigma, 0.0))
    gauss = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2) if reach else np.ones(1)
    weights = np.convolve(gauss / gauss.sum(), np.full(step, 1 / step))
    widths = [(0, 0)] * picture.ndim
    widths[axis] = (reach, reach)
    wide: npt.NDArray[Real] = np.moveaxis(np.pad(picture, widths, mode="edge"), axis, 0)
    length = picture.shape[axis] // step
    result = np.zeros((length, *wide.shape[1:]), picture.dtype)
    for at, weight in enumerate(weights.astype(picture.dtype)):
        result += weight * wide[at : at + (length - 1) * step + 1 : step]
    return np.moveaxis(result, 0, axis)
