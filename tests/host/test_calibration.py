"""Calibration files: every field checked, unknown keys kept."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magtrak.calibration import Calibration
from magtrak.camera import Projection
from magtrak.errors import CalibrationError, OutputError
from tests.support.calibrations import example_calibration

DELETE = object()

SKEWED = [[80, 1, 31.5], [0, 80, 23.5], [0, 0, 1]]
MIRRORED = [[0, -1, 0, -500], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
STRETCHED = [[0, 1.1, 0, -500], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
BAD_LAST_ROW = [[0, 1, 0, -500], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 1, 1]]

WRONG: list[tuple[str, Any, str]] = [
    ("format", "other", "format is 'other'; it must be 'magtrak-calibration'"),
    ("format", DELETE, "format is missing"),
    ("version", 2, "version is 2; it must be 1"),
    ("version", True, "version is True"),
    ("camera", DELETE, "camera is missing"),
    ("camera", [1], "camera must be a table of named values, not \\[1\\]"),
    ("camera.model", "fisheye", "camera.model is 'fisheye'; it must be 'brown-conrady' or 'projection'"),
    ("camera.width", 0, "camera.width is 0; it must be a whole number from 1 to 65535"),
    ("camera.width", 640.5, "camera.width is 640.5"),
    ("camera.height", "480", "camera.height is '480'"),
    ("camera.height", DELETE, "camera.height is missing; it must be a whole number"),
    ("camera.time_offset_s", 5, "camera.time_offset_s is 5; it must be a number from -1 to 1"),
    ("camera.time_offset_s", float("nan"), "camera.time_offset_s is nan"),
    ("camera.matrix", SKEWED, "camera.matrix is .* it must be \\[\\[fx, 0, cx\\]"),
    ("camera.matrix", [[-80, 0, 31.5], [0, 80, 23.5], [0, 0, 1]], "greater than 0"),
    ("camera.matrix", [[1, 2], [3, 4]], "camera.matrix is .* it must be finite numbers, 3 rows of 3"),
    ("camera.matrix", [[1, 2, 3], [1, 2], [1, 2, 3]], "camera.matrix is"),
    ("camera.matrix", [[1, 2, "3"], [1, 2, 3], [1, 2, 3]], "camera.matrix is"),
    ("camera.distortion", [0, 0, 0], "a list of 4 or a list of 5 or a list of 8"),
    ("camera.distortion", [0, 0, 0, float("inf")], "camera.distortion is"),
    ("camera.distortion", [-3, 0, 0, 0], "camera.distortion cannot be taken out at pixel"),
    ("laser", DELETE, "laser is missing"),
    ("laser.camera_from_laser", MIRRORED, "laser.camera_from_laser is .* a rotation"),
    ("laser.camera_from_laser", STRETCHED, "a rotation"),
    ("laser.camera_from_laser", BAD_LAST_ROW, "last is \\[0, 0, 0, 1\\]"),
    ("laser.camera_from_laser", [[0, 1, 0]], "4 rows of 4"),
    ("laser.offset_mm", None, "laser.offset_mm is None; it must be a number"),
    ("laser.tilt_rad", 2, "laser.tilt_rad is 2"),
    ("laser.zero_rad", DELETE, "laser.zero_rad is missing"),
    ("laser.sense", 0, "laser.sense is 0; it must be 1 or -1"),
    ("laser.counts_per_turn", 0, "laser.counts_per_turn is 0; it must be a whole number from 4"),
    ("encoder", {"error_table": []}, "encoder.error_table is \\[\\]"),
    ("encoder", {"error_table": [0, 1, 2]}, "encoder.error_table is .* divides counts_per_turn, 8192"),
]


def changed(path: str, value: Any) -> dict[str, Any]:
    values = example_calibration()
    *tables, name = path.split(".")
    table = values
    for step in tables:
        table = table[step]
    if value is DELETE:
        del table[name]
    else:
        table[name] = value
    return values


@pytest.mark.parametrize(("path", "value", "message"), WRONG, ids=[f"{p}-{n}" for n, (p, _, _) in enumerate(WRONG)])
def test_every_wrong_field_is_named(path: str, value: Any, message: str) -> None:
    with pytest.raises(CalibrationError, match=rf"^rig.json: .*{message}") as caught:
        Calibration.parse(changed(path, value), "rig.json")
    assert "\n" not in str(caught.value)


def test_file_is_read_written_and_read_again_with_unknown_keys_kept(tmp_path: Path) -> None:
    values = example_calibration()
    values["residuals"] = {"rms_px": 0.2}
    values["camera"]["sigmas"] = [1, 2]
    values["encoder"] = {"error_table": [0.1, -0.1], "maker": "x"}
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(values))
    loaded = Calibration.load(path)
    loaded.save(tmp_path / "copy.json")
    again = json.loads((tmp_path / "copy.json").read_text())
    assert again == values
    assert loaded.laser.counts_per_turn == 8192


def test_what_was_read_does_not_change_with_what_was_parsed() -> None:
    values = example_calibration()
    before = copy.deepcopy(values)
    calibration = Calibration.parse(values)
    calibration.as_dict()["camera"]["width"] = 1
    assert values == before == {**calibration.extra}


def test_projection_camera_is_read() -> None:
    values = example_calibration()
    matrix = [[80, 0, 31.5, 10], [0, 80, 23.5, 20], [0, 0, 1, 0.5]]
    values["camera"] = {"model": "projection", "width": 64, "height": 48, "matrix": matrix}
    calibration = Calibration.parse(values)
    assert isinstance(calibration.camera.build(), Projection)
    assert np.array_equal(calibration.camera.matrix, matrix)
    values["camera"]["matrix"] = [[1, 0, 0, 0]] * 3
    with pytest.raises(CalibrationError, match=r"camera.matrix has a singular left 3 x 3"):
        Calibration.parse(values)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"does not exist: check the path"):
        Calibration.load(tmp_path / "none.json")
    with pytest.raises(CalibrationError, match=r"cannot be read"):
        Calibration.load(tmp_path)
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(CalibrationError, match=r"a.json is no JSON"):
        Calibration.load(tmp_path / "a.json")
    (tmp_path / "a.json").write_text("[]")
    with pytest.raises(CalibrationError, match=r"the file must be a table of named values"):
        Calibration.load(tmp_path / "a.json")
    (tmp_path / "a.json").write_bytes(b"\xff\xfe")
    with pytest.raises(CalibrationError, match=r"cannot be read"):
        Calibration.load(tmp_path / "a.json")


def test_saving_where_nothing_can_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"cannot be written"):
        Calibration.parse(example_calibration()).save(tmp_path / "none" / "a.json")
