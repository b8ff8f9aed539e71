"""The calibration file: camera, laser and what lies between them.

JSON with the sections ``camera`` (:class:`CameraCalibration`), ``laser`` (:class:`magtrak.laser.Laser`) and, if need
be, ``encoder`` with its ``error_table`` and ``ports`` (:class:`magtrak.ports.Ports`, under water); lengths in mm,
angles in rad. Every field is checked when a file is read, and keys that this version does not know are kept when it is
written again.
"""

import copy
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import Floats
from .camera import BrownConrady, CameraModel, Projection
from .checked import Checked
from .errors import CalibrationError, OutputError
from .laser import Laser
from .ports import Ports

FORMAT = "magtrak-calibration"
VERSION = 1
MODELS = ("brown-conrady", "projection")

# A rotation written with five digits is within this of orthonormal.
ROTATION_TOLERANCE = 1e-4


@dataclass(frozen=True)
class CameraCalibration:
    """The camera's part of the file.

    Parameters
    ----------
    model : "brown-conrady" or "projection"
    width, height : size of the picture, px
    matrix : (3, 3), or (3, 4) for a projection
    distortion : (4,), (5,) or (8,) in OpenCV's order; empty for a projection
    time_offset_s : added to a row's time to get the time at which its light was gathered
    """

    model: str
    width: int
    height: int
    matrix: Floats
    distortion: Floats = field(default_factory=lambda: np.zeros(5))
    time_offset_s: float = 0.0

    def build(self) -> CameraModel:
        """The camera model; :exc:`CalibrationError` where it cannot be inverted."""
        if self.model == "projection":
            return Projection(self.matrix)
        return BrownConrady(self.matrix, self.distortion, self.width, self.height)


@dataclass(frozen=True)
class Calibration:
    """A whole calibration; ``extra`` is the file as read, unknown keys included; ``ports`` is None in air."""

    camera: CameraCalibration
    laser: Laser
    extra: Mapping[str, Any] = field(default_factory=dict)
    ports: Ports | None = None

    @classmethod
    def parse(cls, values: object, where: str = "calibration") -> "Calibration":
        """From parsed JSON; ``where`` names it in errors.

        Raises
        ------
        CalibrationError
            Names the file, the field, its value and what was expected.
        """
        top = Checked(where, values, CalibrationError)
        top.choice("format", [FORMAT])
        top.choice("version", [VERSION])
        calibration = cls(
            _camera(top.section("camera")),
            _laser(top.section("laser"), top.section("encoder", required=False)),
            copy.deepcopy(dict(top.values)),
            Ports.parse(top.section("ports")) if "ports" in top.values else None,
        )
        try:
            calibration.camera.build()
        except CalibrationError as error:
            raise CalibrationError(f"{where}: {error}") from None
        return calibration

    @classmethod
    def load(cls, path: Path) -> "Calibration":
        """From a file; :exc:`CalibrationError` as in :meth:`parse`, and where it is no JSON."""
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise CalibrationError(f"calibration {path} does not exist: check the path") from None
        except (OSError, UnicodeDecodeError) as error:
            raise CalibrationError(f"calibration {path} cannot be read: {error}") from None
        try:
            values = json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            raise CalibrationError(f"calibration {path} is no JSON: {error}") from None
        return cls.parse(values, str(path))

    def save(self, path: Path) -> None:
        """Write the file, unknown keys included."""
        try:
            path.write_text(json.dumps(self.as_dict(), indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise OutputError(f"calibration {path} cannot be written: {error.strerror}") from None

    def as_dict(self) -> dict[str, Any]:
        """What :meth:`save` writes: known fields over whatever else was read."""
        values = copy.deepcopy(dict(self.extra))
        values["format"], values["version"] = FORMAT, VERSION
        camera = values.setdefault("camera", {})
        camera["model"], camera["width"], camera["height"] = self.camera.model, self.camera.width, self.camera.height
        camera["time_offset_s"] = self.camera.time_offset_s
        camera["matrix"] = self.camera.matrix.tolist()
        if self.camera.model == "brown-conrady":
            camera["distortion"] = self.camera.distortion.tolist()
        laser = values.setdefault("laser", {})
        laser["camera_from_laser"] = self.laser.camera_from_laser.tolist()
        for name in ("offset_mm", "tilt_rad", "zero_rad", "sense", "counts_per_turn"):
            laser[name] = getattr(self.laser, name)
        if len(self.laser.error_table):
            values.setdefault("encoder", {})["error_table"] = self.laser.error_table.tolist()
        values.pop("ports", None)  # as read: they may have been taken out since
        if self.ports is not None:
            values["ports"] = self.ports.as_dict()
        return values


def _camera(table: Checked) -> CameraCalibration:
    model = table.choice("model", MODELS)
    width, height = table.integer("width", 1, 65535), table.integer("height", 1, 65535)
    time_offset_s = table.number("time_offset_s", -1, 1, 0.0)
    if model == "projection":
        matrix = table.array("matrix", (3, 4))
        return CameraCalibration(model, width, height, matrix, np.zeros(0), time_offset_s)
    matrix = table.array("matrix", (3, 3))
    fixed = (matrix[0, 1], matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2])
    if fixed != (0, 0, 0, 0, 1) or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        table.refuse("matrix", "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx and fy greater than 0")
    distortion = table.array("distortion", (4,), (5,), (8,))
    return CameraCalibration(model, width, height, matrix, distortion, time_offset_s)


def _laser(table: Checked, encoder: Checked) -> Laser:
    pose = table.array("camera_from_laser", (4, 4))
    rotation = pose[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=ROTATION_TOLERANCE) or np.linalg.det(rotation) < 0:
        table.refuse("camera_from_laser", "a rotation (orthonormal, right-handed) in its left upper 3 x 3")
    if not np.array_equal(pose[3], [0, 0, 0, 1]):
        table.refuse("camera_from_laser", "4 rows of 4 of which the last is [0, 0, 0, 1]")
    counts_per_turn = table.integer("counts_per_turn", 4, 2**24 - 1)
    error_table = np.zeros(0)
    if "error_table" in encoder.values:
        error_table = encoder.array("error_table", (-1,))
        if counts_per_turn % len(error_table):
            encoder.refuse("error_table", f"a list whose length divides counts_per_turn, {counts_per_turn}")
    return Laser(
        camera_from_laser=pose,
        offset_mm=table.number("offset_mm", -1000, 1000, 0.0),
        tilt_rad=table.number("tilt_rad", -1.5, 1.5, 0.0),
        zero_rad=table.number("zero_rad", -1000, 1000),
        sense=table.choice("sense", [1, -1]),
        counts_per_turn=counts_per_turn,
        error_table=error_table,
    )
