"""The paper's own tests, on pictures by the simulator's camera and on clouds with errors put in by hand."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from magtrak.calibration import Calibration
from magtrak.cloud.points import POINT
from magtrak.errors import CalibrationError, MagtrakError
from magtrak.locate import locator
from magtrak.validate import boards, paper
from sim.photo import photo, target
from sim.scene import Scene

LIGHT = (220.0, 220.0, 220.0)
STEP = np.radians(0.5)


def loaded(scene: Scene, tmp_path) -> boards.Target:
    import json

    (tmp_path / "target.json").write_text(json.dumps(target(scene)))
    return boards.Target.load(tmp_path / "target.json")


def grey(scene: Scene) -> np.ndarray:
    return cv2.cvtColor(photo(scene, 1, LIGHT), cv2.COLOR_RGB2GRAY)


@pytest.fixture(scope="module")
def metric() -> tuple[Scene, np.ndarray]:
    scene = Scene.load("metric")
    return scene, grey(scene)


def swept(scene: Scene, calibration: Calibration, error_rad: float) -> np.ndarray:
    """A cloud of the line on the blank band, with pixels from the simulator's optics and angles that are off."""
    item = next(item for item in scene.objects if item.board is not None)
    pose = item.board.pose(item.surface)
    x0, y0, x1, y1 = item.board.band_mm
    parts = []
    for frame, alpha in enumerate(np.arange(0.0, np.radians(16), STEP)):
        y = np.linspace(y0 + 5, y1 - 5, 20)
        x = np.linspace(x0, x1, 400)
        grid = np.stack([*np.meshgrid(x, y), np.zeros((20, 400))], axis=-1).reshape(-1, 3)
        angles = scene.lit_from(grid @ pose[:3, :3].T + pose[:3, 3])[0].reshape(20, 400)
        at = np.array([np.interp(alpha, row, x) for row in angles])
        pixels = scene.project(np.stack([at, y, np.zeros(20)], axis=-1) @ pose[:3, :3].T + pose[:3, 3])
        pixels = pixels[(at > x0 + 1) & (at < x1 - 1)]
        if len(pixels) < 20:
            continue
        rows = np.arange(np.ceil(pixels[0, 1]), np.floor(pixels[-1, 1]))
        cloud = np.zeros(len(rows), POINT)
        cloud["scalar_frame"], cloud["scalar_angle"] = frame, alpha + error_rad
        cloud["scalar_column"], cloud["scalar_row"] = np.interp(rows, pixels[:, 1], pixels[:, 0]), rows
        parts.append(cloud)
    cloud = np.concatenate(parts)
    seen = locator(calibration).locate(
        cloud["scalar_column"].astype(float), cloud["scalar_row"].astype(float), cloud["scalar_angle"].astype(float)
    )
    cloud["x"], cloud["y"], cloud["z"] = seen.points.T
    return cloud


@pytest.mark.parametrize("error_deg", [0.0, 0.05])
def test_laser(metric, tmp_path, error_deg: float) -> None:
    scene, picture = metric
    calibration = Calibration.parse(scene.calibration())
    cloud = swept(scene, calibration, np.radians(error_deg))
    found = paper.laser_test(calibration, cloud, picture, loaded(scene, tmp_path))
    lines = {line.what: line for line in found.lines}
    mean = next(line for name, line in lines.items() if name.startswith("error of the angle over"))
    print(f"error put in {error_deg}, found {mean.value:.4f} deg")
    assert mean.value == pytest.approx(-error_deg, abs=0.01)
    assert lines["  RMS about it"].value < 0.02
    assert lines["angle by the encoder"].value == pytest.approx(5.0, abs=0.26)
    distance = lines["d_theta, from the axis to the plane"].value
    assert distance == pytest.approx(2114, abs=2), "(60 + 496, 30 - 8, 2060 + 22) along X_L"
    # The line moves on the plane by what the angle makes of the distance.
    first = lines["d_a, the line's way on it"].value / distance
    assert first == pytest.approx(np.tan(np.radians(lines["angle by the encoder"].value)), rel=0.02)


def test_slit(metric, tmp_path) -> None:
    scene, picture = metric
    calibration = Calibration.parse(scene.calibration())
    known = loaded(scene, tmp_path)
    good, bad = (swept(scene, calibration, np.radians(error)) for error in (0.0, 0.1))
    lines = {line.what: line for line in paper.slit_test(calibration, good, picture, known, np.radians(10), bad).lines}
    assert lines["angle of the laser"].value == pytest.approx(10, abs=0.3)
    off = lines["off the plane, mean"]
    item = next(item for item in scene.objects if item.board is not None)
    mine = bad["scalar_frame"] == round(np.radians(10 - 0.1) / STEP)
    points = np.stack([bad[name][mine] for name in "xyz"], -1)
    true = item.surface.distance(points).mean()
    print(f"off the plane {off.value:.2f} mm, with 0.1 deg {off.other:.2f} mm, truly {true:.2f} mm")
    assert off.value < 1.5
    assert off.other == pytest.approx(true, abs=1.5)
    assert true > 8


def test_camera(tmp_path) -> None:
    scene = Scene.load("corner")
    calibration, picture = Calibration.parse(scene.calibration()), grey(scene)
    known = loaded(scene, tmp_path)
    lines = paper.camera_test(calibration, picture, known).lines
    errors = [line for line in lines if "corners, RMS" in line.what]
    assert len(errors) == 2
    for line in errors:
        print(f"{line.what}: {line.value:.3f} mm, by a 3 x 4 matrix {line.other:.3f} mm")
        assert line.value < 0.4
        assert line.other is not None
        assert line.other < 3
    # A board that was printed 2 % too large is off by what the other board does not allow.
    wrong = boards.Target(
        [(known.boards[0][0], known.boards[0][1]), (replace(known.boards[1][0], square_mm=40.8), known.boards[1][1])]
    )
    assert max(line.value for line in paper.camera_test(calibration, picture, wrong).lines) > 1.5


def test_mistakes(metric, tmp_path) -> None:
    scene, picture = metric
    calibration = Calibration.parse(scene.calibration())
    known = loaded(scene, tmp_path)
    other = boards.Target([(replace(known.boards[0][0], dictionary="DICT_4X4_250"), np.eye(4))])
    with pytest.raises(CalibrationError, match="0 corners of board board are seen in the picture, 8 are needed"):
        paper.laser_test(calibration, swept(scene, calibration, 0.0), picture, other)
    with pytest.raises(MagtrakError, match=r"0 pictures have the line on the board's blank band, 3 are needed"):
        paper.laser_test(calibration, np.zeros(10, POINT), picture, known)
    with pytest.raises(MagtrakError, match=r"the target .*none\.json cannot be read: No such file"):
        boards.Target.load(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text('{"boards": [{"pattern": "charuco"}]}')
    with pytest.raises(MagtrakError, match=r"bad\.json does not describe boards: KeyError\('columns'\)"):
        boards.Target.load(tmp_path / "bad.json")
