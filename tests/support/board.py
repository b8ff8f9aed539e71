"""Ten real pictures of a board at hand-placed distances, through the virtual card.

Camera, laser plane and the board's tilt are the same in all; the ruler's zero is unknown. Laser plane, zero and one
tilt are fitted to nine pictures in the image (residual: column of the line), and predict the distance of the tenth.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

import magtrak
from magtrak.calibration import Calibration
from tests.support.pictures import folder
from tests.support.virtual import ambiguous, measured_pictures

DISTANCES_MM = np.arange(260, 60, -20)
FIRST_ROW, LAST_ROW = 100, 329
START = [120.0, 0.0, -0.5, 50.0, 0.0]  # laser plane X = a + b Y + c Z, zero of the ruler, tilt about the vertical
ZERO_MM, TILT_RAD = 30.0, 0.5  # how far off ruler and board may well be


def measured_lines(path: Path, peak: str) -> tuple[list[np.ndarray], int]:
    """For each picture: normalised (x, y) of its rows, undistorted, and their number. And how many are ambiguous.

    Settings are the preset ``red`` with ``peak`` as its table ``[peak]``.
    """
    pictures = folder("board_distances")
    camera = json.loads((pictures / "camera.json").read_text())
    lens = {
        "model": "brown-conrady",
        "width": camera["width"],
        "height": camera["height"],
        "matrix": camera["camera_matrix"],
        "distortion": camera["distortion"],
    }
    preset = (Path(magtrak.__file__).parent / "presets" / "red.toml").read_text()
    settings = path / "settings.toml"
    settings.write_text(preset[: preset.index("[peak]")] + f"[peak]\n{peak}\n")
    points = measured_pictures(path, pictures, lens, str(settings))
    model = Calibration.load(path / "calibration.json").camera.build()
    found, doubtful = [], 0
    for number in range(len(DISTANCES_MM)):
        mine = points[points["scalar_frame"] == number]
        mine = mine[(mine["scalar_row"] >= FIRST_ROW) & (mine["scalar_row"] <= LAST_ROW)]
        doubtful += int(ambiguous(mine).sum())
        ray = model.ray(mine["scalar_column"].astype(float), mine["scalar_row"].astype(float))
        found.append(ray[:, :2] / ray[:, 2:])
    return found, doubtful


def shares(lines: Sequence[np.ndarray]) -> np.ndarray:
    """The part of the rows of each picture that gave a point."""
    return np.array([len(line) / (LAST_ROW - FIRST_ROW + 1) for line in lines])


def depth(model: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Where rays meet the laser plane: Z in mm."""
    a, b, c = model[:3]
    return a / (xy[:, 0] - b * xy[:, 1] - c)


def predicted_x(model: np.ndarray, y: np.ndarray, distance_mm: float) -> np.ndarray:
    """Normalised column of the line on a board Z + t X = distance + zero."""
    a, b, c, zero, tilt = model
    far = distance_mm + zero
    return (a / far + b * y + c) / (1 - a * tilt / far)


def fit(lines: Sequence[np.ndarray], numbers: Sequence[int]) -> np.ndarray:
    """Laser plane, zero and tilt from the pictures of these numbers."""

    def residuals(model: np.ndarray) -> np.ndarray:
        # One residual of weight 1 px for each picture: its rows share the error of the hand that placed the board.
        columns = [
            500 * (predicted_x(model, lines[n][:, 1], DISTANCES_MM[n]) - lines[n][:, 0]) / np.sqrt(len(lines[n]))
            for n in numbers
        ]
        # Zero and tilt can run away together; a ruler's zero is within centimetres. The prediction hardly depends on
        # how tightly that is said: 2.1 mm at worst for 20 mm as for 100 mm.
        return np.concatenate([*columns, [model[3] / ZERO_MM, model[4] / TILT_RAD]])

    return least_squares(residuals, START, x_scale=[100, 0.1, 0.1, 100, 0.1]).x


def prediction_error_mm(lines: Sequence[np.ndarray], left_out: int) -> float:
    """Distance of a picture by the fit to the others, less that of the ruler."""
    model = fit(lines, [n for n in range(len(lines)) if n != left_out])
    board = depth(model, lines[left_out]) * (1 + model[4] * lines[left_out][:, 0]) - model[3]
    return float(np.median(board)) - float(DISTANCES_MM[left_out])


def scatter_mm(lines: Sequence[np.ndarray]) -> np.ndarray:
    """RMS by which the rows of each picture leave a straight line."""
    model = fit(lines, range(len(lines)))
    found = []
    for line in lines:
        z = depth(model, line)
        y = z * line[:, 1]
        found.append(float(np.sqrt(np.mean((z - np.polyval(np.polyfit(y, z, 1), y)) ** 2))))
    return np.array(found)
