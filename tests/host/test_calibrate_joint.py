"""The joint fit: closed form, local coordinates, and calibrations whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magtrak.calibrate.accuracy import accuracy
from magtrak.calibrate.joint import difference, estimate, start_laser
from magtrak.calibrate.rig import LASER, Predictions, Rig, moved_laser, turned
from magtrak.calibrate.sweep import Sweep, standard_form
from magtrak.laser import Laser
from tests.support.calibration_rig import HEIGHT, WIDTH, Procedure, as_calibration, deviations, plane_error, random_rig

SMALL = Procedure(views=12)


def random_laser(rng: np.random.Generator) -> Laser:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    pose[:3, 3] = rng.normal(0, 300, 3)
    return Laser(pose, rng.normal(0, 3), rng.normal(0, 0.1), rng.uniform(-3, 3), int(rng.choice([-1, 1])), 8192)


def same_planes(a: Laser, b: Laser) -> None:
    counts = np.linspace(-4000, 4000, 17)
    n, d = a.planes(a.alpha(counts))
    m, e = b.planes(b.alpha(counts))
    sign = np.sign(np.sum(n * m, axis=1))
    np.testing.assert_allclose(n, m * sign[:, None], atol=1e-9)
    np.testing.assert_allclose(d, e * sign, atol=1e-6)


def test_turns_are_rodrigues():
    rng = np.random.default_rng(1)
    turns = np.concatenate([rng.normal(0, 1, (20, 3)), np.zeros((1, 3)), rng.normal(0, 1e-9, (5, 3))])
    start = Rotation.random(len(turns), rng=rng)
    expected = (start * Rotation.from_rotvec(turns)).as_matrix()
    np.testing.assert_allclose(turned(start.as_matrix(), turns), expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_the_standard_form_is_the_same_laser(seed):
    rng = np.random.default_rng(seed)
    laser = random_laser(rng)
    lit = rng.normal((0, 0, 2000), 300)
    form = standard_form(laser, lit, 100.0)
    same_planes(laser, form)
    x, _, z = form.camera_from_laser[:3, :3].T
    origin = form.camera_from_laser[:3, 3]
    assert z[1] > 0
    assert abs(origin @ z) < 1e-9  # the axis point nearest to the camera
    assert abs(x @ np.cross(z, [0, 0, 1])) < 1e-9 and x[2] > 0
    alpha = form.alpha(np.array([100.0]))[0]
    along = np.cos(alpha) * x + np.sin(alpha) * form.camera_from_laser[:3, 1]
    assert along @ (lit - origin) > 0


@pytest.mark.parametrize("seed", range(4))
def test_difference_is_the_inverse_of_a_step(seed):
    rng = np.random.default_rng(seed)
    laser = random_laser(rng)
    step = rng.normal(0, 1e-5, 7) * [1, 1, 100, 100, 1, 100, 1]
    np.testing.assert_allclose(difference(moved_laser(laser, step), laser), step, rtol=1e-3, atol=1e-7)
    other = standard_form(moved_laser(laser, step), rng.normal((0, 0, 1500), 100), 0.0)
    np.testing.assert_allclose(difference(other, laser), step, rtol=1e-3, atol=1e-7)


def test_the_closed_form_is_exact_without_noise():
    rng = np.random.default_rng(3)
    true = random_rig(rng)
    true = replace(true, time_s=0.0, harmonics=(0.0, 0.0, 0.0, 0.0))
    plan = replace(SMALL, corner_px=0.0, line_px=0.0, angle_counts=0.0)
    seen = plan.observe(true, rng)
    m, k = true.camera.matrix, true.camera.distortion
    camera = np.array([m[0][0], m[1][1], m[0][2], m[1][2], *k])
    poses = [np.stack(part) for part in zip(*plan.poses, strict=True)]
    rig = Rig(camera, *poses, np.ones(2))
    np.testing.assert_allclose(Predictions(seen).corners(rig), 0, atol=1e-6)
    found = start_laser(seen, rig, 8192)[0]
    real = Laser(
        np.asarray(true.laser.camera_from_laser), true.laser.offset_mm, true.laser.tilt_rad, true.laser.zero_rad,
        true.laser.sense, 8192,
    )  # fmt: skip
    same_planes(found, real)


def test_too_few_points_determine_no_sweep():
    with pytest.raises(Exception, match="do not determine how the plane turns"):
        Sweep.fit(np.random.default_rng(1).normal(0, 1, (8, 3)), np.linspace(0, 1, 8))


@pytest.fixture(scope="module")
def studies():
    result = []
    for seed in (11, 12, 13):
        rng = np.random.default_rng(seed)
        true = random_rig(rng)
        seen = SMALL.observe(true, rng).thinned(10)
        result.append((true, estimate(seen)))
    return result


def test_true_values_lie_within_their_sigmas(studies):
    """Three of the 200 of ``python -m tests.bench calibration``, smaller: 60 numbers."""
    ratios = [abs(error) / sigma for true, found in studies for error, sigma in deviations(true, found.joint).values()]
    assert len(ratios) >= 57
    assert np.mean(np.array(ratios) < 2) >= 0.88
    assert max(ratios) < 4.5
    assert np.mean(np.array(ratios) < 0.5) < 0.65  # sigmas that are far too large would pass everything


def test_joint_is_better_than_stepwise(studies):
    joint = [plane_error(true, as_calibration(found.joint), 2000.0).form for true, found in studies]
    stepwise = [plane_error(true, as_calibration(found.stepwise), 2000.0).form for true, found in studies]
    print(f"form at 2 m: joint {np.round(joint, 3)}, stepwise {np.round(stepwise, 3)} mm")
    assert max(joint) < 0.35
    assert np.mean(joint) < 0.7 * np.mean(stepwise)


def test_what_is_expected_is_about_what_comes(studies):
    for true, found in studies:
        expected = accuracy(found.joint, WIDTH, HEIGHT)[2]
        error = plane_error(true, as_calibration(found.joint), 2000.0)
        assert error.form < 1.6 * expected.form_mm
        assert error.place < 1.6 * expected.place_mm


def test_noise_is_estimated(studies):
    for _, found in studies:
        assert found.joint.noise.corner == pytest.approx(0.05, rel=0.15)
        assert found.joint.noise.line == pytest.approx(0.025, rel=0.2)


def test_outliers_do_little_harm():
    rng = np.random.default_rng(11)
    true = random_rig(rng)
    found = estimate(replace(SMALL, outliers=0.1).observe(true, rng).thinned(10)).joint
    assert plane_error(true, as_calibration(found), 2000.0).form < 0.4
    assert set(LASER) <= set(found.names)
