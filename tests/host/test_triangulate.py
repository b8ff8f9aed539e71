"""Laser planes and triangulation, by hand and by going there and back."""

import numpy as np
import pytest

from magtrak.calibration import Calibration
from magtrak.camera import BrownConrady
from magtrak.laser import Laser
from magtrak.rows import quality
from magtrak.triangulate import MIN_SINE, triangulate
from tests.support.calibrations import example_calibration

POSE = np.array(example_calibration()["laser"]["camera_from_laser"], float)


def test_angle_of_counts() -> None:
    laser = Laser(POSE, zero_rad=0.25, sense=-1, counts_per_turn=1000)
    alpha = laser.alpha(np.array([0.0, 250.0, 1250.0, -250.0, 0.5]))
    quarter = np.pi / 2
    assert np.allclose(alpha, [0.25, 0.25 - quarter, 0.25 - quarter, 0.25 + quarter, 0.25 - np.pi / 1000])


def test_angles_are_wrapped() -> None:
    alpha = Laser(POSE, counts_per_turn=8).alpha(np.arange(-20, 20, 0.3))
    assert np.abs(alpha).max() <= np.pi
    assert np.allclose(np.exp(1j * alpha), np.exp(2j * np.pi * np.arange(-20, 20, 0.3) / 8))


def test_error_table_is_linear_between_its_lines_and_closed_over_the_turn() -> None:
    laser = Laser(POSE, counts_per_turn=8, error_table=np.array([0.0, 0.4, 0.0, -0.2]))
    counts = np.array([0.0, 1.0, 2.0, 5.0, 7.0, 8.0, 9.0, -1.0])
    added = np.array([0.0, 0.2, 0.4, -0.1, -0.1, 0.0, 0.2, -0.1])
    assert np.allclose(laser.alpha(counts), Laser(POSE, counts_per_turn=8).alpha(counts + added))


def test_plane_of_the_paper_holds_axis_and_light() -> None:
    laser = Laser(POSE)
    alpha = np.radians([-20.0, 0.0, 35.0])
    normals, offsets = laser.planes(alpha)
    for a, n, d in zip(alpha, normals, offsets, strict=True):
        axis_points = np.array([[-500.0, -100, 0], [-500, 200, 0]])
        light = np.array([-500 + 1000 * np.sin(a), 0, 1000 * np.cos(a)])  # positive angles turn to the right
        assert np.allclose([*axis_points @ n, light @ n], d)
        assert np.isclose(np.linalg.norm(n), 1)


def test_tilt_and_offset_by_hand() -> None:
    laser = Laser(np.eye(4), offset_mm=3.0, tilt_rad=np.pi / 6)
    normals, offsets = laser.planes(np.array([0.0, np.pi / 2]))
    assert np.allclose(normals, [[0, np.sqrt(0.75), 0.5], [-np.sqrt(0.75), 0, 0.5]])
    assert np.allclose(offsets, 3.0)


def test_point_by_hand() -> None:
    # The plane turned 45 deg to the right from (-500, y, 0) meets the optical axis 500 mm ahead.
    normals, offsets = Laser(POSE).planes(np.array([np.pi / 4]))
    found = triangulate(np.zeros(3), np.array([[0.0, 0, 1]]), normals, offsets)
    assert np.allclose(found.points, [[0, 0, 500]])
    assert found.valid.all()


def test_parallel_and_backward_rays_are_rejected_and_counted() -> None:
    normals, offsets = Laser(POSE).planes(np.radians([0.0, 0.56, 0.59, -45.0]))
    found = triangulate(np.zeros(3), np.tile([0.0, 0, 1], (4, 1)), normals, offsets)
    # sin 0.573 deg is the limit of 0.01; at -45 deg they meet 500 mm behind.
    assert pytest.approx(0.01) == MIN_SINE
    assert found.valid.tolist() == [False, False, True, False]
    assert np.isnan(found.points[~found.valid]).all()
    assert (found.parallel, found.behind) == (2, 1)
    nothing = triangulate(np.zeros(3), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    assert nothing.points.shape == (0, 3)


def test_there_and_back_with_every_parameter_in_use() -> None:
    values = example_calibration(640, 480)
    values["camera"]["distortion"] = [-0.2, 0.05, 0.001, -0.001, 0.0]
    calibration = Calibration.parse(values)
    turn = np.radians(3)
    pose = POSE.copy()
    pose[:3, :3] = pose[:3, :3] @ [[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]]
    laser = Laser(pose, offset_mm=1.7, tilt_rad=0.02, zero_rad=0.1)
    rng = np.random.default_rng(8)
    alpha = rng.uniform(np.radians(5), np.radians(25), 300)
    normals, offsets = laser.planes(alpha)
    camera = calibration.camera.build()
    assert isinstance(camera, BrownConrady)
    pixels = rng.uniform([40, 0], [639, 479], (300, 2))
    found = triangulate(camera.centre, camera.ray(pixels[:, 0], pixels[:, 1]), normals, offsets)
    good = found.valid
    assert good.sum() > 250
    # The points lie on their planes, seen from L as the contract writes them ...
    in_laser = (found.points - pose[:3, 3]) @ pose[:3, :3]
    about = np.stack([-np.sin(alpha) * np.cos(0.02), np.cos(alpha) * np.cos(0.02), np.full(300, np.sin(0.02))], -1)
    assert np.abs(np.einsum("ij,ij->i", in_laser, about)[good] - 1.7).max() < 1e-8
    # ... and are seen where they were seen.
    assert np.abs(camera.project(found.points[good]) - pixels[good]).max() < 2e-4


def test_quality_by_hand() -> None:
    no = np.zeros(9, bool)

    def only(n: int) -> np.ndarray:
        return np.arange(9) == n

    peak = np.array([255.0, 64, 32, 255, 255, 255, 255, 255, 255])
    width = np.array([6.0, 3, 6, 1, 64, 6, 6, 6, 6])
    grade = quality(peak, width, only(5), only(6), only(7), only(8))
    assert np.allclose(grade, [1, 1, 0.5, 1 / 3, 0.5, 0.2, 0.8, 0.5, 0])
    assert quality(peak, width, no, no, no, no).min() > 0
