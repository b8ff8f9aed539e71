"""The picture of a point is no point: a Gaussian smear, the same all over the picture."""

from math import ceil
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Real = TypeVar("Real", np.float32, np.float64)

REACH = 4.0
"""Beyond so many sigma nothing is smeared."""


def smear(picture: npt.NDArray[Real], sigma: float, axis: int) -> npt.NDArray[Real]:
    """A picture (height, width, ...) smeared along one axis; beyond its border it goes on as at the border."""
    if sigma <= 0:
        return picture
    reach = ceil(REACH * sigma)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights /= weights.sum()
    widths = [(0, 0)] * picture.ndim
    widths[axis] = (reach, reach)
    wide: npt.NDArray[Real] = np.moveaxis(np.pad(picture, widths, mode="edge"), axis, 0)
    length = picture.shape[axis]
    result = np.zeros((length, *wide.shape[1:]), picture.dtype)
    for at, weight in enumerate(weights.astype(picture.dtype)):
        result += weight * wide[at : at + length]
    return np.moveaxis(result, 0, axis)
