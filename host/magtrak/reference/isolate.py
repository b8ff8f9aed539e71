"""The isolated-pixel filter."""

import numpy as np
from numpy.typing import NDArray


def isolate(gated: NDArray[np.bool_], neighbours: int) -> NDArray[np.bool_]:
    """Gated pixels that have at least so many gated ones among their 8 neighbours; what lies outside is not gated.

    Parameters
    ----------
    gated : (rows, columns)
    neighbours : 0 to 8; 0 keeps all
    """
    padded = np.pad(gated.astype(np.int32), 1)
    rows, columns = gated.shape
    square = sum(padded[y : y + rows, x : x + columns] for y in range(3) for x in range(3))
    kept: NDArray[np.bool_] = gated & (square >= neighbours + 1)
    return kept
