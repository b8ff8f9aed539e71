"""Camera and laser against OpenCV and against their definitions."""

import cv2
import numpy as np
import pytest

from sim.optics import Camera, Laser
from tests.sim.rig import LASER, at


@pytest.mark.parametrize(
    "distortion",
    [
        (0.0, 0.0, 0.0, 0.0),
        (-0.11, 0.06, 0.0004, -0.0003),
        (-0.3, 0.1, 0.001, -0.002, -0.01),
        (0.1, -0.05, 0.001, 0.002, 0.01, 0.2, -0.04, 0.01),
    ],
)
def test_camera_is_opencvs(distortion: tuple[float, ...]) -> None:
    matrix = ((800.0, 0.0, 322.4), (0.0, 810.0, 237.1), (0.0, 0.0, 1.0))
    camera = Camera(640, 480, matrix, distortion, 0, 1, 0)
    v, u = np.mgrid[0:480:20, 0:640:20].reshape(2, -1).astype(float)
    rays = camera.rays(u, v)
    assert np.all(rays[:, 2] == 1)
    back = cv2.projectPoints(rays * 1234.5, np.zeros(3), np.zeros(3), np.array(matrix), np.array(distortion))[0]
    assert np.abs(back.reshape(-1, 2) - np.stack([u, v], 1)).max() < 1e-7
    assert np.abs(camera.project(rays * 77) - np.stack([u, v], 1)).max() < 1e-7


def leaning(**changes: object) -> Laser:
    return Laser(**{**{name: getattr(LASER, name) for name in Laser.__annotations__}, **changes})


def test_plane_meets_points() -> None:
    """The angle that is found puts the point on the plane of the definition, and its speed is the derivative."""
    laser = leaning(offset_mm=7.0, tilt_rad=0.2)
    seed = 3
    print("seed", seed)
    points = np.random.default_rng(seed).uniform((500, -800, -600), (2000, 800, 600), (200, 3))
    alpha, speed = laser.meets(points)

    def distance(alpha: np.ndarray) -> np.ndarray:
        n = np.stack([-np.sin(alpha) * np.cos(0.2), np.cos(alpha) * np.cos(0.2), np.full(len(alpha), np.sin(0.2))], 1)
        return np.sum(n * points, axis=1) - 7.0

    assert np.abs(distance(alpha)).max() < 1e-9
    slope = (distance(alpha + 1e-6) - distance(alpha - 1e-6)) / 2e-6
    assert -slope == pytest.approx(speed, rel=1e-6)


def test_points_that_the_plane_never_meets() -> None:
    """A plane that leans by 45 degrees sweeps a cone; inside it is no light."""
    laser = leaning(tilt_rad=np.pi / 4)
    _, speed = laser.meets(np.array([[100.0, 0, 99], [100.0, 0, 101]]))
    assert speed[0] > 0
    assert speed[1] == 0


def test_angles_go_on_behind_the_laser() -> None:
    """No jump at half a turn for a scene that lies there."""
    phi = np.linspace(np.pi - 0.3, np.pi + 0.3, 50)
    alpha, _ = LASER.meets(1000 * np.stack([np.cos(phi), np.sin(phi), np.zeros(50)], 1))
    assert np.diff(alpha) == pytest.approx(np.diff(phi))


def test_laser_frame_and_sense() -> None:
    laser = leaning(sense=-1, zero_rad=0.3)
    assert laser.alpha([0.0, 0.1]).tolist() == pytest.approx([0.3, 0.2])
    # 500 mm to the right of the emitter is the camera's centre; Z_C is along X_L, down is Z_L.
    assert laser.points(np.array([[0.0, 0, 0], [-500, 0, 7], [-500, 8, 0]])).tolist() == [
        [0, 500, 0],
        [7, 0, 0],
        [0, 0, 8],
    ]
    assert np.array_equal(laser.origin, at(-500, 0, 0)[:3, 3])


def test_light_thins_with_range() -> None:
    laser = leaning(waist_mm=3.0, divergence_rad=0.002)
    assert laser.sigma_mm([0.0, 2000.0]) == pytest.approx([3.0, 5.0])
    assert float(laser.level(2000.0)) == pytest.approx(200)
    # Twice the range: half the light, spread from 5 over hypot(3, 8) mm.
    assert float(laser.level(4000.0)) == pytest.approx(100 * 5 / np.hypot(3, 8))
