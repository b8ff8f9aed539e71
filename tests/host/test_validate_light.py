"""Where the light came from, from clouds with the simulator's angles; and what grazing light does to a cylinder."""

from dataclasses import replace

import numpy as np
import pytest

from magtrak.validate.light import light_source
from magtrak.validate.segments import find_cylinder
from sim.optics import Laser
from sim.parts import pose_of
from sim.scene import Scene
from sim.surfaces import Cylinder
from tests.host.test_validate import WALL, cast

PIPE = Cylinder(70, 900, pose_of((150, 0, 1300), np.array([0.0, 0, 0.1])))


def lit(laser: Laser, cloud: np.ndarray) -> np.ndarray:
    """The cloud with the angles at which the laser's plane goes through its points."""
    points = np.stack([cloud[axis] for axis in "xyz"], axis=-1).astype(np.float64)
    cloud["scalar_angle"] = laser.meets(laser.points(points))[0]
    return cloud


def nearest_to_camera(laser: Laser) -> np.ndarray:
    pose = np.asarray(laser.camera_from_laser)
    axis = pose[:3, 2]
    return pose[:3, 3] - axis * (axis @ pose[:3, 3])


@pytest.fixture(scope="module")
def laser() -> Laser:
    return Scene.load("rig").laser


@pytest.mark.parametrize(("offset_mm", "tilt_rad"), [(0.0, 0.0), (1.7, 0.007), (-40.0, 0.3)])
def test_the_axis_is_found(laser: Laser, offset_mm: float, tilt_rad: float) -> None:
    laser = replace(laser, offset_mm=offset_mm, tilt_rad=tilt_rad)
    found = light_source(lit(laser, cast([WALL, PIPE], noise=2.0)))
    assert found is not None
    assert found == pytest.approx(nearest_to_camera(laser), abs=0.2)


def test_what_does_not_tell_is_none(laser: Laser) -> None:
    assert light_source(lit(laser, cast([WALL], noise=0.0))) is None  # one wall fits many lasers
    assert light_source(cast([WALL, PIPE])) is None  # one angle for all points
    wet = lit(laser, cast([WALL, PIPE]))
    wet["scalar_angle"] *= 1.3  # no plane that turns about an axis
    assert light_source(wet) is None
    assert light_source(cast([WALL, PIPE])[["x", "y", "z"]]) is None
    assert light_source(lit(laser, cast([WALL, PIPE]))[:10]) is None


def test_grazing_light_is_left_out(laser: Laser) -> None:
    """Points that the light strikes at a slant lie too high, as they do in scans; the radius does not follow them."""
    source = nearest_to_camera(laser)
    cloud = cast([WALL, PIPE], noise=0.15)
    points = np.stack([cloud[axis] for axis in "xyz"], axis=-1).astype(np.float64)
    local = (points - PIPE.pose[:3, 3]) @ PIPE.pose[:3, :3]
    across = np.hypot(local[:, 0], local[:, 2])
    on_it = np.abs(across - 70) < 5
    normal = local * [1, 0, 1] / across[:, None] @ PIPE.pose[:3, :3].T
    way = points - source
    cosine = -np.sum(normal * way, axis=1) / np.linalg.norm(way, axis=1)
    high = np.where(on_it, np.maximum(0.44 - cosine, 0.0) * 2.0, 0.0)
    assert np.count_nonzero(high) > 300
    for at, axis in enumerate("xyz"):
        cloud[axis] += high * normal[:, at]
    untold = find_cylinder(cloud.copy(), 70.0).radius
    told = find_cylinder(lit(laser, cloud), 70.0).radius
    print(f"radius {told:.3f} mm with the light known, {untold:.3f} without")
    assert abs(told - 70) < 0.05
    assert abs(untold - 70) > 2 * abs(told - 70) + 0.05
