"""Flat ports: by hand, there and back, in the limit of air, and against the simulator's own optics (Fermat)."""

import copy
from dataclasses import replace
from math import asin, cos, radians, sin, tan

import numpy as np
import pytest

from magtrak.calibration import Calibration
from magtrak.errors import CalibrationError
from magtrak.locate import InWater, locator
from magtrak.ports import Port, Sheet
from sim.scene import Scene
from sim.water import Pane, Water
from tests.support.calibrations import example_calibration

PORTS = {
    "camera": {"distance_mm": 40.0, "normal": [0.0, 0.0, 1.0], "thickness_mm": 6.0, "glass_index": 1.5},
    "laser": {"distance_mm": 60.0, "normal": [1.0, 0.0, 0.0], "apex_beam_mm": 12.0, "apex_axis_mm": -5.0},
    "water_index": 1.34,
}


def unit(*values: float) -> np.ndarray:
    vector = np.array(values, float)
    return vector / np.linalg.norm(vector)


def test_snell_by_hand() -> None:
    port = Port(10.0, np.array([0.0, 0, 1]), 5.0, 1.5)
    angle = radians(30)
    start, onward = port.leave(np.zeros(3), np.array([[sin(angle), 0, cos(angle)], [0, 0, 1.0]]), 1.33)
    in_glass = asin(0.5 / 1.5)
    assert start[0] == pytest.approx([10 * tan(angle) + 5 * tan(in_glass), 0, 15])
    assert onward[0] == pytest.approx([0.5 / 1.33, 0, cos(asin(0.5 / 1.33))])
    assert start[1] == pytest.approx([0, 0, 15])
    assert onward[1] == pytest.approx([0, 0, 1])


def test_rays_that_turn_away_from_the_port_lead_nowhere() -> None:
    port = Port(10.0, np.array([0.0, 0, 1]), 5.0)
    start, onward = port.leave(np.zeros(3), np.array([[0.0, 0, -1], [1, 0, 0]]), 1.33)
    assert np.isnan(start).all()
    assert np.isnan(onward).all()
    points = np.array([[0, 0, 9.0], [0, 0, 14.0], [0, 0, 16.0]])
    assert np.isnan(port.reach(np.zeros(3), points, 1.33)).any(axis=1).tolist() == [True, True, False]


def test_reach_is_the_inverse_of_leave_up_to_grazing_rays() -> None:
    rng = np.random.default_rng(3)
    port = Port(25.0, unit(0.1, -0.2, 1), 9.0, 1.52)
    angle, about = rng.uniform(0, radians(88), 4000), rng.uniform(0, 2 * np.pi, 4000)
    basis = np.linalg.svd(port.normal[None])[2]
    directions = np.cos(angle)[:, None] * port.normal
    directions = directions + np.sin(angle)[:, None] * (
        np.cos(about)[:, None] * basis[1] + np.sin(about)[:, None] * basis[2]
    )
    starts = rng.uniform(-8, 8, (4000, 3))
    exits, onward = port.leave(starts, directions, 1.337)
    points = exits + rng.uniform(0.1, 5000, 4000)[:, None] * onward
    assert np.abs(port.reach(starts, points, 1.337) - directions).max() < 1e-9


def test_ports_of_air_change_nothing() -> None:
    values = example_calibration(640, 480)
    values["laser"] |= {"tilt_rad": 0.01, "offset_mm": 2.0}
    ports = copy.deepcopy(PORTS) | {"water_index": 1.0}
    ports["camera"]["glass_index"] = ports["laser"]["glass_index"] = 1.0
    rng = np.random.default_rng(4)
    u, v, alpha = rng.uniform(0, 639, 500), rng.uniform(0, 479, 500), rng.uniform(0.1, 0.5, 500)
    air = locator(Calibration.parse(values)).locate(u, v, alpha)
    water = locator(Calibration.parse(values | {"ports": ports})).locate(u, v, alpha)
    both = air.valid & water.valid
    assert both.sum() > 350
    # A ray that meets its plane metres away is told more loosely. In air the angles are those of float32.
    scale = np.linalg.norm(air.points[both], axis=1) / 1000
    assert np.max(np.linalg.norm(air.points - water.points, axis=1)[both] / scale**2) < 5e-4


