"""Camera models against OpenCV and against themselves."""

import cv2
import numpy as np
import pytest

from magtrak.camera import BrownConrady, Projection
from magtrak.errors import CalibrationError

WIDTH, HEIGHT = 640, 480
MATRIX = np.array([[805.0, 0, 322.5], [0, 798.0, 236.5], [0, 0, 1]])
DISTORTIONS = {
    "none": [0, 0, 0, 0, 0],
    "four": [-0.21, 0.08, 0.001, -0.002],
    "five": [-0.32, 0.14, 0.0015, -0.0007, -0.03],
    "eight": [0.4, -0.2, 0.001, 0.0005, 0.05, 0.7, -0.25, 0.02],
    "pincushion": [0.25, 0.1, 0, 0],
}


def grid() -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.linspace(0, WIDTH - 1, 33), np.linspace(0, HEIGHT - 1, 25))
    return u.ravel(), v.ravel()


@pytest.mark.parametrize("name", DISTORTIONS)
def test_projects_as_opencv_does(name: str) -> None:
    distortion = np.array(DISTORTIONS[name])
    camera = BrownConrady(MATRIX, distortion, WIDTH, HEIGHT)
    rng = np.random.default_rng(5)
    points = rng.uniform([-400, -300, 900], [400, 300, 2500], (500, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, distortion)
    assert np.abs(camera.project(points) - expected[:, 0]).max() < 1e-9


@pytest.mark.parametrize("name", DISTORTIONS)
def test_rays_are_those_of_opencv_up_to_the_corners(name: str) -> None:
    distortion = np.array(DISTORTIONS[name])
    camera = BrownConrady(MATRIX, distortion, WIDTH, HEIGHT)
    u, v = grid()
    rays = camera.ray(u, v)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    expected = cv2.undistortPoints(np.stack([u, v], -1)[:, None], MATRIX, distortion, criteria=criteria)[:, 0]
    # A ten-thousandth of a pixel, in normalised coordinates.
    assert np.abs(rays[:, :2] / rays[:, 2:] - expected).max() < 2e-4 / 800
    assert np.abs(np.linalg.norm(rays, axis=1) - 1).max() < 1e-12
    assert np.abs(camera.project(rays * 1500) - np.stack([u, v], -1)).max() < 1.1e-4


def test_distortion_that_folds_the_picture_is_refused_with_the_pixel() -> None:
    with pytest.raises(CalibrationError, match=r"cannot be taken out at pixel \(\d+, \d+\) of 640 x 480"):
        BrownConrady(MATRIX, np.array([-2.5, 0.0, 0.0, 0.0]), WIDTH, HEIGHT)


def test_points_behind_the_camera_have_no_pixel() -> None:
    camera = BrownConrady(MATRIX, np.zeros(5), WIDTH, HEIGHT)
    assert np.isnan(camera.project(np.array([[0.0, 0, -1], [0, 0, 0]]))).all()


@pytest.mark.parametrize("scale", [1.0, -0.37])
def test_projection_is_the_pinhole_that_it_was_made_of(scale: float) -> None:
    rotation, _ = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))
    shift = np.array([12.0, -7.0, 30.0])
    projection = Projection(scale * MATRIX @ np.column_stack([rotation, shift]))
    assert np.allclose(projection.centre, -rotation.T @ shift)
    points = np.random.default_rng(2).uniform([-400, -300, 900], [400, 300, 2500], (100, 3))
    expected, _ = cv2.projectPoints(points, cv2.Rodrigues(rotation)[0], shift, MATRIX, np.zeros(4))
    pixels = projection.project(points)
    assert np.abs(pixels - expected[:, 0]).max() < 1e-8
    rays = projection.ray(pixels[:, 0], pixels[:, 1])
    to_points = points - projection.centre
    assert np.abs(rays - to_points / np.linalg.norm(to_points, axis=1, keepdims=True)).max() < 1e-9
    assert np.isnan(projection.project(np.array([[0.0, 0, -500]]))).all()
