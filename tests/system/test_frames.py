"""Pictures with given angles: what the file says reaches the cloud through encoder edges and index alone."""

import json

import numpy as np
import pytest
from PIL import Image

from magtrak.cloud.ply import read_ply
from tests.support.virtual import receive, virtual_card

WIDTH, HEIGHT, COUNTS = 64, 48, 8192
ZERO_RAD = 0.4
CALIBRATION = {
    "format": "magtrak-calibration",
    "version": 1,
    "camera": {
        "model": "brown-conrady",
        "width": WIDTH,
        "height": HEIGHT,
        "matrix": [[80, 0, 31.5], [0, 80, 23.5], [0, 0, 1]],
        "distortion": [0, 0, 0, 0, 0],
    },
    "laser": {
        "camera_from_laser": [[0, 1, 0, -500], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]],
        "zero_rad": ZERO_RAD,
        "sense": 1,
        "counts_per_turn": COUNTS,
    },
}


def line(column: float) -> Image.Image:
    """A green line of sigma 1.5 px at a column, the same in every row."""
    light = 180 * np.exp(-((np.arange(WIDTH) - column) ** 2) / 4.5)
    row = 6 + light[:, None] * [0.2, 1.0, 0.25]
    return Image.fromarray(np.tile(row.round().astype(np.uint8), (HEIGHT, 1, 1)))


@pytest.mark.parametrize(
    "angles",
    [
        pytest.param([(0.5, 0.9), (1.0, 1.4), (1.5, 1.9), (2.0, 2.4), (2.5, 2.9)], id="forward"),
        pytest.param([(-3.0, -3.4), (-3.5, -3.9), (-4.0, -4.4), (-4.5, -4.9)], id="backward below the index"),
        pytest.param([(1.0, 1.4), (1.5, 1.9), (1.9, 1.5), (1.4, 1.0), (0.9, 0.5)], id="there and back"),
    ],
)
def test_angles_reach_the_points(tmp_path, angles):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    columns = [20.25 + 5 * number for number in range(len(angles))]
    for number, column in enumerate(columns):
        line(column).save(pictures / f"{number}.png")
    lines = "".join(f"{number},{start},{end}\n" for number, (start, end) in enumerate(angles))
    (tmp_path / "angles.csv").write_text("frame,angle_start_deg,angle_end_deg\n" + lines)
    (tmp_path / "calibration.json").write_text(json.dumps(CALIBRATION))
    with virtual_card(tmp_path / "card", "--frames", pictures, "--angles", tmp_path / "angles.csv") as card:
        receive(tmp_path / "card", tmp_path / "calibration.json", tmp_path / "cloud.ply")
        assert card.wait(timeout=60) == 0
    points = read_ply(tmp_path / "cloud.ply")
    assert len(points) == HEIGHT * len(angles)
    for number, (start, end) in enumerate(angles):
        mine = points[points["scalar_frame"] == number]
        assert len(mine) == HEIGHT
        expected = ZERO_RAD + np.radians(start + (end - start) * mine["scalar_row"] / (HEIGHT - 1))
        counts = (mine["scalar_angle"] - expected) * COUNTS / (2 * np.pi)
        # Straight lines with corners between the pictures; the host lays a smooth curve through the edges.
        print(f"picture {number}: {np.abs(counts).max():.3f} counts")
        assert np.abs(counts).max() < 0.1
        assert np.abs(mine["scalar_column"] - columns[number]).max() < 0.05
