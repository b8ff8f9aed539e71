"""The swept laser plane: encoder counts to angles, angles to planes in the camera frame.

Laser frame L: Z_L along the rotation axis, X_L along the light at alpha = 0. At angle alpha the plane has the normal
n(alpha) = Rz(alpha) (0, cos tilt, sin tilt) and the equation n . P = offset; tilt = offset = 0 is eq 6 of the paper.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .arrays import Floats


@dataclass(frozen=True)
class Laser:
    """A laser plane turned by a motor with an encoder.

    Parameters
    ----------
    camera_from_laser : (4, 4), takes points of L to C, mm
    offset_mm : signed distance of the axis from the plane
    tilt_rad : angle between the plane and the axis
    zero_rad : alpha at the index
    sense : 1 or -1, direction of alpha against that of the counts
    counts_per_turn : counts of one turn
    error_table : counts to add, equally spaced over the turn from the index on, linear between; empty for none
    """

    camera_from_laser: Floats
    offset_mm: float = 0.0
    tilt_rad: float = 0.0
    zero_rad: float = 0.0
    sense: int = 1
    counts_per_turn: int = 8192
    error_table: Floats = field(default_factory=lambda: np.zeros(0))

    def corrected(self, counts: Floats) -> Floats:
        """Positions in counts from the index (fractions included), with the error table's part added."""
        counts = np.asarray(counts, dtype=np.float64)
        if len(self.error_table):
            lines = len(self.error_table)
            closed = np.append(self.error_table, self.error_table[0])
            at = np.mod(counts * (lines / self.counts_per_turn), lines)
            counts = counts + np.interp(at, np.arange(lines + 1), closed)
        return counts

    def alpha(self, counts: Floats) -> Floats:
        """Angles in rad, wrapped to +-pi, of positions in counts from the index (fractions included)."""
        turns = self.corrected(counts) * (self.sense / self.counts_per_turn)
        turns += self.zero_rad / (2 * np.pi)
        turns -= np.rint(turns)
        turns *= 2 * np.pi
        return turns

    def planes(self, alpha: Floats) -> tuple[Floats, Floats]:
        """Planes n . P = d in C: unit normals (N, 3) and d (N,) in mm, for angles (N,), as exact as these are."""
        sine = np.sin(alpha).astype(np.float64, copy=False)
        cosine = np.cos(alpha).astype(np.float64, copy=False)
        planes = np.empty((4, len(sine)))
        for out, (of_sine, of_cosine, constant) in zip(planes, self._parts, strict=True):
            np.multiply(sine, of_sine, out=out)
            out += of_cosine * cosine
            out += constant
        return planes[:3].T, planes[3]

    @cached_property
    def _parts(self) -> list[list[float]]:
        """The coefficients of sin(alpha), cos(alpha) and 1 in the normal's components and in d, which are linear in
        them: (4, 3).
        """
        cos_tilt, sin_tilt = np.cos(self.tilt_rad), np.sin(self.tilt_rad)
        # Columns: the laser's axes in C; n = -sin(alpha) cos(tilt) X + cos(alpha) cos(tilt) Y + sin(tilt) Z.
        axes, origin = self.camera_from_laser[:3, :3], self.camera_from_laser[:3, 3]
        normal = np.array([-cos_tilt, cos_tilt, sin_tilt])[:, None] * axes.T
        d = normal @ origin + [0, 0, self.offset_mm]
        coefficients: list[list[float]] = np.hstack([normal, d[:, None]]).T.tolist()
        return coefficients
