"""A whole image: one record per row, as the card sends it."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..protocol import FULL_ROW, Detector
from . import fir
from .gate import gate
from .hls import U8
from .runs import Runs, find_runs, gated_within
from .weight import mix, saturated, weight

ROW_DTYPE = np.dtype([(field.name, np.int64) for field in FULL_ROW.fields if not field.reserved])
"""The fields of a full row."""


def measure(image: U8, settings: Mapping[str, int], luts: NDArray[np.bool_]) -> NDArray[np.void]:
    """What the card measures in an image that keeps the camera's contract, bit for bit.

    Parameters
    ----------
    image : (rows, columns, 3) uint8, RGB
    settings : the registers of scope ``FRAME``, by name
    luts : (3, 256) bool, gate tables of hue, luminance and saturation

    Returns
    -------
    records : (rows,) of :data:`ROW_DTYPE`

    The row's result
    ----------------
    Outside the region of interest nothing is gated or lit; the filter sees the whole row all the same.

    The strongest run of those that count is the row's: the one of the greatest sum, the first on ties.
    The runner-up is the next by the same rule.

    ``fir`` takes the zero crossing of the greatest smoothed intensity (the first on ties) of those that are found from
    the run's first column to its ``close`` and are coloured: at least ``run_gated`` gated pixels lie within
    ``run_reach`` columns of where it is found. A bright wall behind the line makes one wide run with many peaks; colour
    tells the line's. A run without a coloured crossing gives the greatest of all, one without any crossing
    its middle, flagged ``cut``.

    ``binary`` is the paper's way: the mean column of all gated pixels of the row, runs or not. Valid with at least
    ``run_gated`` gated pixels, and one. The other fields tell of the strongest run; where no run counts, ``width``
    and ``gated`` tell of the gated pixels and the rest is 0.

    ``cut``: the run (``binary``: the gated pixels) touches the border of the image or region, or the
    filter at the crossing reaches over the border of the image.

    ``ambiguous``: the runner-up has at least ``ambiguous_ratio`` / 256 of the sum; or more gated pixels lie
    outside the run's reach than within; or (``fir``) the crossing of the greatest intensity is not coloured; or
    (``binary``) the gated pixels spread wider than ``run_width_max``.
    """
    rows, columns = image.shape[:2]
    mixed = mix(image, settings)
    inside = _inside(rows, columns, settings)
    gated = gate(image, luts) & inside
    lit = np.where(inside, weight(mixed, settings), 0)
    runs = find_runs(lit, gated, saturated(image), settings)
    best, second = _choose(runs, rows)

    out = np.zeros(rows, ROW_DTYPE)
    found = best >= 0
    _describe(out, runs, best, second)
    gated_columns, span = _spread(gated)
    total = gated_columns[:, 0]
    if settings["detector"] == Detector.BINARY:
        out["valid"] = total >= max(settings["run_gated"], 1)
        fine = 2 * (gated_columns[:, 1] << 8) // np.maximum(total, 1)
        out["position"] = (fine + 1) >> 1
        out["cut"] = _touches(span[0], span[1], columns, settings)
        width = span[1] - span[0] + 1
        out["ambiguous"] |= width > settings["run_width_max"]
        out["width"] = np.where(found, out["width"], width)
        out["gated"] = np.where(found, out["gated"], total)
    else:
        out["valid"] = found
        crossings = fir.crossings(mixed)
        coloured = (
            gated_within(gated, crossings.row, crossings.after, crossings.after, settings) >= settings["run_gated"]
        )
        out["position"], out["cut"], plain = _crossing(runs, best, crossings, coloured, columns, settings)
        out["ambiguous"] |= plain
    out["ambiguous"] |= total > 2 * out["gated"]
    out["ambiguous"] |= (out["second_valid"] != 0) & (out["runner_up"] >= settings["ambiguous_ratio"])
    out["saturated"] = out["clipped"] > 0
    for name in ROW_DTYPE.names or ():
        out[name] *= out["valid"]
    return out


def _inside(rows: int, columns: int, settings: Mapping[str, int]) -> NDArray[np.bool_]:
    row, column = np.arange(rows)[:, None], np.arange(columns)[None, :]
    inside: NDArray[np.bool_] = (
        (row >= settings["row_first"])
        & (row <= settings["row_last"])
        & (column >= settings["column_first"])
        & (column <= settings["column_last"])
    )
    return inside


def _choose(runs: Runs, rows: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Index of the best run and of the runner-up of each row, -1 where there is none."""
    order = np.flatnonzero(runs.counts)
    order = order[np.lexsort((order, -runs.sum[order], runs.row[order]))]
    row = runs.row[order]
    begin = np.searchsorted(row, np.arange(rows))
    amount = np.searchsorted(row, np.arange(rows), side="right") - begin
    padded = np.concatenate((order, [-1, -1]))
    return np.where(amount > 0, padded[begin], -1), np.where(amount > 1, padded[begin + 1], -1)


