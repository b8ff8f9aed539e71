"""A whole image: one record per row, as the card sends it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..protocol import FULL_ROW, Choice, Detector, Window
from . import centroid, fir
from .ambient import Background, subtract
from .fir import FRACTION
from .gate import gate
from .hls import U8
from .isolate import isolate
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
    Outside the region of interest nothing is gated or lit; filter and window see the whole row all the same.

    A run stands for the zero crossing of the greatest contrast, the first on ties, of those found from its first
    column to its ``close``; contrast is its strength. A lamp or a bright object is wide: its sum is great, its
    contrast is not. A run without any crossing stands for one of contrast 0 in its middle, flagged ``cut``. With
    ``binary`` a run stands for its middle, and its strength is its sum.

    Of the runs that count ``choice`` picks the row's: see :class:`magtrak.protocol.Choice`; on ties the first. The
    runner-up is the strongest of what else there is: the run's own second crossing, or another run. ``sum`` to
    ``clipped`` tell of the chosen run; ``runner_up`` is 256 times the runner-up's strength over its own, at most 255.

    ``position`` is, by ``detector``: ``fir``, the crossing (:func:`~magtrak.reference.fir.position`), or the middle
    of a run without one; ``centroid``, see :mod:`~magtrak.reference.centroid`, its window about the crossing's
    nearest column, and where nothing rises above the base as ``fir`` without interpolation, flagged ``ambiguous``;
    ``maximum``, the middle between the first and the last column of the run's greatest weight. ``binary`` is the
    paper's way: the mean column of all gated pixels of the row, runs or not. Valid with at least ``run_gated`` gated
    pixels, and one. The other fields tell of the runs; where no run counts, ``width`` and ``gated`` tell of the gated
    pixels and the rest is 0.

    ``second_position`` is that of the runner-up as ``fir`` would have it, with ``binary`` its middle.

    ``cut``: the run (``binary``: the gated pixels) touches the border of the image or region; or the filter at the
    crossing, or the window, reaches over the border of the image.

    ``ambiguous``: the runner-up has at least ``ambiguous_ratio`` / 256 of the strength; or more gated pixels lie
    outside the run's reach than within; or (not ``binary``) fewer than ``run_gated`` gated pixels lie within
    ``run_reach`` columns of the crossing; or (``binary``) the gated pixels spread wider than ``run_width_max``.
    """
    rows, columns = image.shape[:2]
    mixed = subtract(mix(image, settings), background)
    inside = _inside(rows, columns, settings)
    lit = np.where(inside, weight(mixed, settings), 0)
    gated = gate(image, luts) & inside
    if background is not None:
        gated &= lit > 0
    gated = isolate(gated, settings["isolate"])
    runs = find_runs(lit, gated, saturated(image), settings)
    crossings = fir.crossings(mixed)
    binary = settings["detector"] == Detector.BINARY
    peaks = _middles(runs) if binary else _crossings(runs, crossings, columns)
    best, rival = _choose(runs, peaks, rows, Choice(settings["choice"]))

    out = np.zeros(rows, ROW_DTYPE)
    found = best >= 0
    run = best[found]
    for name in ("sum", "peak", "width", "gated", "clipped"):
        out[name][found] = getattr(runs, name)[run]
    _describe_rival(out, peaks, fir.position(crossings), best, rival)
    touches = _touches(runs.first[run], runs.last[run], columns, settings)
    gated_columns, span = _spread(gated)
    total = gated_columns[:, 0]
    if binary:
        out["valid"] = total >= max(settings["run_gated"], 1)
        fine = FRACTION * gated_columns[:, 1] // np.maximum(total, 1)
        out["position"] = (fine + 1) >> 1
        out["cut"] = _touches(span[0], span[1], columns, settings)
        width = span[1] - span[0] + 1
        out["ambiguous"] |= width > settings["run_width_max"]
        out["width"] = np.where(found, out["width"], width)
        out["gated"] = np.where(found, out["gated"], total)
    else:
        out["valid"] = found
        crossing = peaks.crossing[run]
        crossed = crossing >= 0
        place = peaks.halves[run] << 7
        at = crossing[crossed]
        before, after = crossings.before[at], crossings.after[at]
        cut = touches | ~crossed
        cut[crossed] |= (before < fir.REACH) | (after + fir.REACH > columns - 1)
        near = gated_within(gated, crossings.row[at], after, after, settings)
        out["ambiguous"][crossings.row[at]] |= near < settings["run_gated"]
        if settings["detector"] == Detector.FIR:
            place[crossed] = fir.position(crossings)[at]
        elif settings["detector"] == Detector.MAXIMUM:
            place = (runs.peak_first + runs.peak_last)[run] << 7
        elif settings["centroid_window"] == Window.RUN:
            place = centroid.of_runs(runs)[run]
        else:
            centre = peaks.centre[run]
            window, some, whole = centroid.window(mixed, runs.row[run], centre, runs.peak[run], settings)
            place = np.where(some, window, place)
            cut |= ~whole
            out["ambiguous"][found] |= ~some
        out["position"][found] = place
        out["cut"][found] = cut
    out["ambiguous"] |= total > 2 * out["gated"]
    out["ambiguous"] |= (out["second_valid"] != 0) & (out["runner_up"] >= settings["ambiguous_ratio"])
    out["saturated"] = out["clipped"] > 0
    for name in ROW_DTYPE.names or ():
        out[name] *= out["valid"]
    return out


