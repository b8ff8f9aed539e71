"""Ports from boards under water, seen by the simulator's optics; judged on walls that the fit has never seen."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from magtrak.calibrate import underwater
from magtrak.calibrate.observations import Lines
from magtrak.calibrate.ports import NAMES, PortsFound, calibrate_ports
from magtrak.calibration import Calibration
from magtrak.cli.magtrak import main
from magtrak.errors import CalibrationError
from magtrak.locate import locator
from sim.scene import Scene
from tests.support.water import nominal, observe, write_session

SEED = 4


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.load("water")


@pytest.fixture(scope="module")
def in_air(scene: Scene) -> Calibration:
    whole = Calibration.parse(scene.calibration())
    return replace(whole, ports=None, camera=replace(whole.camera, time_offset_s=0.0))


@pytest.fixture(scope="module")
def found(scene: Scene, in_air: Calibration) -> PortsFound:
    print(f"seed {SEED}")
    return calibrate_ports(in_air, nominal(scene, SEED), observe(scene, 10, SEED, 2))


def form_mm(scene: Scene, calibration: Calibration, z: float) -> float:
    """RMS distance of a wall's points from the plane through them."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(20, 620, 13), np.linspace(20, 460, 10)))
    starts, directions = scene.sight(scene.camera.rays(u, v))
    points = starts + directions * ((z - starts[:, 2]) / directions[:, 2])[:, None]
    seen = locator(calibration).locate(u, v, scene.lit_from(points)[0])
    cloud = seen.points[seen.valid]
    assert len(cloud) > 120
    return float(np.linalg.svd(cloud - cloud.mean(axis=0))[1][2] / np.sqrt(len(cloud)))


def test_walls_are_flat(scene: Scene, in_air: Calibration, found: PortsFound) -> None:
    for z in (1000.0, 2000.0, 3000.0):
        ruler, water = (
            form_mm(scene, replace(in_air, ports=nominal(scene, SEED)), z),
            form_mm(scene, found.calibration, z),
        )
        air = form_mm(scene, in_air, z)
        print(f"{z / 1000:.0f} m: {air:.1f} mm without ports, {ruler:.2f} mm by rule, {water:.3f} mm found")
        assert water < 0.3
        assert ruler > 2 * water
        assert air > 10


def test_residuals_are_the_noise_and_sigmas_cover_the_truth(scene: Scene, found: PortsFound) -> None:
    assert found.corner_rms_px == pytest.approx(0.05, rel=0.15)
    assert found.line_rms_px == pytest.approx(0.025, rel=0.25)
    true = Calibration.parse(scene.calibration()).ports
    assert true is not None
    truths = {
        "camera.distance_mm": true.camera.distance_mm,
        "laser.distance_mm": true.laser.distance_mm,
        "laser.apex_beam_mm": true.apex_beam_mm,
        "laser.apex_axis_mm": true.apex_axis_mm,
        "water_index": true.water_index,
    }
    for name, value in truths.items():
        print(f"{name}: {found.values[name]:.4f} +- {found.sigmas[name]:.4f}, true {value:.4f}")
        assert abs(found.values[name] - value) < 4 * found.sigmas[name]
    assert set(found.sigmas) == set(NAMES)
    assert found.calibration.ports is not None
    for mine, its in ((found.calibration.ports.camera, true.camera), (found.calibration.ports.laser, true.laser)):
        assert np.degrees(np.arccos(mine.normal @ its.normal)) < 0.5


def test_too_few_views_and_no_lines_are_refused(scene: Scene, in_air: Calibration) -> None:
    few = observe(scene, 3, 1, 1)
    with pytest.raises(
        CalibrationError, match="3 views of a board under water, 3 of them with laser lines, are too few"
    ):
        calibrate_ports(in_air, nominal(scene, 1), few)


def test_another_rig_is_refused(scene: Scene, in_air: Calibration) -> None:
    seen = observe(scene, 6, 2, 2)
    matrix = in_air.camera.matrix * np.array([[1.15], [1.15], [1]])
    other = replace(in_air, camera=replace(in_air.camera, matrix=matrix))
    with pytest.raises(CalibrationError, match="no ports explain what was seen under water"):
        calibrate_ports(other, nominal(scene, 2), seen)


def test_the_command(scene: Scene, in_air: Calibration, tmp_path) -> None:
    """A session on disk; rows beside the band, which lie on print and are wrong, are left out."""
    seen = observe(scene, 10, SEED, 2)
    views = []
    for view in seen.views:
        lines = view.lines
        astray = lines[:6]
        upward = 0.5 * (view.corners[:, 1].min() + view.corners[:, 1].max())  # among the squares
        astray = Lines(astray.image, np.full(6, upward), astray.column + 3.0, astray.counts, astray.rate)
        parts = (np.concatenate([getattr(lines, name), getattr(astray, name)]) for name in Lines.__annotations__)
        views.append(replace(view, lines=Lines(*parts)))
    session = write_session(tmp_path / "session", replace(seen, views=views))
    air, rule, output = tmp_path / "air.json", tmp_path / "rule.json", tmp_path / "water.json"
    in_air.save(air)
    rule.write_text(json.dumps({"ports": nominal(scene, SEED).as_dict()}))
    command = ["calibrate", "ports", str(session), "--calibration", str(air), "--output", str(output)]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 1
    assert "air.json has no ports: measure panes and laser with a rule" in done.output
    done = CliRunner().invoke(main, [*command, "--measured", str(rule)])
    assert done.exit_code == 0, done.output
    print(done.output)
    assert "water index" in done.output
    known = Calibration.load(output)
    assert set(known.extra["sigmas"]["ports"]) == set(NAMES)
    for z in (1000.0, 2000.0, 3000.0):
        print(f"{z / 1000:.0f} m: {form_mm(scene, known, z):.3f} mm")
        assert form_mm(scene, known, z) < 0.3
    shown = CliRunner().invoke(main, ["calibrate", "show", str(output)])
    assert f"{known.ports.camera.distance_mm:.2f} +- " in shown.output


def test_a_session_of_another_rig_is_refused(scene: Scene, in_air: Calibration, tmp_path) -> None:
    taken = underwater.Session(observe(scene, 6, 2, 1), [])
    for known, message in (
        (
            replace(in_air, camera=replace(in_air.camera, width=800)),
            "is for pictures of 800 x 480, these are 640 x 480",
        ),
        (replace(in_air, laser=replace(in_air.laser, counts_per_turn=4096)), "has 4096 counts per turn, the session"),
    ):
        with pytest.raises(CalibrationError, match=message):
            underwater.calibrate_under_water(taken, known, nominal(scene, 1))
    (tmp_path / "rule.json").write_text('{"ports": {"camera": {"distance_mm": 42, "normal": [0, 0, 2]}}}')
    with pytest.raises(CalibrationError, match=r"ports\.laser is missing"):
        underwater.read_nominal(tmp_path / "rule.json")
