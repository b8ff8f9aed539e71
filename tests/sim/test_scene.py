"""Scene files: what they say, what is wrong with them, and the calibration that belongs to them."""

import json
import tomllib

import numpy as np
import pytest
from click.testing import CliRunner

from sim.errors import SimError
from sim.haze import Haze
from sim.scene import FOLDER, Scene, main
from sim.surfaces import Box, Cylinder, Plane
from sim.timing import Timing

TEXT = (FOLDER / "quick.toml").read_text()


def test_default_is_the_second_example_of_the_paper() -> None:
    scene = Scene.load("default")
    assert [type(surface) for surface in scene.surfaces] == [Plane, Box, Cylinder]
    assert (scene.camera.width, scene.camera.height, scene.camera.noise) == (640, 480, 2)
    assert scene.laser.speckle == 0.1
    assert np.linalg.norm(scene.laser.origin) == 500
    assert scene.scan.frames == 300


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.toml")))
def test_ready_made_scenes_can_be_scanned(name: str) -> None:
    """The motor reaches the end of the scan in time, past the index, and the plane crosses the whole picture."""
    scene = Scene.load(name)
    assert scene.scan_duty == pytest.approx(0.25, abs=0.005), "what the host asks for unless told otherwise"
    motor = scene.motor()
    motor.advance(scene.scan.frames * scene.timing.period_s, scene.scan_duty)
    assert motor.trajectory.angle_rad == pytest.approx(scene.scan.end_rad, abs=0.02)
    assert scene.motor_start_rad < 0 < scene.scan.start_rad
    for column, motor_rad in ((0, scene.scan.start_rad), (scene.camera.width - 1, scene.scan.end_rad)):
        # Where the plane's direction and the wall's distance put the line at the scan's ends.
        alpha = scene.laser.alpha(motor_rad)
        pose = np.array(scene.laser.camera_from_laser)
        light = pose[:3, :3] @ [np.cos(alpha), np.sin(alpha), 0]
        line = scene.camera.project([pose[:3, 3] + light * (2250 - pose[2, 3]) / light[2]])[0, 0]
        assert line < 0 if column == 0 else line > column


def test_calibration(tmp_path) -> None:
    scene = Scene.load("default")
    path = tmp_path / "new" / "calibration.json"
    result = CliRunner().invoke(main, ["default", "--calibration", str(path)])
    assert result.exit_code == 0, result.output
    read = json.loads(path.read_text())
    assert read == scene.calibration()
    assert (read["format"], read["version"]) == ("magtrak-calibration", 1)
    assert read["camera"]["time_offset_s"] == pytest.approx(-(0.0025 + 0.0005))
    assert read["laser"]["zero_rad"] == pytest.approx(np.radians(-12))
    assert read["laser"]["counts_per_turn"] == 8192
    CliRunner().invoke(main, ["default", "--calibration", str(path), "--exposure", "2"])
    assert json.loads(path.read_text())["camera"]["time_offset_s"] == pytest.approx(-0.0015)


def test_override() -> None:
    scene = Scene.load("default").override(frame_rate_hz=25, row_time_us=20, exposure_ms=1, speckle=0)
    assert scene.timing == Timing(480, 25, 20 * 1e-6, 1e-3, 0.5e-3)
    assert scene.laser.speckle == 0
    with pytest.raises(SimError, match="480 rows of 50 us are longer than the frame period of 20 ms"):
        Scene.load("default").override(row_time_us=50)
    with pytest.raises(SimError, match="exposure of 30 ms is longer than the frame period"):
        Scene.load("default").override(exposure_ms=30)
    with pytest.raises(SimError, match="frame rate has to be positive, not 0 Hz"):
        Scene.load("default").override(frame_rate_hz=0)
    with pytest.raises(SimError, match="speckle can't be -1"):
        Scene.load("default").override(speckle=-1)


def test_row_times() -> None:
    timing = Timing(480, exposure_s=0.005, readout_delay_s=0.0005)
    assert timing.row_period_s * 480 == pytest.approx(0.8 * 0.02)
    assert timing.rows(1.0)[[0, -1]] == pytest.approx([1.0, 1.0 + 0.016 * 479 / 480])
    start, end = timing.exposed(np.array([1.0]))
    assert (start[0], end[0]) == pytest.approx((0.9945, 0.9995))
    assert timing.offset_s == pytest.approx((start[0] + end[0]) / 2 - 1)


