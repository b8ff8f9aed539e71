"""Calibrations for tests."""

from typing import Any


def example_calibration(width: int = 64, height: int = 48) -> dict[str, Any]:
    """A file's content: laser 500 mm to the left of the camera, its axis down, positive angles turn it right."""
    return {
        "format": "magtrak-calibration",
        "version": 1,
        "camera": {
            "model": "brown-conrady",
            "width": width,
            "height": height,
            "time_offset_s": 0.0,
            "matrix": [[1.25 * width, 0, (width - 1) / 2], [0, 1.25 * width, (height - 1) / 2], [0, 0, 1]],
            "distortion": [0, 0, 0, 0, 0],
        },
        "laser": {
            "camera_from_laser": [[0, 1, 0, -500], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]],
            "offset_mm": 0.0,
            "tilt_rad": 0.0,
            "zero_rad": 0.0,
            "sense": 1,
            "counts_per_turn": 8192,
        },
    }
