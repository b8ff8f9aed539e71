"""Would one more free parameter explain the residuals? To first order, without another fit: Rao's score test."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..arrays import Floats
from . import rig as rigs
from .problem import Problem
from .solve import Solution


def gain(found: Solution, columns: Mapping[str, Floats]) -> dict[str, tuple[float, float]]:
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


def by_counts(problem: Problem, found: Solution) -> Floats:
    """Whitened derivative of all residuals by a count more in every image."""
    slopes = problem.slopes(found.rig)
    moved = replace(found.rig, angles=found.rig.angles + rigs.ANGLE_STEP)
    change = (problem.lines(moved, slopes) - problem.lines(found.rig, slopes)) / rigs.ANGLE_STEP / found.noise.line
    return _column(problem, found, None, change)


def by_points(problem: Problem, found: Solution, shift: Floats) -> Floats:
    """Whitened derivative of all residuals by a part of ``shift`` (N, 3) mm, by which corners lie elsewhere."""
    step = 1e-3
    there = problem.predictions.corners(found.rig, step * shift)
    return _column(problem, found, (there - problem.predictions.corners(found.rig)) / step / found.noise.corner, None)


def by_columns(problem: Problem, found: Solution, shift_px: Floats) -> Floats:
    """Whitened derivative of all residuals by a part of ``shift_px`` (M,), by which lines lie elsewhere."""
    return _column(problem, found, None, shift_px / found.noise.line)


def _column(problem: Problem, found: Solution, corners: Floats | None, lines: Floats | None) -> Floats:
    column = np.zeros(len(found.full.residuals))
    count = 2 * len(problem.predictions.corner_view)
    if corners is not None:
        column[:count] = corners.ravel()
    if lines is not None:
        column[count : count + len(lines)] = lines
    return column


def derivative(problem: Problem, found: Solution, name: str) -> Floats:
    """Whitened derivative of all residuals by a shared parameter that is held."""
    rig, noise = found.rig, found.noise
    slopes = problem.slopes(rig)
    step = rigs.STEPS.get(name, rigs.SCALE_STEP)
    move = step * np.eye(len(rig.names()))[rig.names().index(name)]
    there = problem.residuals(rig.moved(move), noise, slopes)
    return (there - problem.residuals(rig, noise, slopes)) / step
