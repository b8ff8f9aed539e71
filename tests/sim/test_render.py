"""Rendered pictures against figures worked out by hand.

Most cases: a white wall at Z = 2000 that faces a camera with f = 800 px, so that a pixel is 2.5 mm, and a laser 500 mm
to the left: its line stands at X = 2000 tan(alpha) - 500.
"""

from math import atan, cos, sin, sqrt, tan

import numpy as np
import pytest

from sim.render import Renderer
from sim.surfaces import Plane, Sphere
from tests.sim.rig import at, centroid, rig

MIDDLE = atan(500 / 2000)
SIGMA_PX = 3 / cos(MIDDLE) / 2.5


def column(alpha: float) -> float:
    return 80 + (2000 * tan(alpha) - 500) / 2.5


def still(alpha: float):
    return lambda times: np.full(np.shape(times), alpha)


def light(renderer: Renderer, angle, times=None) -> np.ndarray:
    timing = renderer.scene.timing
    times = timing.rows(1.0) if times is None else times
    return renderer.light(0, len(times), *renderer.exposure(*timing.exposed(times), angle)).astype(float)


@pytest.mark.parametrize("shift_rad", [-0.05, -0.01, 0.0, 0.00013, 0.01, 0.05])
def test_line_on_a_wall(shift_rad: float) -> None:
    picture = light(Renderer(rig()), still(MIDDLE + shift_rad))
    assert centroid(picture) == pytest.approx(column(MIDDLE + shift_rad), abs=0.003)
    columns = np.arange(160)
    variance = (picture * (columns - centroid(picture)[:, None]) ** 2).sum(1) / picture.sum(1)
    # Three sub-pixels, moved to their pixel's centre, add (1 - 1/9) / 12.
    alpha = MIDDLE + shift_rad
    assert variance == pytest.approx((3 / cos(alpha) / 2.5) ** 2 + (1 - 1 / 9) / 12, rel=0.01)
    # Level: 200 at 2000 mm; range 2000 / cos, incidence cos, so cos^2 of it in all.
    assert picture.sum(1) == pytest.approx(200 * cos(alpha) ** 2 * sqrt(2 * np.pi) * 3 / cos(alpha) / 2.5, rel=0.01)


def test_line_with_distortion_lies_where_the_distorted_camera_sees_it() -> None:
    scene = rig(distortion=(-0.3, 0.1, 0.002, -0.001, 0.0))
    alpha = MIDDLE + 0.04
    goal = scene.camera.project([[2000 * tan(alpha) - 500, 0.0, 2000.0]])[0]
    row = round(goal[1])
    assert abs(goal[0] - column(alpha)) > 0.01
    assert centroid(light(Renderer(scene), still(alpha)))[row] == pytest.approx(goal[0], abs=0.003)


def test_line_on_a_sphere() -> None:
    """In the plane Y = 0 the sheet is the line (-500, 0) + t (sin a, cos a), and the sphere a circle."""
    radius, z = 300.0, 2000.0
    renderer = Renderer(rig([Sphere(radius, at(0, 0, z))], waist_mm=1.0))
    for alpha in (MIDDLE - 0.03, MIDDLE, MIDDLE + 0.04):
        b = -500 * sin(alpha) - z * cos(alpha)
        t = -b - sqrt(b * b - (500**2 + z**2 - radius**2))
        goal = 80 + 800 * (-500 + t * sin(alpha)) / (t * cos(alpha))
        assert centroid(light(renderer, still(alpha)))[12] == pytest.approx(goal, abs=0.005)


