"""``camera_info`` as ROS reads it (``camera_info_manager``, YAML)."""

import json
from pathlib import Path

from ..calibration import Calibration
from ..errors import CalibrationError, OutputError

NAMES = {4: "plumb_bob", 5: "plumb_bob", 8: "rational_polynomial"}


def camera_info(calibration: Calibration, name: str = "magtrak") -> str:
    """The YAML text.

    Raises
    ------
    CalibrationError
        The camera is a bare projection matrix, which ROS has no field for.
    """
    camera = calibration.camera
    if camera.model != "brown-conrady":
        raise CalibrationError(
            "a camera of model projection has no distortion model that ROS knows: calibrate a pinhole"
        )
    k = [float(value) for value in camera.matrix.ravel()]
    d = [float(value) for value in camera.distortion]
    d += [0.0] * (5 - len(d))
    p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
    r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    parts = [
        f"image_width: {camera.width}",
        f"image_height: {camera.height}",
        f"camera_name: {json.dumps(name)}",
        _matrix("camera_matrix", 3, 3, k),
        f"distortion_model: {NAMES[len(camera.distortion)]}",
        _matrix("distortion_coefficients", 1, len(d), d),
        _matrix("rectification_matrix", 3, 3, r),
        _matrix("projection_matrix", 3, 4, p),
    ]
    return "\n".join(parts) + "\n"


def save(calibration: Calibration, path: Path, name: str = "magtrak") -> None:
    """Write it to a file."""
    text = camera_info(calibration, name)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from None


def _matrix(name: str, rows: int, columns: int, values: list[float]) -> str:
    return f"{name}:\n  rows: {rows}\n  cols: {columns}\n  data: {json.dumps(values)}"
