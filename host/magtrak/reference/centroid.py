"""The line as the mean column of its grey values: over a window about a column, or over a run."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..protocol import Window
from .fir import FRACTION
from .runs import Ints, Runs

HALF_WIDTHS = {Window.HALF_7: 7, Window.HALF_15: 15, Window.HALF_31: 31}
"""Columns to each side that a window has."""

LANES = 8
"""Columns that the card reads at once: offsets count from a multiple of it."""

GROUP = 4
"""Columns whose mean is the background at an end of the window; a multiple of it is the first."""


def window(
    mixed: NDArray[np.int32], row: Ints, centre: Ints, peak: Ints, settings: Mapping[str, int]
) -> tuple[Ints, NDArray[np.bool_], NDArray[np.bool_]]:
    """Centroid of the mix above a base, in the window of ``centroid_window`` about each column.

    The base is the greater of the means of the two groups of four columns in which the window's ends lie, an end
    outside the image not counted, and ``centroid_base`` sixteenths of ``peak``.

    Parameters
    ----------
    mixed : (rows, columns), 0 to 255
    row, centre, peak : (n,) row, column and greatest weight of each

    Returns
    -------
    position : (n,) in 1/256 px, rounded half up; where nothing rises above the base 0
    some : (n,) something does
    whole : (n,) the window lies within the image
    """
    columns = mixed.shape[1]
    half = HALF_WIDTHS[Window(settings["centroid_window"])]
    left, right = centre - half, centre + half
    whole = (left >= 0) & (right < columns)
    groups = np.pad(mixed, ((0, 0), (0, -columns % GROUP)), mode="edge").reshape(mixed.shape[0], -1, GROUP).sum(2)
    ends = [
        np.where((end >= 0) & (end < columns), groups[row, np.clip(end, 0, columns - 1) // GROUP] // GROUP, 0)
        for end in (left, right)
    ]
    base = np.maximum(*ends) + (settings["centroid_base"] * peak >> 4)

    start = np.maximum(left, 0) // LANES * LANES
    column = left[:, None] + np.arange(2 * half + 1)
    inside = (column >= 0) & (column < columns)
    above = mixed[row[:, None], np.clip(column, 0, columns - 1)].astype(np.int64) - base[:, None]
    above = np.where(inside, np.maximum(above, 0), 0)
    total = above.sum(1)  # 63 * 255 < 2**14
    moment = (above * (column - start[:, None])).sum(1)  # 255 * (0 + ... + 70) < 2**20
    fine = FRACTION * start + FRACTION * moment // np.maximum(total, 1)
    return np.where(total > 0, (fine + 1) >> 1, 0), total > 0, whole


def of_runs(runs: Runs) -> Ints:
    """Centroid of the weights of each run, in 1/256 px; what is subtracted is rounded down, so halves are, too."""
    fine: Ints = FRACTION * runs.last - FRACTION * runs.moment // np.maximum(runs.sum, 1)
    return fine >> 1
