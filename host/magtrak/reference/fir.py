"""The line as a zero crossing of the smoothed derivative.

After F. Blais and M. Rioux, "Real-time numerical peak detector", Signal Processing 11 (1986): an antisymmetric
filter smooths and differentiates in one, and the peak is where its output falls through zero.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TAPS = (14, 20, 17, 10, 5, 2, 1)
"""Coefficients c_1 to c_7; about k * exp(-k**2 / (2 * 2.1**2)), each a sum of at most two powers of two.

Stripes of amplitude 180 in white noise, RMS error over the Cramer-Rao bound: 1.12 at sigma 1.5 px, 1.10 at 3 px."""

REACH = len(TAPS)
"""Columns to each side that the filter sees."""

DERIVATIVE_MAX = 255 * sum(TAPS)  # 17595 < 2**15
CONTRAST_MAX = 2 * DERIVATIVE_MAX  # 35190 < 2**16

FRACTION = 512
"""Steps of a column in which crossings are interpolated, twice as fine as positions, to round those."""


def _bend(index: int) -> int:
    f = (index + 0.5) / 32
    return round(FRACTION / 16 * f * (1 - f) * (1 - 2 * f))


BEND = tuple(_bend(index) for index in range(32))
"""What a straight line between two samples overstates, in 1/512 px, by the fraction's upper 5 bits.

Near its zero the derivative of a Gaussian of variance v is x * (1 - x**2 / (2 * v)), which puts the crossing of the
chord off by f * (1 - f) * (1 - 2 * f) / (2 * v); v is about 8 for common lines and this filter. This takes the
bias without noise from 0.0058 to 0.0025 px RMS at sigma 1.5 px."""


def derivative(mixed: NDArray[np.int32]) -> NDArray[np.int32]:
    """``d[x] = sum over k of c_k * (m[x + k] - m[x - k])`` along the last axis, borders replicated."""
    columns = mixed.shape[-1]
    padded = np.pad(mixed, [(0, 0)] * (mixed.ndim - 1) + [(REACH, REACH)], mode="edge")
    out = np.zeros_like(mixed)
    for k, tap in enumerate(TAPS, 1):
        ahead = padded[..., REACH + k : REACH + k + columns]
        behind = padded[..., REACH - k : REACH - k + columns]
        out += tap * (ahead - behind)
    return out


@dataclass(frozen=True)
class Crossings:
    """Falling zero crossings in the rows of an image, in order of row and column.

    Attributes
    ----------
    row : row of each
    before : last column with a positive derivative
    after : first column then with a negative one; zeros may lie between
    rise, fall : the derivative at the two, both as magnitudes
    """

    row: NDArray[np.intp]
    before: NDArray[np.intp]
    after: NDArray[np.intp]
    rise: NDArray[np.int32]
    fall: NDArray[np.int32]

    @property
    def contrast(self) -> NDArray[np.int32]:
        """``rise + fall``: how sharply the line stands out. A thin line has much, a lamp or a wall little."""
        return self.rise + self.fall


def crossings(mixed: NDArray[np.int32]) -> Crossings:
    """All falling zero crossings of (rows, columns) ``mixed``."""
    slope = derivative(mixed)
    row, column = np.nonzero(slope)
    value = slope[row, column]
    falls = (row[:-1] == row[1:]) & (value[:-1] > 0) & (value[1:] < 0)
    at = np.flatnonzero(falls)
    return Crossings(
        row=row[at],
        before=column[at],
        after=column[at + 1],
        rise=value[at],
        fall=-value[at + 1],
    )


def position(found: Crossings) -> NDArray[np.int64]:
    """Column of each crossing in 1/256 px, rounded half up.

    Neighbouring samples are joined by a straight line, with :data:`BEND` taken off. One sample of exactly zero
    between them is the crossing. More are a plateau: its middle, moved by the share of the two ends.
    """
    zeros = found.after - found.before - 1
    share = FRACTION * found.rise.astype(np.int64) // np.maximum(found.rise + found.fall, 1)
    bend = np.array(BEND)[np.minimum(share >> 4, 31)]
    share = np.where(zeros == 0, share - bend, np.where(zeros == 1, FRACTION // 2, share))
    fine: NDArray[np.int64] = FRACTION * found.before + FRACTION // 2 * zeros + share
    return (fine + 1) >> 1
