"""The paper's linear model, boards on paper, ROS files, and the commands."""

import json
import re
import zlib

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from magtrak.calibrate.board import A3, LARGE
from magtrak.calibrate.detect import detect
from magtrak.calibrate.linear import linear_camera
from magtrak.calibrate.printing import page_mm, write_board
from magtrak.calibrate.ros import camera_info
from magtrak.calibration import Calibration
from magtrak.cli.calibrate import main
from magtrak.errors import OutputError
from tests.support.board_pictures import MATRIX, write_pictures
from tests.support.calibration_rig import rotation
from tests.support.calibrations import example_calibration


def pairs(noise_px=0.0, count=24, seed=1):
    rng = np.random.default_rng(seed)
    k = np.array([[800.0, 0, 320], [0, 810, 236], [0, 0, 1]])
    turn = rotation(np.array([2.0, 0.3, -0.2]))
    shift = np.array([-100.0, 50, 1500])
    points = rng.uniform(0, 300, (count, 3))
    points[::2, 0] = 0  # the two planes of a calibrating pattern
    points[1::2, 1] = 0
    seen = (points @ turn.T + shift) @ k.T
    return points, seen[:, :2] / seen[:, 2:] + rng.normal(0, noise_px, (count, 2)), k, turn, shift


def test_ten_parameters_come_back_exactly():
    points, pixels, _, turn, shift = pairs()
    found = linear_camera(points, pixels)
    np.testing.assert_allclose(found.intrinsics, [800, 810, 320, 236], rtol=1e-6)
    np.testing.assert_allclose(found.rotation, turn, atol=1e-7)
    np.testing.assert_allclose(found.translation, shift, rtol=1e-5)
    seen = np.c_[points, np.ones(len(points))] @ found.matrix.T
    np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], pixels, atol=1e-5)
    assert abs(found.skew) < 1e-5


def test_sigmas_of_the_linear_model_hold():
    within = []
    for seed in range(20):
        points, pixels, *_, shift = pairs(0.3, seed=seed)
        found = linear_camera(points, pixels)
        real = np.array([800, 810, 320, 236, *shift])
        errors = np.array([*found.intrinsics, *found.translation]) - real
        within += list(np.abs(errors) < 2 * found.sigmas[[0, 1, 2, 3, 7, 8, 9]])
    assert 0.88 < np.mean(within) <= 1.0


@pytest.mark.parametrize("board", [A3, LARGE], ids=lambda board: board.name)
def test_a_printed_board_has_its_size(tmp_path, board):
    path = tmp_path / "board.png"
    write_board(board, path)
    page = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    scale = page.shape[1] / page_mm(board)[0]
    small = cv2.resize(page, None, fx=1200 / page.shape[1], fy=1200 / page.shape[1], interpolation=cv2.INTER_AREA)
    found = detect(small, board, "print")
    assert len(found.ids) == board.corners
    side = np.linalg.norm(found.corners[1] - found.corners[0]) / 1200 * page.shape[1] / scale
    assert side == pytest.approx(board.square_mm, rel=2e-3)
    left, top, right, bottom = (round(value * scale) for value in board.band_mm)
    x, y = round(max(8.0, -board.band_mm[0]) * scale), round(8.0 * scale)
    assert (page[y + top + 3 : y + bottom - 3, max(x + left, 0) : x + right] == 255).all()


def test_a_pdf_is_as_large_as_the_board(tmp_path):
    path = tmp_path / "board.pdf"
    write_board(A3, path)
    data = path.read_bytes()
    width, height = (float(value) for value in re.search(rb"MediaBox \[0 0 (\S+) (\S+)\]", data).groups())
    np.testing.assert_allclose([width / 72 * 25.4, height / 72 * 25.4], page_mm(A3), rtol=1e-5)
    columns, rows = (int(value) for value in re.search(rb"/Width (\d+) /Height (\d+)", data).groups())
    bits = zlib.decompress(re.search(rb"/FlateDecode [^>]*>>\nstream\n(.*)\nendstream", data, re.DOTALL)[1])
    assert len(bits) == rows * -(-columns // 8)
    start = int(re.search(rb"startxref\n(\d+)", data)[1])
    assert data[start : start + 4] == b"xref"
    with pytest.raises(OutputError, match=r"has to end in .png or .pdf"):
        write_board(A3, tmp_path / "board.svg")


def test_ros_camera_info():
    values = example_calibration()
    text = camera_info(Calibration.parse(values))
    assert "image_width: 64\nimage_height: 48" in text
    assert "distortion_model: plumb_bob" in text
    k = json.loads(re.search(r"camera_matrix:\n  rows: 3\n  cols: 3\n  data: (.*)", text)[1])
    assert k == np.ravel(values["camera"]["matrix"]).tolist()


def command(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_camera_show_and_check(tmp_path):
    pictures = write_pictures(tmp_path / "p")
    out, picture = tmp_path / "c.json", tmp_path / "c.png"
    done = command("camera", pictures, "--output", out, "--picture", picture)
    assert done.exit_code == 0, done.output
    assert "10 views" in done.output
    assert cv2.imread(str(picture)) is not None
    done = command("show", out, "--ros", tmp_path / "ros.yaml")
    assert re.search(r"fx +\d+\.\d+ \+- 0\.\d+ px", done.output)
    assert "camera_matrix" in (tmp_path / "ros.yaml").read_text()
    fresh = write_pictures(tmp_path / "fresh", 1, seed=9)
    assert "still good" in command("check", fresh, "--calibration", out).output
    for path in fresh.iterdir():  # another lens
        cv2.imwrite(str(path), cv2.undistort(cv2.imread(str(path)), MATRIX, np.array([0.3, 0, 0, 0])))
    done = command("check", fresh, "--calibration", out)
    assert done.exit_code == 1
    assert "calibrate again" in done.output


def test_measured_and_pairs(tmp_path):
    points, pixels, *_ = pairs(0.2)
    source = tmp_path / "pairs.csv"
    np.savetxt(source, np.c_[points, pixels], delimiter=",", header="x,y,z,u,v", comments="")
    out, both = tmp_path / "camera.json", tmp_path / "both.json"
    done = command("camera", source, "--pairs", "--size", 640, 480, "--output", out)
    assert done.exit_code == 0, done.output
    assert "alpha_u" in done.output and "t_z" in done.output
    done = command("laser", "--measured", -500, 0, 0, 10, "--calibration", out, "--output", both)
    assert done.exit_code == 0, done.output
    found = Calibration.load(both)
    assert found.camera.model == "projection"
    assert found.laser.zero_rad == pytest.approx(np.radians(10))
    np.testing.assert_allclose(found.laser.camera_from_laser[:3, 3], [-500, 0, 0])


def test_mistakes_at_the_command_line(tmp_path):
    for arguments in (
        ("joint", tmp_path, "--output", tmp_path / "c.json"),
        ("camera", tmp_path, "--output", tmp_path / "c.json"),
        ("show", tmp_path / "none.json"),
        ("camera", tmp_path, "--pairs", "--output", tmp_path / "c.json"),
    ):
        done = command(*arguments)
        assert done.exit_code == 1
        assert done.output.count("\n") == 1, done.output
        assert "Traceback" not in done.output
