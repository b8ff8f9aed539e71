"""Robust least squares over all observations at once, with the covariance of everything.

Levenberg and Marquardt's method on the normal equations; their matrix is filled from a sparse Jacobian, for an
observation knows only its own view and image. Large residuals weigh less (Huber). How noisy corners, rows and angles
are is not asked of anybody: it is estimated from the residuals and their redundancy, until it no longer changes
(variance components). Sources: P. J. Huber, "Robust statistics", 1981; K.-R. Koch, "Parameter estimation and
hypothesis testing in linear models", 1999, section 3.6.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Floats, Integers
from ..errors import CalibrationError
from . import rig as rigs
from .observations import Observations
from .rig import Predictions, Rig

HUBER = 2.5
"""Residuals beyond so many sigma weigh less. 1.2 % of good ones do."""

HARMONIC_SIGMAS = (1.0, 1.0, 0.3, 0.3)
"""What an encoder's once- and twice-a-turn errors may be without being measured, counts, 1 sigma."""

TRIM, TRIMMED = 3.0, 0.9733
"""Sigmas are estimated from residuals within 3 sigma, which have this part of the variance of all, were they normal."""

_LINES_ONLY = {*rigs.LASER, *rigs.ENCODER}

MAX_STEPS = 20
CONVERGED = 1e-7
LEAST = {"corner": 0.003, "line": 0.002, "angle": 1e-4}
"""No sigma is believed below: px, px, counts."""


@dataclass(frozen=True)
class Noise:
    """1 sigma of a corner's coordinate (px), of a row's column (px), of an image's angle (counts)."""

    corner: float = 0.1
    line: float = 0.05
    angle: float = 0.01


@dataclass(frozen=True)
class Solution:
    """An estimate and how far it can be trusted.

    Attributes
    ----------
    rig : the estimate
    names : of the free shared parameters, in the order of ``covariance``
    covariance : of the free shared parameters (the rest is eliminated)
    pose_sigmas : (V, 6) rad and mm; NaN where poses were not free
    noise : as estimated
    corners, lines : residuals, (N, 2) and (M,) px, predicted less seen
    cost : robust chi squared
    full : everything needed to test another hypothesis: see :func:`gain`
    """

    rig: Rig
    names: list[str]
    covariance: Floats
    pose_sigmas: Floats
    noise: Noise
    corners: Floats
    lines: Floats
    cost: float
    full: "System"

    def sigma(self, name: str) -> float:
        """1 sigma of a shared parameter, in its local coordinate; 0 where it was held."""
        if name not in self.names:
            return 0.0
        at = self.names.index(name)
        return float(np.sqrt(self.covariance[at, at]))


@dataclass(frozen=True)
class System:
    """Whitened residuals, Jacobian and weights at an estimate."""

    residuals: Floats
    jacobian: Any
    weights: Floats
    inverse: Floats
    groups: Integers


