"""Runs of lit pixels, and what is measured of each."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Runs:
    """Runs of all rows of an image, in order of row and column, whether they count or not.

    Attributes
    ----------
    row : row of each
    first, last : its first and last lit column
    close : last column whose zero crossing still belongs to it: the first one after it and the gap that may
        be bridged, or the row's last
    sum, peak : sum and greatest of its weights
    moment : sum of its weights times their distances from ``last``
    peak_first, peak_last : first and last column of the greatest weight
    clipped : its lit pixels that are at full scale in a channel
    gated : gated pixels from ``reach`` columns before it to ``reach`` columns behind
    counts : enough of them, and a width that is allowed
    """

    row: Ints
    first: Ints
    last: Ints
    close: Ints
    sum: Ints
    peak: Ints
    moment: Ints
    peak_first: Ints
    peak_last: Ints
    clipped: Ints
    gated: Ints
    counts: NDArray[np.bool_]

    @property
    def width(self) -> Ints:
        return self.last - self.first + 1


def gated_within(
    gate: NDArray[np.bool_],
    row: NDArray[np.intp],
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    settings: Mapping[str, int],
) -> Ints:
    """Gated pixels of each ``row`` from ``run_reach`` columns before ``first`` to as many after ``last``."""
    columns = gate.shape[1]
    before = np.zeros((gate.shape[0], columns + 1), np.int64)
    np.cumsum(gate, axis=1, out=before[:, 1:])
    low = np.maximum(first - settings["run_reach"], 0)
    high = np.minimum(last + settings["run_reach"], columns - 1)
    amount: Ints = before[row, high + 1] - before[row, low]
    return amount


def find_runs(
    weight: NDArray[np.int32], gate: NDArray[np.bool_], saturated: NDArray[np.bool_], settings: Mapping[str, int]
) -> Runs:
    """The runs of (rows, columns) images.

    A run is a longest stretch of pixels of a weight above 0, in which gaps of at most ``run_bridge`` columns
    do not end it. It counts if at least ``run_gated`` gated pixels lie in it or within ``run_reach`` columns, and its
    width, bridged gaps included, is ``run_width_min`` to ``run_width_max``.
    """
    columns = weight.shape[1]
    row, column = (axis.astype(np.int64) for axis in np.nonzero(weight))
    if not row.size:
        none = np.zeros(0, np.int64)
        return Runs(*(none,) * 11, none.astype(np.bool_))
    breaks = (np.diff(row) != 0) | (np.diff(column) > settings["run_bridge"] + 1)
    starts = np.concatenate(([0], np.flatnonzero(breaks) + 1))
    ends = np.concatenate((starts[1:], [row.size])) - 1
    lit = weight[row, column].astype(np.int64)
    first, last, row_of = column[starts], column[ends], row[starts]

    peak = np.maximum.reduceat(lit, starts)
    of = np.repeat(np.arange(starts.size), ends - starts + 1)  # run of each lit pixel
    greatest = lit == peak[of]
    gated = gated_within(gate, row_of, first, last, settings)
    width = last - first + 1
    return Runs(
        row=row_of,
        first=first,
        last=last,
        close=np.minimum(last + settings["run_bridge"] + 1, columns - 1),
        sum=np.add.reduceat(lit, starts),
        peak=peak,
        moment=np.add.reduceat((last[of] - column) * lit, starts),
        peak_first=np.minimum.reduceat(np.where(greatest, column, columns), starts),
        peak_last=np.maximum.reduceat(np.where(greatest, column, -1), starts),
        clipped=np.add.reduceat(saturated[row, column].astype(np.int64), starts),
        gated=gated,
        counts=(gated >= settings["run_gated"])
        & (width >= settings["run_width_min"])
        & (width <= settings["run_width_max"]),
    )
