"""The isolated-pixel filter: a pixel of the gate stays only among others."""

import numpy as np
from numpy.typing import NDArray


def isolate(gated: NDArray[np.bool_], k: int) -> NDArray[np.bool_]:
    """The pixels of ``gated`` of whose eight neighbours at least ``k`` are gated; what is outside the image is not.

    Parameters
    ----------
    gated : (rows, columns) bool
    k : 0 to 8; with 0 all stay
    """
    rows, columns = gated.shape
    padded = np.pad(gated, 1).astype(np.uint8)
    square = sum(padded[y : y + rows, x : x + columns] for y in range(3) for x in range(3))
    stays: NDArray[np.bool_] = gated & (square > k)  # the pixel counts in its own square
    return stays
