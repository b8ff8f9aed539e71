"""Robust least squares over all observations at once, with the covariance of everything.

Levenberg and Marquardt's method on the normal equations. How noisy corners, rows and angles are is not asked of
anybody: it is estimated from the residuals and their redundancy, until it no longer changes (variance components).
Source: K.-R. Koch, "Parameter estimation and hypothesis testing in linear models", 1999, section 3.6.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Floats, Integers
from ..errors import CalibrationError
from . import normal as equations
from .problem import Noise, Problem
from .rig import Rig

MAX_STEPS = 20
CONVERGED = 1e-7
LEAST = {"corner": 0.003, "line": 0.002, "angle": 1e-4}
"""No sigma is believed below: px, px, counts."""


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
    full : everything needed to test another hypothesis: see :mod:`.score`
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


class Solver(Problem):
    """Finds the rig that fits observations best."""

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

    def _descend(self, rig: Rig, noise: Noise) -> Rig:
        damping = 1e-6
        priors = len(self.priors(rig, noise))
        slopes = self.slopes(rig)
        residuals = self.residuals(rig, noise, slopes)
        cost = self.cost(residuals, priors)
        if not np.isfinite(cost):
            raise CalibrationError("the start of the fit lies outside what the camera sees: check board and pictures")
        for _ in range(MAX_STEPS):
            jacobian = self.jacobian(rig, noise, slopes)
            weights = self.weights(residuals, priors)
            normal = equations.normal(jacobian, weights)
            gradient = np.asarray(jacobian.T @ (weights * residuals))
            for _ in range(12):
                step = equations.solve(normal, gradient, damping)
                there = self.move(rig, -step)
                there_slopes = self.slopes(there)
                there_residuals = self.residuals(there, noise, there_slopes)
                there_cost = self.cost(there_residuals, priors)
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
        priors = len(self.priors(rig, noise))
        slopes = self.slopes(rig)
        residuals = self.residuals(rig, noise, slopes)
        jacobian = self.jacobian(rig, noise, slopes)
        weights = self.weights(residuals, priors)
        normal = equations.normal(jacobian, weights)
        corners = 2 * len(self.predictions.corner_view)
        groups = np.full(len(residuals), 2)
        groups[:corners] = 0
        groups[corners : len(residuals) - priors] = 1
        return System(residuals, jacobian, weights, equations.invert(normal), groups)

    def _components(self, rig: Rig, noise: Noise, system: System) -> Noise:
        """Sigmas from residuals and redundancy, group by group; what lies beyond 3 sigma tells nothing of them."""
        scaled = []
        for group in (0, 1):
            mine = np.flatnonzero(system.groups == group)
            if not len(mine):
                scaled.append(1.0)
                continue
            normal = equations.normal(system.jacobian[mine], system.weights[mine])
            used = float(np.sum(normal * system.inverse))
            scaled.append(equations.scale(system.residuals[mine], np.full(len(mine), 1 - used / len(mine))))
        angle = 1.0
        count = self.predictions.images
        if self.with_angles and count and rig.laser is not None:
            # The less an image tells of its own angle, the less of the angle's scatter shows.
            known = 1 - np.diag(system.inverse)[-count:] / noise.angle**2
            angle = equations.scale(rig.angles / noise.angle, np.maximum(known, 1e-3))
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
        priors = len(self.priors(rig, noise))
        return Solution(
            rig,
            names,
            system.inverse[: len(free), : len(free)],
            poses,
            noise,
            self.predictions.corners(rig),
            self.lines(rig, self.slopes(rig)),
            self.cost(system.residuals, priors),
            system,
        )