def test_shadow() -> None:
    """A sheet of paper at Z = 1000 with X from -101 to 101 shades X from 298 to 702 of the wall at 2000."""
    scene = rig([Plane(pose=at(0, 0, 2000)), Plane((202, 4000), at(0, 0, 1000))], focal_px=200)
    view = Renderer(scene).view
    x = (np.arange(160 * 6).reshape(160, 6) // 6 + np.tile([-1 / 3, 0, 1 / 3], 2) - 80).ravel()
    paper = np.abs(x) < 20.2
    assert np.array_equal(view.face[5] == 8, paper)
    shaded = (x > 29.8) & (x < 70.2)
    assert np.array_equal(view.lit[5], ~shaded)
    renderer = Renderer(scene)
    # The plane that would light X = 500 of the wall, without the paper.
    lit = light(renderer, still(atan(1000 / 2000)))[5]
    assert np.all(lit[(80 + 30) :] == 0)
    assert lit.argmax() == 80  # it falls on the paper: X = 0 at Z = 1000


def test_exposure_widens_the_line() -> None:
    exposure, speed = 0.004, 2.0
    renderer = Renderer(rig(exposure_s=exposure))
    times = np.full(24, 1.0)
    picture = light(renderer, lambda t: MIDDLE + speed * (t - (1.0 - exposure / 2)), times)
    assert centroid(picture) == pytest.approx(80, abs=0.005)
    variance = (picture * (np.arange(160) - centroid(picture)[:, None]) ** 2).sum(1) / picture.sum(1)
    blur_px = speed * exposure * 2000 / cos(MIDDLE) ** 2 / 2.5
    assert blur_px > 5
    assert variance == pytest.approx(SIGMA_PX**2 + (1 - 1 / 9) / 12 + blur_px**2 / 12, rel=0.005)
    # The light is spread, not lost.
    assert picture.sum() == pytest.approx(light(renderer, still(MIDDLE), times).sum(), rel=1e-3)


def test_rows_see_the_angle_of_their_own_time() -> None:
    scene = rig(exposure_s=0.002, readout_delay_s=0.0007)
    times = scene.timing.rows(1.0)

    def angle(t):
        return MIDDLE + 3.0 * (t - 1.0)

    goal = [column(angle(t - 0.0007 - 0.001)) for t in times]
    assert goal[-1] - goal[0] > 5
    assert centroid(light(Renderer(scene), angle)) == pytest.approx(goal, abs=0.01)


def test_full_turns_of_the_motor_change_nothing() -> None:
    renderer = Renderer(rig())
    once = light(renderer, still(MIDDLE))
    assert once.max() > 100
    assert light(renderer, still(MIDDLE + 6 * np.pi)) == pytest.approx(once, abs=0.01)
    assert light(renderer, still(MIDDLE - 4 * np.pi)) == pytest.approx(once, abs=0.01)
    assert light(renderer, still(MIDDLE + np.pi)).max() == 0


def draw(renderer: Renderer, frame: int = 0, alpha: float = MIDDLE, laser_on: bool = True) -> np.ndarray:
    height = renderer.scene.camera.height
    return renderer.rows(frame, 0, height, renderer.scene.timing.rows(1.0), still(alpha), laser_on)


def test_noise() -> None:
    renderer = Renderer(rig(height=120, noise=2.0, ambient=100.0), seed=1)
    first, second = (draw(renderer, frame, laser_on=False).astype(float) for frame in (0, 1))
    assert first.mean() == pytest.approx(100, abs=0.05)
    assert first.std() == pytest.approx(sqrt(4 + 1 / 12), rel=0.02)
    a, b = first.ravel() - 100, second.ravel() - 100
    assert abs(np.mean(a * b)) < 0.1
    assert abs(np.mean((first[..., 0] - 100) * (first[..., 1] - 100))) < 0.1


def test_speckle() -> None:
    """Light all over the picture (a sheet as wide as a wall): its contrast is the given one, its mean unchanged."""
    pictures = {
        contrast: draw(Renderer(rig(height=120, waist_mm=3000.0, speckle=contrast, peak=120.0), seed=4))[..., 1]
        for contrast in (0.0, 0.1, 0.3)
    }
    for contrast in (0.1, 0.3):
        ratio = pictures[contrast] / pictures[0.0].astype(float)
        assert ratio.mean() == pytest.approx(1, abs=0.01)
        assert ratio.std() == pytest.approx(contrast, rel=0.04)
        # A gamma distribution of that contrast has twice it as skewness. (0.3 clips the few brightest pixels.)
        if contrast == 0.1:
            assert np.mean((ratio - ratio.mean()) ** 3) / ratio.std() ** 3 == pytest.approx(0.2, abs=0.06)


def test_same_seed_same_picture_whatever_the_portions() -> None:
    scene = rig(noise=2.0, speckle=0.2, ambient=10.0, exposure_s=0.001)
    times = scene.timing.rows(1.0)

    def angle(t):
        return MIDDLE + 0.5 * (t - 1.0)

    whole = Renderer(scene, seed=7).rows(3, 0, 24, times, angle)
    other = Renderer(scene, seed=7)
    draw(other, 2)
    parts = [other.rows(3, a, a + 6, times[a : a + 6], angle) for a in range(0, 24, 6)]
    assert np.array_equal(np.concatenate(parts), whole)
    assert not np.array_equal(Renderer(scene, seed=8).rows(3, 0, 24, times, angle), whole)


def test_over_exposed_core_is_white_and_its_rim_green() -> None:
    row = draw(Renderer(rig(peak=200.0 * 16, ambient=10.0)))[12]
    assert row[80].tolist() == [255, 255, 255]
    rim = row[80 + 4].astype(int) - 10
    assert rim[1] > 3 * rim[0] > 0
    assert row[120].tolist() == [10, 10, 10]


def test_channels_and_laser_off() -> None:
    renderer = Renderer(rig(ambient=20.0))
    on, off = draw(renderer), draw(renderer, laser_on=False)
    assert np.all(off == 20)
    peak = on[12, 80].astype(int) - 20
    assert peak[1] > 150
    assert peak / peak[1] == pytest.approx([0.25, 1, 0.125], abs=0.01)


def test_room_light_depends_on_the_side() -> None:
    """A wall that faces the light has all of it, one that turns away by 60 degrees half of it."""
    c, s = cos(np.pi / 3), sin(np.pi / 3)
    turned = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 2000], [0, 0, 0, 1]])
    assert np.all(draw(Renderer(rig(ambient=100.0)), laser_on=False) == 100)
    assert np.all(draw(Renderer(rig([Plane(pose=turned)], ambient=100.0)), laser_on=False) == 50)
