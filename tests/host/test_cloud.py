"""Files and pictures of clouds."""

import struct
from pathlib import Path

import numpy as np
import pytest

from magtrak.cloud.picture import draw
from magtrak.cloud.ply import read_ply, write_ply
from magtrak.cloud.points import POINT
from magtrak.errors import MagtrakError, OutputError

HEADER = """\
element vertex 2
property float x
property float y
property float z
property float intensity
property float quality
property int scalar_frame
property int scalar_row
property float scalar_column
property float scalar_angle
property float scalar_width
property double scalar_time
end_header
"""


def two_points() -> np.ndarray:
    points = np.zeros(2, POINT)
    points[0] = (1.5, -2.25, 2000.125, 0.5, 1.0, 7, 123, 45.25, -0.125, 6, 1e-9)
    points[1] = (3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 12345.678901234)
    return points


def test_file_byte_for_byte(tmp_path: Path) -> None:
    points = two_points()
    write_ply(tmp_path / "a.ply", [points[:1], points[:0], points[1:]], ["made by hand"])
    data = (tmp_path / "a.ply").read_bytes()
    head, body = data[: -2 * 48], data[-2 * 48 :]
    assert head.startswith(b"ply\nformat binary_little_endian 1.0\ncomment magtrak ")
    assert head.decode().endswith("comment made by hand\n" + HEADER)
    assert body[:48] == struct.pack("<5f2i3fd", 1.5, -2.25, 2000.125, 0.5, 1.0, 7, 123, 45.25, -0.125, 6, 1e-9)
    assert np.array_equal(read_ply(tmp_path / "a.ply"), points)
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_empty_cloud(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", [np.zeros(0, POINT)])
    assert len(read_ply(tmp_path / "a.ply")) == 0


def test_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written: No such file"):
        write_ply(tmp_path / "none" / "a.ply", [two_points()])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-1], "holds 95 bytes of points, not the 96"),
        (lambda data: data.replace(b"binary_little", b"binary_big"), "no binary little-endian PLY"),
        (lambda data: data.replace(b"end_header", b"end_of_file"), "no binary little-endian PLY"),
        (lambda data: data.replace(b"property int scalar_row", b"property list uchar int i"), "property list"),
        (lambda data: data.replace(b"element vertex 2", b"element face 2"), "element face 2"),
    ],
)
def test_files_that_cannot_be_read(tmp_path: Path, change, message: str) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, [two_points()])
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(MagtrakError, match=message):
        read_ply(path)
    with pytest.raises(MagtrakError, match="cannot be read"):
        read_ply(tmp_path / "none.ply")


def test_picture_is_a_png_that_shows_the_points(tmp_path: Path) -> None:
    from matplotlib.image import imread

    rng = np.random.default_rng(1)
    points = np.zeros(20_000, POINT)
    points["x"], points["y"] = rng.uniform(-500, 500, (2, 20_000))
    points["z"] = np.where(points["x"] > 0, 2000, 1800)
    draw(points, tmp_path / "a.png")
    picture = imread(tmp_path / "a.png")[:, :, :3]
    coloured = np.ptp(picture, axis=2) > 0.2
    assert coloured[:, : picture.shape[1] // 2].mean() > 0.02
    with pytest.raises(OutputError, match=r"picture .* cannot be written"):
        draw(points, tmp_path / "none" / "a.png")