WRONG = [
    ("width = 160", "width = 160.5", r"\[camera\] width has to be a whole number from 16 to 4096, not 160.5"),
    ("width = 160", "width = true", r"\[camera\] width has to be a whole number from 16 to 4096, not True"),
    ("width = 160", "", r"\[camera\] width is missing; give a whole number"),
    ("noise = 2 ", "noise = -2 ", r"\[camera\] noise has to be a number of at least 0, not -2"),
    ("noise = 2 ", "noise = nan ", r"\[camera\] noise has to be a number of at least 0, not nan"),
    ("noise = 2 ", 'noise = "low" ', r"\[camera\] noise has to be a number of at least 0, not 'low'"),
    ("noise = 2 ", "noize = 2 ", r"\[camera\] noise is missing"),
    ("gain = 1", "gian = 1", r"\[camera\] gian is not a field of a scene; is it misspelt\?"),
    ("[[200, 0, 80.3]", "[[200, 80.3]", r"\[camera\] matrix has to be a matrix of 3 rows of 3 numbers"),
    ("[[200, 0, 80.3]", "[[-200, 0, 80.3]", r"\[camera\] matrix needs positive focal lengths"),
    ("-0.0003, 0.0]", "-0.0003, 0.0, 1]", r"\[camera\] distortion has to be a list of 4 or 5 or 8 numbers"),
    ("exposure_ms = 2", "exposure_ms = 30", "exposure of 30 ms is longer than the frame period"),
    ("[[0, 1, 0, -500]", "[[0, 2, 0, -500]", r"\[laser\] camera_from_laser is not a pose"),
    ("sense = 1", "sense = 0", r"\[laser\] sense has to be 1 or -1, not 0"),
    ("[0.16, 1.0, 0.12]", "[0.16, 0.9, 0.12]", r"\[laser\] response has to have 1 as its greatest number, not 0.9"),
    ("counts_per_turn = 8192", "counts_per_turn = 8190", r"\[encoder\] counts_per_turn has to be divisible by 4"),
    ("inertia_kg_m2 = 0.21", "inertia_kg_m2 = 0", r"\[motor\] inertia_kg_m2 has to be a number greater than 0, not 0"),
    ("direction = [-0.3, -0.8, -0.5]", "direction = [0, 0, 0]", r"\[ambient\] direction has to point somewhere"),
    ("frames = 24", "frames = 0", r"\[scan\] frames has to be a whole number from 1"),
    ('"sphere"', '"ball"', r"\[object 3\] shape has to be one of plane, box, cylinder, sphere, board, not 'ball'"),
    ("radius_mm = 140", "radius_mm = -1", r"\[object 3\] shape sphere can't be: the radius .* positive, not -1"),
    ("[0.70, 0.80, 0.60]", "[0.70, 1.80, 0.60]", r"\[object 3\] albedo has to be a list of 3 numbers .* up to 1"),
    ("[scan]", "[scene]", r"\[scan\] frames is missing"),
    ("[camera]", "camera = 5\n[kamera]", r"camera has to be a table, not 5"),
    ("[camera]", "[camera", "is not valid TOML"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_wrong_fields(tmp_path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    path = tmp_path / "mine.toml"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(SimError, match=message) as error:
        Scene.load(path)
    assert "\n" not in str(error.value)


def test_every_field_is_needed_or_has_a_default(tmp_path) -> None:
    """No file with one field less ends in anything but a scene or a sentence that names file and field."""
    tables = tomllib.loads(TEXT)
    path = tmp_path / "mine.toml"
    tried = 0
    for table, fields in tables.items():
        if table == "object":
            continue
        for field in fields:
            lines, inside = [], False
            for line in TEXT.splitlines():
                inside = line.startswith(f"[{table}]") if line.startswith("[") else inside
                if not (inside and line.split(" ")[0] == field):
                    lines.append(line)
            path.write_text("\n".join(lines))
            tried += 1
            try:
                Scene.load(path)
            except SimError as error:
                assert f"[{table}] {field} is missing" in str(error)
                assert str(path) in str(error)
    assert tried > 30


def test_no_scene(tmp_path) -> None:
    with pytest.raises(SimError, match=r"no scene called moon; there are .*default, .*quick, "):
        Scene.load("moon")
    with pytest.raises(SimError, match=r"none\.toml can't be read: No such file"):
        Scene.load(tmp_path / "none.toml")
    result = CliRunner().invoke(main, ["moon", "--calibration", str(tmp_path / "c.json")])
    assert result.exit_code == 1
    assert result.output.startswith("Error: there is no scene called moon")


WATER = """
[water]
index = 1.34
attenuation_per_m = [0.5, 0.1, 0.2]
veil = [0.1, 0.2, 0.3]
[water.camera_port]
distance_mm = 40
normal = [0, 0, 2]
[water.laser_port]
distance_mm = 60
normal = [1, 0, 0]
"""


def test_water(tmp_path) -> None:
    path = tmp_path / "wet.toml"
    path.write_text('like = "quick"\n' + WATER)
    scene = Scene.load(path)
    assert scene.water is not None
    assert scene.water.camera.normal == (0, 0, 1)
    assert scene.calibration()["ports"]["water_index"] == 1.34
    assert "ports" not in Scene.load("quick").calibration()
    # A wall straight ahead, at 1.2 m of water: what comes back of white, and what the water adds.
    light = scene.dimmed(np.ones((1, 3)), np.array([1200.0]))
    kept = np.exp(-1.2 * np.array([0.5, 0.1, 0.2]))
    assert light[0] == pytest.approx(kept + np.array([0.1, 0.2, 0.3]) * (1 - kept))
    assert scene.project(np.array([[0.0, 0, 1500]])) == pytest.approx(
        Scene.load("quick").project(np.array([[0.0, 0, 1]]))
    )
    for old, new, message in (
        ("normal = [0, 0, 2]", "normal = [0, 0, 0]", r"\[water.camera_port\] normal has to point into the water"),
        ("index = 1.34", "index = 0.9", r"\[water\] index has to be a number of at least 1"),
        ("distance_mm = 60", "depth = 60", r"\[water.laser_port\] distance_mm is missing"),
    ):
        path.write_text('like = "quick"\n' + WATER.replace(old, new))
        with pytest.raises(SimError, match=message):
            Scene.load(path)


def test_glow_lies_before_the_surface_and_is_brighter_near(tmp_path) -> None:
    path = tmp_path / "wet.toml"
    path.write_text('like = "quick"\n' + WATER.replace("index = 1.34", "index = 1.34\nglow = 10"))
    haze = Haze.of(Scene.load(path))
    row = slice(60, 61)
    near, far = float(haze.near[60, 80]), float(haze.far[60, 80])
    assert near > far, "the light comes from the left: it crosses the sight sooner at greater angles"
    glow = [
        float(haze.glow(row, np.array([far + part * (near - far)]))[0, 80]) for part in (-0.01, 0.01, 0.5, 0.99, 1.01)
    ]
    assert glow[0] == glow[4] == 0
    assert 0 < glow[1] < glow[2] < glow[3]
