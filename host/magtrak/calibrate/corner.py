"""Corners of squares to a hundredth of a pixel: a blurred corner is fitted to the grey levels along its edges.

Where four squares meet, a picture has the level ``m + k erf(u / s) erf(v / s)``; u and v are the distances from the two
edges, and s is the blur. Seven numbers of each corner (place, two directions, s, m, k) are found by least squares, all
corners of a picture at once. OpenCV's ``cornerSubPix``, from which the fit starts, only asks that gradients point away
from the corner, in a window that has no room beside markers; its errors are nine times as large on the same pictures.
"""

import numpy as np

from ..arrays import Booleans, Floats

STEPS = 12
REACH = 0.32
"""Part of a square's side to which edges are looked at, from the corner."""

MOST_PX = 14
"""No window reaches farther: edges bend with the lens."""

CLEAR_PX = 1.2
"""The blur of what else is printed stays so far away."""

LEAST = 24
"""Pixels that are enough for seven numbers."""

MOVED_PX = 0.5
"""A fit that ends farther from its start has found something else."""

MISFIT = 0.2
"""Greatest RMS of what is left, in parts of k, half the contrast."""

BLUR_PX = (0.2, 4.0)


def fit_corners(picture: Floats, corners: Floats, across: Floats, down: Floats, free: float) -> Floats:
    """(N, 2) refined corners; those that cannot be fitted stay as they are.

    Parameters
    ----------
    picture : (H, W) grey levels
    corners : (N, 2) column and row, to half a pixel
    across, down : (N, 2) sides of a square in the picture, px, at each corner
    free : part of a square's side that is blank beside its edges
    """
    height, width = picture.shape
    half = int(np.clip(np.ceil(REACH * np.abs([across, down]).max(initial=0.0)), 3, MOST_PX))
    whole = np.round(corners).astype(np.int64)
    inside = np.flatnonzero(np.all((whole >= half) & (whole < np.array([width, height]) - half), axis=1))
    result = corners.copy()
    reach = np.arange(-half, half + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(reach, reach))
    at = whole[inside]
    start = corners[inside] - at
    used = _along_edges(x - start[:, :1], y - start[:, 1:], across[inside], down[inside], free)
    enough = used.sum(axis=1) >= LEAST
    inside, at, start, used = inside[enough], at[enough], start[enough], used[enough]
    if not len(inside):
        return result
    levels = picture[at[:, 1, None] + y, at[:, 0, None] + x].astype(np.float64)
    found, good = _fit(levels, used, x.astype(np.float64), y.astype(np.float64), start, across[inside], down[inside])
    good &= np.linalg.norm(found - start, axis=1) < MOVED_PX
    result[inside[good]] = (found + at)[good]
    return result


def _along_edges(x: Floats, y: Floats, across: Floats, down: Floats, free: float) -> Booleans:
    """(N, P) pixels at x, y (N, P) from the corner near one of its edges, clear of what is printed in the squares."""
    area = across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]
    area = np.where(np.abs(area) < 1e-9, np.inf, area)[:, None]
    # Sides of a square to the right and down, and the same of CLEAR_PX across either edge.
    right = np.abs((x * down[:, 1:] - y * down[:, :1]) / area)
    below = np.abs((y * across[:, :1] - x * across[:, 1:]) / area)
    clear_right = CLEAR_PX * np.linalg.norm(down, axis=1)[:, None] / np.abs(area)
    clear_below = CLEAR_PX * np.linalg.norm(across, axis=1)[:, None] / np.abs(area)
    beside = (right < free - clear_right) | (below < free - clear_below)
    return np.asarray(beside & (np.maximum(right, below) < REACH))


def _fit(
    levels: Floats, used: Booleans, x: Floats, y: Floats, start: Floats, across: Floats, down: Floats
) -> tuple[Floats, Booleans]:
    """Levenberg and Marquardt's method on N windows (N, P) at once: places (N, 2), and which are to be believed."""
    count = used.sum(axis=1)
    mean = np.sum(levels * used, axis=1) / count
    ones = np.ones(len(levels))
    # The distance from an edge is measured along its normal.
    first, second = (np.arctan2(edge[:, 0], -edge[:, 1]) for edge in (across, down))
    values = np.stack([start[:, 0], start[:, 1], first, second, ones, mean, ones], axis=1)
    shape = (_model(values, x, y)[0] - mean[:, None]) * used
    values[:, 6] = np.sum(shape * (levels - mean[:, None]), axis=1) / np.maximum(np.sum(shape**2, axis=1), 1e-9)
    damping = np.full(len(levels), 1e-3)
    off, slopes, cost = _misfit(values, levels, used, x, y)
    for _ in range(STEPS):
        normal = np.einsum("npi,npj->nij", slopes, slopes, optimize=True)
        gradient = np.einsum("npi,np->ni", slopes, off)
        extra = damping[:, None] * np.einsum("nii->ni", normal) + 1e-9
        there = values - np.linalg.solve(normal + np.eye(7) * extra[:, None], gradient[..., None])[..., 0]
        there[:, 4] = np.clip(there[:, 4], *BLUR_PX)
        there_off, there_slopes, there_cost = _misfit(there, levels, used, x, y)
        better = there_cost < cost
        values[better], off[better], slopes[better] = there[better], there_off[better], there_slopes[better]
        cost = np.where(better, there_cost, cost)
        damping = np.where(better, damping / 10, damping * 10)
    return values[:, :2], np.sqrt(cost / count) < MISFIT * np.abs(values[:, 6])


def _misfit(values: Floats, levels: Floats, used: Booleans, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Model less levels (N, P), its derivatives (N, P, 7), and the sums (N,) of squares."""
    model, slopes = _model(values, x, y)
    off = (model - levels) * used
    return off, slopes * used[..., None], np.sum(off**2, axis=1)


def _model(values: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Levels (N, P) at pixels (P,), and their derivatives (N, P, 7)."""
    from scipy.special import erf

    dx, dy, a, b, s, m, k = (part[:, None] for part in values.T)
    right, below = x - dx, y - dy
    u, v = (np.cos(a) * right + np.sin(a) * below) / s, (np.cos(b) * right + np.sin(b) * below) / s
    eu, ev = erf(u), erf(v)
    du, dv = (k * 2 / np.sqrt(np.pi) * np.exp(-(part**2)) * other for part, other in ((u, ev), (v, eu)))
    slopes = np.stack(
        [
            -(du * np.cos(a) + dv * np.cos(b)) / s,
            -(du * np.sin(a) + dv * np.sin(b)) / s,
            du * (np.cos(a) * below - np.sin(a) * right) / s,
            dv * (np.cos(b) * below - np.sin(b) * right) / s,
            -(du * u + dv * v) / s,
            np.ones_like(u),
            eu * ev,
        ],
        axis=-1,
    )
    return m + k * eu * ev, slopes