Ints = NDArray[np.int64]


@dataclass(frozen=True)
class _Peaks:
    """What each run stands for, and the next best within it.

    Attributes
    ----------
    crossing : zero crossing that it is, -1 where it is the middle of the run
    strength : by which runs are compared
    halves : its column, in halves of a column
    centre : the whole column nearest to it
    second : zero crossing that comes next, -1 for none
    second_strength : of that
    """

    crossing: Ints
    strength: Ints
    halves: Ints
    centre: Ints
    second: Ints
    second_strength: Ints


def _middles(runs: Runs) -> _Peaks:
    none = np.full(runs.row.size, -1)
    halves = runs.first + runs.last
    return _Peaks(none, runs.sum, halves, halves >> 1, none, np.zeros_like(none))


def _crossings(runs: Runs, found: fir.Crossings, columns: int) -> _Peaks:
    middles = _middles(runs)
    if not runs.row.size or not found.row.size:
        return replace(middles, strength=np.zeros_like(runs.sum))
    begins = runs.row * columns + runs.first
    run = np.maximum(np.searchsorted(begins, found.row * columns + found.after, side="right") - 1, 0)
    mine = (runs.row[run] == found.row) & (runs.first[run] <= found.after) & (found.after <= runs.close[run])
    crossing = np.flatnonzero(mine)
    order = np.lexsort((crossing, -found.contrast[crossing], run[crossing]))
    crossing, run = np.append(crossing[order], [-1, -1]), run[crossing][order]
    begin = np.searchsorted(run, np.arange(runs.row.size))
    amount = np.searchsorted(run, np.arange(runs.row.size), side="right") - begin
    best = np.where(amount > 0, crossing[begin], -1)
    second = np.where(amount > 1, crossing[begin + 1], -1)
    halves = found.before + found.after
    centre = (halves + (found.rise >= found.fall)) >> 1
    return _Peaks(
        crossing=best,
        strength=np.where(best >= 0, found.contrast[best], 0).astype(np.int64),
        halves=np.where(best >= 0, halves[best], middles.halves),
        centre=np.where(best >= 0, centre[best], middles.centre),
        second=second,
        second_strength=np.where(second >= 0, found.contrast[second], 0).astype(np.int64),
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


def _choose(runs: Runs, peaks: _Peaks, rows: int, choice: Choice) -> tuple[Ints, Ints]:
    """The run of each row that is chosen, and of the others the strongest; -1 where there is none.

    Runs are taken one after another, as the card does it: what a run that is chosen displaces is kept as the
    strongest other if it is at least as strong as that; one that is not chosen only if it is stronger.
    """
    best, other = np.full(rows, -1), np.full(rows, -1)
    place = None  # of the last row that had a line
    strength, width, centre = peaks.strength.tolist(), runs.width.tolist(), peaks.centre.tolist()
    last_row = -1
    for run in np.flatnonzero(runs.counts).tolist():
        row = int(runs.row[run])
        if row != last_row:
            if last_row >= 0:
                place = centre[best[last_row]]
            last_row = row
            best[row] = run
            continue
        held, rest = best[row], other[row]
        if choice == Choice.NEAREST and place is not None:
            better = abs(centre[run] - place) < abs(centre[held] - place)
        elif choice == Choice.WIDEST:
            better = width[run] > width[held]
        elif choice == Choice.FIRST:
            better = False
        elif choice == Choice.LAST:
            better = True
        else:
            better = strength[run] > strength[held]
        if better:
            best[row] = run
            if rest < 0 or strength[held] >= strength[rest]:
                other[row] = held
        elif rest < 0 or strength[run] > strength[rest]:
            other[row] = run
    return best, other


def _describe_rival(out: NDArray[np.void], peaks: _Peaks, position: Ints, best: Ints, other: Ints) -> None:
    """The runner-up: the chosen run's own second crossing, or the strongest other run if that is stronger."""
    strength, position = np.append(peaks.strength, -1), np.append(position, 0)
    own = np.where(best >= 0, np.append(peaks.second, -1)[best], -1)
    own_strength = np.where(own >= 0, np.append(peaks.second_strength, 0)[best], -1)
    other_strength = np.where(other >= 0, strength[other], -1)
    crossing = np.where(own_strength >= other_strength, own, np.append(peaks.crossing, -1)[other])
    place = np.where(crossing >= 0, position[crossing], np.append(peaks.halves, 0)[other] << 7)
    rival = np.maximum(own_strength, other_strength)
    some = rival >= 0
    out["second_valid"] = some
    out["second_position"] = np.where(some, place, 0)
    strongest = np.where(best >= 0, strength[best], 0)
    ratio = np.where(strongest > 0, (rival << 8) // np.maximum(strongest, 1), 255)
    out["runner_up"] = np.where(some, np.minimum(ratio, 255), 0)


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
