"""Corners of squares: found in windows that were drawn without the model that is fitted to them."""

import numpy as np
import pytest

from magtrak.calibrate.corner import fit_corners
from sim.blur import smear

FINE = 20


def drawn(rng: np.random.Generator, side: float, turn: float, blur: float, noise: float, marker: bool = True):
    """A picture of 81 x 81 pixels with a corner of squares near its middle: the picture, the corner, and its sides."""
    corner = 40 + rng.uniform(-0.5, 0.5, 2)
    across = side * np.array([np.cos(turn), np.sin(turn)])
    down = side * 0.8 * np.array([-np.sin(turn - 0.2), np.cos(turn - 0.2)])
    fine = (np.arange(81 * FINE) + 0.5) / FINE - 0.5
    x, y = np.meshgrid(fine - corner[0], fine - corner[1])
    area = across[0] * down[1] - across[1] * down[0]
    right, below = (x * down[1] - y * down[0]) / area, (y * across[0] - x * across[1]) / area
    white = (np.floor(right) + np.floor(below)) % 2 == 0
    if marker:  # what is printed in white squares begins an eighth of a side from the edges
        white &= ~((np.abs(right % 1 - 0.5) < 0.375) & (np.abs(below % 1 - 0.5) < 0.375))
    exact = 40 + 150.0 * white
    picture = smear(smear(exact, blur * FINE, 0, FINE), blur * FINE, 1, FINE)
    picture = np.clip(np.round(picture + rng.normal(0, noise, picture.shape)), 0, 255)
    return picture.astype(np.uint8), corner, across, down


@pytest.mark.parametrize("side", [18.0, 30.0, 60.0])
def test_a_corner_is_found_to_a_hundredth_of_a_pixel(side: float) -> None:
    rng = np.random.default_rng(round(side))
    errors = []
    for _ in range(6):
        picture, corner, across, down = drawn(rng, side, rng.uniform(-1.5, 1.5), rng.uniform(0.4, 0.9), 1.5)
        start = corner + rng.uniform(-0.25, 0.25, 2)
        # Perspective is known roughly only.
        sides = [edge + rng.normal(0, 0.02 * side, 2) for edge in (across, down)]
        found = fit_corners(picture, start[None], sides[0][None], sides[1][None], 0.125)
        errors.append(found[0] - corner)
    error = float(np.sqrt(np.mean(np.square(errors))))
    print(f"side {side:g} px: {error:.4f} px RMS")
    assert error < (0.02 if side < 20 else 0.01)


def test_what_is_no_corner_stays_where_it_is() -> None:
    rng = np.random.default_rng(4)
    picture, corner, across, down = drawn(rng, 30, 0.3, 0.6, 1.5)
    sides = across[None], down[None]
    noise = rng.integers(0, 255, picture.shape).astype(np.uint8)
    for other, what in ((noise, "noise"), (np.full_like(picture, 90), "nothing")):
        start = corner[None] + 0.2
        assert np.array_equal(fit_corners(other, start, *sides, 0.125), start), what
    far = corner[None] + 1.5  # farther than a fit may go
    assert np.array_equal(fit_corners(picture, far, *sides, 0.125), far)
    border = np.array([[1.2, 40.3], [40.0, 79.6]])
    twice = (np.repeat(side, 2, axis=0) for side in sides)
    assert np.array_equal(fit_corners(picture, border, *twice, 0.125), border)
    tiny = fit_corners(picture, corner[None], across[None] / 10, down[None] / 10, 0.125)
    assert np.array_equal(tiny, corner[None]), "squares of 3 px have no pixels to spare"


def test_many_corners_do_not_disturb_each_other() -> None:
    rng = np.random.default_rng(5)
    picture, corner, across, down = drawn(rng, 30, 0.3, 0.6, 1.5)
    starts = np.array([corner + 0.1, [20.0, 20.0], corner - 0.2, [3.0, 40.0]])
    found = fit_corners(picture, starts, np.tile(across, (4, 1)), np.tile(down, (4, 1)), 0.125)
    alone = fit_corners(picture, starts[:1], across[None], down[None], 0.125)
    assert found[0] == pytest.approx(alone[0], abs=1e-4)
    assert found[2] == pytest.approx(found[0], abs=2e-3)
    assert np.array_equal(found[3], starts[3])
