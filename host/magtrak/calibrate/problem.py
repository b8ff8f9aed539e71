"""What a calibration's fit makes small: whitened residuals of corners and rows, what is known beforehand, and how they
change with every parameter.

The Jacobian is sparse, for an observation knows only its own view and image. Large residuals weigh less (Huber).
Source: P. J. Huber, "Robust statistics", 1981.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Floats
from . import rig as rigs
from .observations import Observations
from .rig import Predictions, Rig

HUBER = 2.5
"""Residuals beyond so many sigma weigh less. 1.2 % of good ones do."""

HARMONIC_SIGMAS = (1.0, 1.0, 0.3, 0.3)
"""What an encoder's once- and twice-a-turn errors may be without being measured, counts, 1 sigma."""

_LINES_ONLY = {*rigs.LASER, *rigs.ENCODER}


@dataclass(frozen=True)
class Noise:
    """1 sigma of a corner's coordinate (px), of a row's column (px), of an image's angle (counts)."""

    corner: float = 0.1
    line: float = 0.05
    angle: float = 0.01


class Problem:
    """Residuals of observations, by the rig, and their derivatives.

    Free are, in this order: shared parameters, poses of the boards, angle errors of the images.

    Parameters
    ----------
    seen : the observations
    held : names of shared parameters that stay where they are
    poses, angles : whether board poses and the images' angle errors are free
    """

    def __init__(
        self, seen: Observations, held: frozenset[str] = frozenset(), *, poses: bool = True, angles: bool = True
    ) -> None:
        self.predictions = Predictions(seen)
        self.seen = seen
        self.held = held
        self.poses = poses
        self.with_angles = angles
        self._angles = self.predictions.images if angles else 0
        self._scale_sigmas = np.array([max(board.scale_sigma, 1e-9) for board in seen.boards])

    def free(self, rig: Rig) -> list[int]:
        """Which of the shared parameters are free, and seen by any observation."""
        held = set(self.held)
        for number, board in enumerate(self.seen.boards):
            if board.scale_sigma == 0:
                held.add(f"scale{number}")
        if not self.predictions.images:
            held |= {*rigs.LASER, *rigs.ENCODER}
        return [number for number, name in enumerate(rig.names()) if name not in held]

    def residuals(self, rig: Rig, noise: Noise, slopes: Floats) -> Floats:
        """Whitened: corners, lines, then what is known beforehand."""
        lines = self.lines(rig, slopes)
        parts = [(self.predictions.corners(rig) / noise.corner).ravel(), lines / noise.line, self.priors(rig, noise)]
        return np.concatenate(parts)

    def lines(self, rig: Rig, slopes: Floats) -> Floats:
        """Columns predicted less seen, (M,) px, to first order."""
        if rig.laser is None:
            return np.zeros(0)
        # The laser plane is where the height would be 0.
        return -self.predictions.heights(rig) / slopes

    def priors(self, rig: Rig, noise: Noise) -> Floats:
        """Whitened: what is known beforehand of the boards' scales, the encoder's errors, the images' angles."""
        scales: Floats = (rig.scales - 1) / self._scale_sigmas
        if rig.laser is None:
            return scales
        harmonics = rig.harmonics / np.array(HARMONIC_SIGMAS)
        return np.concatenate([scales, harmonics, rig.angles / noise.angle])

    def slopes(self, rig: Rig) -> Floats:
        """Change of each row's height over the laser's plane with its column, (M,) mm / px."""
        if rig.laser is None:
            return np.zeros(0)
        slopes = self.predictions.slopes(rig)
        # A line along the rows has no column: such rows are refused elsewhere, here they must not divide by 0.
        return np.where(np.abs(slopes) < 1e-6, 1e-6, slopes)

    def jacobian(self, rig: Rig, noise: Noise, slopes: Floats) -> Any:
        """Sparse, of :meth:`residuals` by all that is free, from differences; ``slopes`` are held."""
        import scipy.sparse as sparse

        here = self.residuals(rig, noise, slopes)
        names = rig.names()
        free = self.free(rig)
        at = self.predictions
        corner_rows = np.arange(2 * len(at.corner_view))
        line_rows = len(corner_rows) + np.arange(len(at.line_view) if rig.laser is not None else 0)
        shared = np.zeros((len(here), len(free)))
        for column, number in enumerate(free):
            step = rigs.STEPS.get(names[number], rigs.SCALE_STEP)
            moved = rig.moved(step * np.eye(len(names))[number])
            if names[number] in _LINES_ONLY:  # corners know nothing of the laser
                corners = here[: len(corner_rows)]
                rest = [self.lines(moved, slopes) / noise.line, self.priors(moved, noise)]
                there = np.concatenate([corners, *rest])
            else:
                there = self.residuals(moved, noise, slopes)
            shared[:, column] = (there - here) / step
        blocks = [sparse.csr_matrix(shared)]
        still = np.zeros(len(names))
        views = len(self.seen.views)
        if self.poses:
            owner = np.concatenate([np.repeat(at.corner_view, 2), at.line_view[: len(line_rows)]])
            count = len(owner)
            data: Floats = np.zeros((count, 6))
            for axis, step in enumerate(rigs.POSE_STEPS):
                move = np.zeros((views, 6))
                move[:, axis] = step
                data[:, axis] = (self.residuals(rig.moved(still, move), noise, slopes) - here)[:count] / step
            columns = owner[:, None] * 6 + np.arange(6)
            rows = np.repeat(np.arange(count), 6)
            blocks.append(sparse.csr_matrix((data.ravel(), (rows, columns.ravel())), (len(here), 6 * views)))
        if self.with_angles and at.images and rig.laser is not None:
            by_angle: Floats = np.full(at.images, rigs.ANGLE_STEP)
            moved = rig.moved(still, None, by_angle)
            rest = [self.lines(moved, slopes) / noise.line, self.priors(moved, noise)]
            change = (np.concatenate([here[: len(corner_rows)], *rest]) - here) / rigs.ANGLE_STEP
            priors = np.arange(len(here) - at.images, len(here))
            rows = np.concatenate([line_rows, priors])
            columns = np.concatenate([at.line_image, np.arange(at.images)])
            blocks.append(sparse.csr_matrix((change[rows], (rows, columns)), (len(here), at.images)))
        return sparse.hstack(blocks, format="csr")

    def move(self, rig: Rig, step: Floats) -> Rig:
        """The rig, a step in all that is free away."""
        free = self.free(rig)
        shared = np.zeros(len(rig.names()))
        shared[free] = step[: len(free)]
        at = len(free)
        poses = angles = None
        if self.poses:
            views = len(self.seen.views)
            poses = step[at : at + 6 * views].reshape(views, 6)
            at += 6 * views
        if at < len(step):
            angles = step[at:]
        return rig.moved(shared, poses, angles)

    def weights(self, residuals: Floats, priors: int) -> Floats:
        """Huber's; the two coordinates of a corner share one, what is known of scales and harmonics keeps 1."""
        corners = 2 * len(self.predictions.corner_view)
        size = np.abs(residuals)
        pairs = np.hypot(residuals[:corners:2], residuals[1:corners:2]) / np.sqrt(2)
        size[:corners] = np.repeat(pairs, 2)
        size[len(size) - priors : len(size) - self._angles] = 0
        return np.minimum(1.0, HUBER / np.maximum(size, 1e-12))

    def cost(self, residuals: Floats, priors: int) -> float:
        """Robust chi squared of whitened residuals, the last ``priors`` of which are :meth:`priors`."""
        weight = self.weights(residuals, priors)
        if not np.isfinite(residuals).all():
            return np.inf
        # Huber's loss: r^2 inside, 2 c r - c^2 outside, with r^2 w = c r.
        return float(np.sum(weight * residuals**2 * (2 - weight)))