class Solver:
    """Finds the rig that fits observations best.

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

    def solve(self, start: Rig, noise: Noise | None = None, rounds: int = 6) -> Solution:
        """From a start that is about right.

        Raises
        ------
        CalibrationError
            The observations do not determine the parameters.
        """
        noise = noise or Noise()
        rig = start
        for _ in range(rounds):
            rig = self._descend(rig, noise)
            system = self._system(rig, noise)
            before, noise = noise, self._components(rig, noise, system)
            change = max(abs(np.log(a / b)) for a, b in zip(vars(noise).values(), vars(before).values(), strict=True))
            if change < 0.03:
                break
        return self._solution(rig, noise)

    # What is free, in order: shared parameters, poses, angles.

    def free(self, rig: Rig) -> list[int]:
        """Which of the shared parameters are free, and seen by any observation."""
        held = set(self.held)
        for number, board in enumerate(self.seen.boards):
            if board.scale_sigma == 0:
                held.add(f"scale{number}")
        if not self.predictions.images:
            held |= {*rigs.LASER, *rigs.ENCODER}
        return [number for number, name in enumerate(rig.names()) if name not in held]

    def _residuals(self, rig: Rig, noise: Noise, slopes: Floats) -> Floats:
        """Whitened: corners, lines, then what is known beforehand."""
        lines = self._lines(rig, slopes)
        parts = [(self.predictions.corners(rig) / noise.corner).ravel(), lines / noise.line, self._priors(rig, noise)]
        return np.concatenate(parts)

    def _lines(self, rig: Rig, slopes: Floats) -> Floats:
        if rig.laser is None:
            return np.zeros(0)
        # Column predicted less seen: the laser plane is where the height would be 0.
        return -self.predictions.heights(rig) / slopes

    def _priors(self, rig: Rig, noise: Noise) -> Floats:
        scales: Floats = (rig.scales - 1) / self._scale_sigmas
        if rig.laser is None:
            return scales
        harmonics = rig.harmonics / np.array(HARMONIC_SIGMAS)
        return np.concatenate([scales, harmonics, rig.angles / noise.angle])

    def _slopes(self, rig: Rig) -> Floats:
        if rig.laser is None:
            return np.zeros(0)
        slopes = self.predictions.slopes(rig)
        # A line along the rows has no column: such rows are refused elsewhere, here they must not divide by 0.
        return np.where(np.abs(slopes) < 1e-6, 1e-6, slopes)

    def _jacobian(self, rig: Rig, noise: Noise, slopes: Floats) -> Any:
        import scipy.sparse as sparse

        here = self._residuals(rig, noise, slopes)
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
                rest = [self._lines(moved, slopes) / noise.line, self._priors(moved, noise)]
                there = np.concatenate([corners, *rest])
            else:
                there = self._residuals(moved, noise, slopes)
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
                data[:, axis] = (self._residuals(rig.moved(still, move), noise, slopes) - here)[:count] / step
            columns = owner[:, None] * 6 + np.arange(6)
            rows = np.repeat(np.arange(count), 6)
            blocks.append(sparse.csr_matrix((data.ravel(), (rows, columns.ravel())), (len(here), 6 * views)))
        if self.with_angles and at.images and rig.laser is not None:
            by_angle: Floats = np.full(at.images, rigs.ANGLE_STEP)
            moved = rig.moved(still, None, by_angle)
            rest = [self._lines(moved, slopes) / noise.line, self._priors(moved, noise)]
            change = (np.concatenate([here[: len(corner_rows)], *rest]) - here) / rigs.ANGLE_STEP
            priors = np.arange(len(here) - at.images, len(here))
            rows = np.concatenate([line_rows, priors])
            columns = np.concatenate([at.line_image, np.arange(at.images)])
            blocks.append(sparse.csr_matrix((change[rows], (rows, columns)), (len(here), at.images)))
        return sparse.hstack(blocks, format="csr")

    def _move(self, rig: Rig, step: Floats) -> Rig:
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

    def _weights(self, residuals: Floats, priors: int) -> Floats:
        """Huber's; the two coordinates of a corner share one, what is known of scales and harmonics keeps 1."""
        corners = 2 * len(self.predictions.corner_view)
        size = np.abs(residuals)
        pairs = np.hypot(residuals[:corners:2], residuals[1:corners:2]) / np.sqrt(2)
        size[:corners] = np.repeat(pairs, 2)
        size[len(size) - priors : len(size) - self._angles] = 0
        return np.minimum(1.0, HUBER / np.maximum(size, 1e-12))

    def _cost(self, residuals: Floats, priors: int) -> float:
        weight = self._weights(residuals, priors)
        if not np.isfinite(residuals).all():
            return np.inf
        # Huber's loss: r^2 inside, 2 c r - c^2 outside, with r^2 w = c r.
        return float(np.sum(weight * residuals**2 * (2 - weight)))

    def _descend(self, rig: Rig, noise: Noise) -> Rig:
        damping = 1e-6
        priors = len(self._priors(rig, noise))
        slopes = self._slopes(rig)
        residuals = self._residuals(rig, noise, slopes)
        cost = self._cost(residuals, priors)
        if not np.isfinite(cost):
            raise CalibrationError("the start of the fit lies outside what the camera sees: check board and pictures")
        for _ in range(MAX_STEPS):
            jacobian = self._jacobian(rig, noise, slopes)
            weights = self._weights(residuals, priors)
            normal = _normal(jacobian, weights)
            gradient = np.asarray(jacobian.T @ (weights * residuals))
            for _ in range(12):
                step = _solve(normal, gradient, damping)
                there = self._move(rig, -step)
                there_slopes = self._slopes(there)
                there_residuals = self._residuals(there, noise, there_slopes)
                there_cost = self._cost(there_residuals, priors)
                if there_cost <= cost * (1 + 1e-12):
                    break
                damping = min(damping * 10, 1e9)
            else:
                return rig
            gain = cost - there_cost
            rig, slopes, residuals, cost = there, there_slopes, there_residuals, there_cost
            damping = max(damping / 100, 1e-14)
            if gain <= CONVERGED * cost:
                break
        return rig

    def _system(self, rig: Rig, noise: Noise) -> System:
        priors = len(self._priors(rig, noise))
        slopes = self._slopes(rig)
        residuals = self._residuals(rig, noise, slopes)
        jacobian = self._jacobian(rig, noise, slopes)
        weights = self._weights(residuals, priors)
        normal = _normal(jacobian, weights)
        corners = 2 * len(self.predictions.corner_view)
        groups = np.full(len(residuals), 2)
        groups[:corners] = 0
        groups[corners : len(residuals) - priors] = 1
        return System(residuals, jacobian, weights, _invert(normal), groups)

    def _components(self, rig: Rig, noise: Noise, system: System) -> Noise:
        """Sigmas from residuals and redundancy, group by group; what lies beyond 3 sigma tells nothing of them."""
        scaled = []
        for group in (0, 1):
            mine = np.flatnonzero(system.groups == group)
            if not len(mine):
                scaled.append(1.0)
                continue
            normal = _normal(system.jacobian[mine], system.weights[mine])
            used = float(np.sum(normal * system.inverse))
            scaled.append(_scale(system.residuals[mine], np.full(len(mine), 1 - used / len(mine))))
        angle = 1.0
        count = self.predictions.images
        if self.with_angles and count and rig.laser is not None:
            # The less an image tells of its own angle, the less of the angle's scatter shows.
            known = 1 - np.diag(system.inverse)[-count:] / noise.angle**2
            angle = _scale(rig.angles / noise.angle, np.maximum(known, 1e-3))
        return Noise(
            max(noise.corner * scaled[0], LEAST["corner"]),
            max(noise.line * scaled[1], LEAST["line"]),
            max(noise.angle * angle, LEAST["angle"]),
        )

    def _solution(self, rig: Rig, noise: Noise) -> Solution:
        system = self._system(rig, noise)
        free = self.free(rig)
        views = len(self.seen.views)
        poses = np.full((views, 6), np.nan)
        variances = np.diag(system.inverse)
        if self.poses:
            poses = np.sqrt(variances[len(free) : len(free) + 6 * views]).reshape(views, 6)
        names = [rig.names()[number] for number in free]
        priors = len(self._priors(rig, noise))
        return Solution(
            rig,
            names,
            system.inverse[: len(free), : len(free)],
            poses,
            noise,
            self.predictions.corners(rig),
            self._lines(rig, self._slopes(rig)),
            self._cost(system.residuals, priors),
            system,
        )

    def gain(self, found: Solution, columns: Mapping[str, Floats]) -> dict[str, tuple[float, float]]:
        """For each further parameter, by the whitened derivative of all residuals: how much chi squared falls if it is
        freed too, and the value that it then takes (to first order). Source: Rao's score test.
        """
        system = found.full
        result = {}
        for name, column in columns.items():
            projected = column - system.jacobian @ (system.inverse @ (system.jacobian.T @ (system.weights * column)))
            power = float(np.sum(system.weights * projected * column))
            slope = float(np.sum(system.weights * projected * system.residuals))
            if power <= 1e-9 * float(np.sum(column**2)):
                result[name] = (0.0, 0.0)
            else:
                result[name] = (slope**2 / power, -slope / power)
        return result

    def by_counts(self, found: Solution) -> Floats:
        """Whitened derivative of all residuals by a count more in every image."""
        slopes = self._slopes(found.rig)
        moved = replace(found.rig, angles=found.rig.angles + rigs.ANGLE_STEP)
        change = (self._lines(moved, slopes) - self._lines(found.rig, slopes)) / rigs.ANGLE_STEP / found.noise.line
        return self._column(found, None, change)

    def by_points(self, found: Solution, shift: Floats) -> Floats:
        """Whitened derivative of all residuals by a part of ``shift`` (N, 3) mm, by which corners lie elsewhere."""
        step = 1e-3
        there = self.predictions.corners(found.rig, step * shift)
        return self._column(found, (there - self.predictions.corners(found.rig)) / step / found.noise.corner, None)

    def by_columns(self, found: Solution, shift_px: Floats) -> Floats:
        """Whitened derivative of all residuals by a part of ``shift_px`` (M,), by which lines lie elsewhere."""
        return self._column(found, None, shift_px / found.noise.line)

    def _column(self, found: Solution, corners: Floats | None, lines: Floats | None) -> Floats:
        column = np.zeros(len(found.full.residuals))
        count = 2 * len(self.predictions.corner_view)
        if corners is not None:
            column[:count] = corners.ravel()
        if lines is not None:
            column[count : count + len(lines)] = lines
        return column

    def derivative(self, found: Solution, name: str) -> Floats:
        """Whitened derivative of all residuals by a shared parameter that is held."""
        rig, noise = found.rig, found.noise
        slopes = self._slopes(rig)
        step = rigs.STEPS.get(name, rigs.SCALE_STEP)
        move = step * np.eye(len(rig.names()))[rig.names().index(name)]
        there = self._residuals(rig.moved(move), noise, slopes)
        return (there - self._residuals(rig, noise, slopes)) / step