def test_host_and_simulator_agree_on_random_rigs() -> None:
    """The simulator finds the way of light by Fermat's principle and angles, the host by Snell's law for vectors."""
    rng = np.random.default_rng(12)
    rig = Scene.load("rig")
    for number in range(4):
        panes = [
            Pane(rng.uniform(20, 90), tuple(unit(*axis + rng.normal(0, 0.06, 3))), rng.uniform(0, 15), 1.49)
            for axis in (np.array([0.0, 0, 1]), np.array([1.0, 0, 0]))
        ]
        still = (0.0, 0.0, 0.0)
        water = Water(rng.uniform(1.3, 1.36), *panes, rng.uniform(-10, 18), rng.uniform(-15, 15), still, still, 0, 0)
        laser = replace(rig.laser, tilt_rad=rng.uniform(-0.02, 0.02), offset_mm=rng.uniform(-3, 3))
        scene = replace(rig, water=water, laser=laser)
        found = locator(Calibration.parse(scene.calibration()))
        assert isinstance(found, InWater)
        u, v = rng.uniform(0, 639, 400), rng.uniform(0, 479, 400)
        starts, directions = scene.sight(scene.camera.rays(u, v))
        points = starts + directions * (rng.uniform(500, 3000, 400) / directions[:, 2])[:, None]
        alpha, speed, _ = scene.lit_from(points)
        assert np.all(speed > 0)
        pixels = found.camera.project(points)
        assert np.abs(pixels - np.stack([u, v], -1)).max() < 1e-6
        at = found.locate(u, v, alpha)
        error = np.linalg.norm(at.points - points, axis=1)
        print(f"rig {number}: {at.valid.sum()} points, greatest difference {np.nanmax(error):.1e} mm")
        assert at.valid.mean() > 0.95
        # The host takes the distortion out to 1e-4 px, which is a micrometre or two here.
        assert np.nanmax(error) < 0.01


def test_speed_of_the_simulated_sheet_is_how_it_moves() -> None:
    scene = Scene.load("water")
    rng = np.random.default_rng(5)
    points = rng.uniform([-300, -300, 1500], [300, 300, 2200], (50, 3))
    _, speed, _ = scene.lit_from(points)
    normal = np.zeros_like(points)
    for axis in range(3):
        nudge = np.zeros(3)
        nudge[axis] = 0.5
        normal[:, axis] = scene.lit_from(points + nudge)[0] - scene.lit_from(points - nudge)[0]
    assert speed == pytest.approx(1 / np.linalg.norm(normal, axis=1), rel=0.01)


def test_a_flat_wall_seen_without_its_refraction_is_bent_and_misplaced() -> None:
    scene = Scene.load("water")
    with_ports = Calibration.parse(scene.calibration())
    in_air = replace(with_ports, ports=None)
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(20, 620, 25), np.linspace(20, 460, 19)))
    starts, directions = scene.sight(scene.camera.rays(u, v))
    points = starts + directions * ((2000 - starts[:, 2]) / directions[:, 2])[:, None]
    alpha = scene.lit_from(points)[0]
    for calibration, low, high in ((with_ports, 0.0, 0.01), (in_air, 10.0, 50.0)):
        seen = locator(calibration).locate(u, v, alpha)
        cloud = seen.points[seen.valid]
        form = np.linalg.svd(cloud - cloud.mean(axis=0))[1][2] / np.sqrt(len(cloud))
        print(f"form error {form:.4f} mm")
        assert low <= form < high


def test_file_is_read_and_written(tmp_path) -> None:
    values = example_calibration() | {"ports": copy.deepcopy(PORTS)}
    calibration = Calibration.parse(values)
    assert calibration.ports is not None
    assert calibration.ports.laser.glass_index == 1.49
    assert Sheet(calibration.laser, calibration.ports).ports.apex_axis_mm == -5
    calibration.save(tmp_path / "a.json")
    again = Calibration.load(tmp_path / "a.json")
    assert again.ports is not None
    assert again.ports.as_dict() == calibration.ports.as_dict()
    assert Calibration.parse(example_calibration()).ports is None


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("camera.normal", [0, 0, 2], r"ports.camera.normal is \[0, 0, 2\]; it must be a vector of length 1"),
        ("camera.distance_mm", None, "ports.camera.distance_mm is None; it must be a number from 0"),
        ("laser.glass_index", 0.5, "ports.laser.glass_index is 0.5; it must be a number from 1"),
        ("water_index", "sea", "ports.water_index is 'sea'"),
        ("laser", 3, "ports.laser must be a table of named values, not 3"),
    ],
)
def test_wrong_fields_are_named(path: str, value: object, message: str) -> None:
    values = example_calibration() | {"ports": copy.deepcopy(PORTS)}
    *tables, name = path.split(".")
    table = values["ports"]
    for step in tables:
        table = table[step]
    table[name] = value
    with pytest.raises(CalibrationError, match=message):
        Calibration.parse(values, "rig.json")
