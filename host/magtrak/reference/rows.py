"""A whole image: one record per row, as the card sends it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..protocol import FULL_ROW, Detector
from . import fir
from .ambient import Background, subtract
from .gate import gate
from .hls import U8
from .runs import Runs, find_runs, gated_within
from .weight import mix, saturated, weight

ROW_DTYPE = np.dtype([(field.name, np.int64) for field in FULL_ROW.fields if not field.reserved])
"""The fields of a full row."""


def measure(
    image: U8, settings: Mapping[str, int], luts: NDArray[np.bool_], background: Background | None = None
) -> NDArray[np.void]:
    """What the card measures in an image that keeps the camera's contract, bit for bit.

    Parameters
    ----------
    image : (rows, columns, 3) uint8, RGB
    settings : the registers of scope ``FRAME``, by name
    luts : (3, 256) bool, gate tables of hue, luminance and saturation
    background : subtracted from the mix; where that leaves nothing above the floor, nothing is gated

    Returns
    -------
    records : (rows,) of :data:`ROW_DTYPE`

    The row's result
    ----------------
    Outside the region of interest nothing is gated or lit; the filter sees the whole row all the same.

    The row's peak is the strongest candidate of the runs that count, the first on ties; the runner-up is the next by
    the same rule. ``sum`` to ``clipped`` tell of the peak's run; ``runner_up`` is 256 times the runner-up's strength
    over the peak's, at most 255.

    ``fir``: candidates are the zero crossings found from a run's first column to its ``close``, and their strength is
    the contrast. A lamp or a bright object is wide: its sum is great, its contrast is not. A run without any crossing
    stands for one of contrast 0 in its middle, flagged ``cut``; two such are equally strong.

    ``binary`` is the paper's way: the mean column of all gated pixels of the row, runs or not. Valid with at least
    ``run_gated`` gated pixels, and one. The other fields tell of the runs: candidates are their middles, their
    strength is the sum. Where no run counts, ``width`` and ``gated`` tell of the gated pixels and the rest is 0.

    ``second_position`` is that of the candidate to half a column.

    ``cut``: the run (``binary``: the gated pixels) touches the border of the image or region, or the
    filter at the crossing reaches over the border of the image.

    ``ambiguous``: the runner-up has at least ``ambiguous_ratio`` / 256 of the strength; or more gated pixels lie
    outside the run's reach than within; or (``fir``) fewer than ``run_gated`` gated pixels lie within ``run_reach``
    columns of where the peak is found; or (``binary``) the gated pixels spread wider than ``run_width_max``.
    """
    rows, columns = image.shape[:2]
    mixed = subtract(mix(image, settings), background)
    inside = _inside(rows, columns, settings)
    gated = gate(image, luts) & inside
    lit = np.where(inside, weight(mixed, settings), 0)
    if background is not None:
        gated &= lit > 0
    runs = find_runs(lit, gated, saturated(image), settings)
    binary = settings["detector"] == Detector.BINARY
    crossings = fir.crossings(mixed)
    candidates = _runs(runs) if binary else _crossings(runs, crossings, columns)
    best, second = _choose(candidates, rows)

    out = np.zeros(rows, ROW_DTYPE)
    found = best >= 0
    _describe(out, runs, candidates, best, second)
    gated_columns, span = _spread(gated)
    total = gated_columns[:, 0]
    if binary:
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
        peaks = best[found]
        run, at = candidates.run[peaks], candidates.crossing[peaks]
        crossed = at >= 0
        place = candidates.halves[peaks] << 7
        at = at[crossed]
        before, after = crossings.before[at], crossings.after[at]
        place[crossed] = fir.position(crossings)[at]
        out["position"][found] = place
        edge = _touches(runs.first[run], runs.last[run], columns, settings) | ~crossed
        edge[crossed] |= (before < fir.REACH) | (after + fir.REACH > columns - 1)
        out["cut"][found] = edge
        near = gated_within(gated, crossings.row[at], after, after, settings)
        out["ambiguous"][crossings.row[at]] |= near < settings["run_gated"]
    out["ambiguous"] |= total > 2 * out["gated"]
    out["ambiguous"] |= (out["second_valid"] != 0) & (out["runner_up"] >= settings["ambiguous_ratio"])
    out["saturated"] = out["clipped"] > 0
    for name in ROW_DTYPE.names or ():
        out[name] *= out["valid"]
    return out


@dataclass(frozen=True)
class _Candidates:
    """What may be a row's peak, in runs that count; equally strong ones of a row in the order of columns.

    Attributes
    ----------
    row, run : of each
    crossing : zero crossing that it is, -1 where it is the middle of its run
    strength : by which the row's peak is chosen
    halves : its column, in halves of a column
    """

    row: NDArray[np.int64]
    run: NDArray[np.int64]
    crossing: NDArray[np.int64]
    strength: NDArray[np.int64]
    halves: NDArray[np.int64]


def _runs(runs: Runs) -> _Candidates:
    run = np.flatnonzero(runs.counts)
    return _Candidates(runs.row[run], run, np.full(run.size, -1), runs.sum[run], runs.first[run] + runs.last[run])


def _crossings(runs: Runs, found: fir.Crossings, columns: int) -> _Candidates:
    if not runs.row.size:
        return _runs(runs)
    begins = runs.row * columns + runs.first
    run = np.maximum(np.searchsorted(begins, found.row * columns + found.after, side="right") - 1, 0)
    mine = runs.counts[run] & (runs.row[run] == found.row)
    mine &= (runs.first[run] <= found.after) & (found.after <= runs.close[run])
    crossing = np.flatnonzero(mine)
    run = run[crossing]
    plain = np.setdiff1d(np.flatnonzero(runs.counts), run)
    return _Candidates(
        row=np.concatenate((found.row[crossing], runs.row[plain])),
        run=np.concatenate((run, plain)),
        crossing=np.concatenate((crossing, np.full(plain.size, -1))),
        strength=np.concatenate((found.contrast[crossing], np.zeros(plain.size, np.int64))),
        halves=np.concatenate((found.before[crossing] + found.after[crossing], runs.first[plain] + runs.last[plain])),
    )


def _inside(rows: int, columns: int, settings: Mapping[str, int]) -> NDArray[np.bool_]:
    row, column = np.arange(rows)[:, None], np.arange(columns)[None, :]
    inside: NDArray[np.bool_] = (
        (row >= settings["row_first"])
        & (row <= settings["row_last"])
        & (column >= settings["column_first"])
        & (column <= settings["column_last"])
    )
    return inside


def _choose(candidates: _Candidates, rows: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Index of the best candidate and of the runner-up of each row, -1 where there is none."""
    order = np.lexsort((np.arange(candidates.row.size), -candidates.strength, candidates.row))
    row = candidates.row[order]
    begin = np.searchsorted(row, np.arange(rows))
    amount = np.searchsorted(row, np.arange(rows), side="right") - begin
    padded = np.concatenate((order, [-1, -1]))
    return np.where(amount > 0, padded[begin], -1), np.where(amount > 1, padded[begin + 1], -1)


def _describe(
    out: NDArray[np.void], runs: Runs, candidates: _Candidates, best: NDArray[np.int64], second: NDArray[np.int64]
) -> None:
    row = np.flatnonzero(best >= 0)
    run = candidates.run[best[row]]
    for name in ("sum", "peak", "width", "gated", "clipped"):
        out[name][row] = getattr(runs, name)[run]
    row = np.flatnonzero(second >= 0)
    out["second_valid"][row] = 1
    out["second_position"][row] = candidates.halves[second[row]] << 7
    strongest, next_best = candidates.strength[best[row]], candidates.strength[second[row]]
    ratio = np.where(strongest > 0, (next_best << 8) // np.maximum(strongest, 1), 255)
    out["runner_up"][row] = np.minimum(ratio, 255)


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