def _normal(jacobian: Any, weights: Floats) -> Floats:
    """J^T W J."""
    weighted = jacobian.copy()
    weighted.data *= np.repeat(weights, np.diff(jacobian.indptr))
    return np.asarray((weighted.T @ jacobian).toarray())


def _solve(normal: Floats, gradient: Floats, damping: float) -> Floats:
    import scipy.linalg as linalg

    scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    scaled = normal / scale[:, None] / scale + damping * np.eye(len(scale))
    try:
        factor = linalg.cho_factor(scaled)
    except linalg.LinAlgError:
        factor = linalg.cho_factor(scaled + 1e-6 * np.eye(len(scale)))
    return np.asarray(linalg.cho_solve(factor, gradient / scale) / scale)


def _scale(values: Floats, known: Floats) -> float:
    """Sigma of ``values``, each of which shows a part ``known`` of its variance, from those within 3 sigma."""
    size = np.abs(values) / np.sqrt(known)
    sigma = 1.4826 * float(np.median(size))
    for _ in range(20):
        inner = size < TRIM * sigma
        if not inner.any():
            break
        sigma = float(np.sqrt(np.sum(values[inner] ** 2) / np.sum(known[inner]) / TRIMMED))
    return max(sigma, 1e-9)


def _invert(normal: Floats) -> Floats:
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    scaled = normal / scale[:, None] / scale
    try:
        inverse = np.linalg.inv(scaled)
    except np.linalg.LinAlgError:
        inverse = np.full_like(scaled, np.inf)
    # Condition number in the 1-norm; beyond this nothing of the inverse is left in double precision.
    condition = np.abs(scaled).sum(axis=0).max() * np.abs(inverse).sum(axis=0).max()
    if not condition < 1e13 or (np.diag(inverse) <= 0).any():
        raise CalibrationError(
            "the observations do not determine the calibration: add views with the board tilted, at other distances and"
            " at other laser angles"
        )
    return np.asarray(inverse / scale[:, None] / scale)
