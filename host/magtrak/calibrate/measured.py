"""The paper's own calibration: a projection matrix from point pairs, and a laser measured by hand on a floor."""

from pathlib import Path

import numpy as np

from ..calibration import Calibration, CameraCalibration
from ..errors import CalibrationError
from ..laser import Laser
from .linear import linear_camera

AXIS_DOWN = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""X_L forward, Y_L to the right, Z_L down."""


def measured_laser(values: tuple[float, float, float, float], sense: int, counts_per_turn: int) -> Laser:
    """A laser whose axis points down through (x, y, z) mm of C, with its zero in degrees from straight ahead; the plane
    goes through the axis.
    """
    x, y, z, zero_deg = values
    pose = np.eye(4)
    pose[:3, :3] = AXIS_DOWN
    pose[:3, 3] = [x, y, z]
    return Laser(pose, zero_rad=float(np.radians(zero_deg)), sense=sense, counts_per_turn=counts_per_turn)


def linear_calibration(source: Path, size: tuple[int, int], previous: object = None) -> tuple[Calibration, str]:
    """From a CSV with header ``x,y,z,u,v``: the calibration, and the ten parameters as text.

    Raises
    ------
    CalibrationError
        The file cannot be read, or its pairs determine no camera.
    """
    try:
        values = np.loadtxt(source, delimiter=",", skiprows=1, ndmin=2)
        points, pixels = values[:, :3], values[:, 3:5]
        if pixels.shape[1] != 2 or not np.isfinite(values).all():
            raise ValueError("five numbers a line are needed: x,y,z,u,v")
    except (OSError, ValueError, IndexError) as error:
        raise CalibrationError(f"point pairs {source} cannot be read: {error}") from None
    found = linear_camera(points, pixels)
    camera = CameraCalibration("projection", *size, found.in_camera_frame, np.zeros(0))
    laser = previous.laser if isinstance(previous, Calibration) else Laser(np.eye(4))
    names = ("alpha_u", "alpha_v", "u_0", "v_0")
    lines = [f"{len(points)} pairs, RMS {found.rms_px:.3f} px, skew of the axes {found.skew:+.3f} px"]
    for name, value, sigma in zip(names, found.intrinsics, found.sigmas, strict=False):
        lines.append(f"  {name:8} {value:10.3f} +- {sigma:.3f} px")
    turn = ", ".join(f"{np.degrees(sigma):.3f}" for sigma in found.sigmas[4:7])
    lines.append(f"  rotation of C T W, +- ({turn}) degrees about X, Y, Z of C")
    lines += ["    " + "  ".join(f"{value:9.6f}" for value in row) for row in found.rotation]
    for name, value, sigma in zip(("t_x", "t_y", "t_z"), found.translation, found.sigmas[7:], strict=True):
        lines.append(f"  {name:8} {value:10.2f} +- {sigma:.2f} mm")
    extra = {
        "linear": {
            "image_from_world": found.matrix.tolist(),
            "camera_from_world": np.c_[found.rotation, found.translation].tolist(),
            "sigmas": found.sigmas.tolist(),
            "rms_px": found.rms_px,
        }
    }
    return Calibration(camera, laser, extra), "\n".join(lines)