def _describe(out: NDArray[np.void], runs: Runs, best: NDArray[np.int64], second: NDArray[np.int64]) -> None:
    row = np.flatnonzero(best >= 0)
    run = best[row]
    for name in ("sum", "peak", "width", "gated", "clipped"):
        out[name][row] = getattr(runs, name)[run]
    row = np.flatnonzero(second >= 0)
    run = second[row]
    out["second_valid"][row] = 1
    out["second_position"][row] = (runs.first[run] + runs.last[run]) << 7
    out["runner_up"][row] = np.minimum((runs.sum[run] << 8) // runs.sum[best[row]], 255)


def _spread(gated: NDArray[np.bool_]) -> tuple[NDArray[np.int64], tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """(rows, 2): number and sum of the columns of gated pixels; and their first and last."""
    columns = gated.shape[1]
    column = np.arange(columns)
    sums = np.stack((gated.sum(axis=1), (gated * column).sum(axis=1)), axis=1).astype(np.int64)
    return sums, (gated.argmax(axis=1), columns - 1 - gated[:, ::-1].argmax(axis=1))


def _touches(
    first: NDArray[np.int64], last: NDArray[np.int64], columns: int, settings: Mapping[str, int]
) -> NDArray[np.bool_]:
    touches: NDArray[np.bool_] = (
        (first == 0) | (first == settings["column_first"]) | (last == columns - 1) | (last == settings["column_last"])
    )
    return touches


def _crossing(
    runs: Runs,
    best: NDArray[np.int64],
    found: fir.Crossings,
    coloured: NDArray[np.bool_],
    columns: int,
    settings: Mapping[str, int],
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Position and ``cut`` of each row's best run, and whether its greatest crossing lacks colour."""
    position = np.zeros(best.size, np.int64)
    cut = np.zeros(best.size, np.bool_)
    plain = np.zeros(best.size, np.bool_)
    row = np.flatnonzero(best >= 0)
    run = best[row]
    position[row] = (runs.first[run] + runs.last[run]) << 7
    cut[row] = True

    home = best[found.row]  # the run that a crossing would serve
    mine = (
        np.flatnonzero((home >= 0) & (runs.first[home] <= found.after) & (found.after <= runs.close[home]))
        if runs.row.size
        else np.zeros(0, np.intp)
    )
    order = np.lexsort((mine, -found.intensity[mine], found.row[mine]))
    row, at = np.unique(found.row[mine[order]], return_index=True)
    plain[row] = ~coloured[mine[order[at]]]
    order = np.lexsort((mine, -found.intensity[mine], ~coloured[mine], found.row[mine]))
    row, at = np.unique(found.row[mine[order]], return_index=True)
    mine = mine[order[at]]
    position[row] = fir.position(found)[mine]
    run = best[row]
    cut[row] = (
        _touches(runs.first[run], runs.last[run], columns, settings)
        | (found.before[mine] < fir.REACH)
        | (found.after[mine] + fir.REACH > columns - 1)
    )
    return position, cut, plain
