"""What the camera calibration says of pictures: each mistake ends in a sentence that names it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from magtrak.calibrate import procedure, session
from magtrak.calibrate.board import A3, Board
from magtrak.calibrate.detect import detect
from magtrak.errors import CalibrationError
from tests.support.board_pictures import MATRIX, picture, write_pictures
from tests.support.calibration_rig import rotation

CHESS = Board("chess", "chessboard", 9, 6, 40.0)
TURN, AT = (0.3, -0.2, 0.05), (-150.0, -110.0, 700.0)


def projected(board: Board, ids: np.ndarray) -> np.ndarray:
    flat = np.c_[board.points(ids), np.zeros(len(ids))]
    seen = (flat @ rotation(np.array(TURN)).T + AT) @ MATRIX.T
    return seen[:, :2] / seen[:, 2:]


@pytest.mark.parametrize("board", [A3, CHESS, replace(A3, rows=7, legacy=True, name="old")], ids=lambda b: b.name)
def test_corners_are_found_where_they_are(board):
    found = detect(picture(board), board, "p.png")
    assert len(found.ids) == board.corners
    error = found.corners - projected(board, found.ids)
    assert np.sqrt(np.mean(error**2)) < 0.08
    assert not found.findings


def test_a_chessboard_upside_down_keeps_its_first_corner():
    upside_down = np.ascontiguousarray(picture(CHESS)[::-1, ::-1])
    found = detect(upside_down, CHESS, "p.png")
    error = np.array([639, 479]) - found.corners - projected(CHESS, found.ids)
    assert np.sqrt(np.mean(error**2)) < 0.08


def sentence(board, made):
    found = detect(made, board, "p.png")
    assert found.findings
    return found.findings[0].key


@pytest.mark.parametrize(
    ("key", "make"),
    [
        ("mirrored", lambda: (A3, np.ascontiguousarray(picture()[:, ::-1]))),
        ("other-board", lambda: (A3, picture(replace(A3, first_marker=40)))),
        ("other-dictionary", lambda: (A3, picture(replace(A3, dictionary="DICT_4X4_250")))),
        ("other-layout", lambda: (replace(A3, columns=6, rows=9), picture())),
        ("no-board", lambda: (A3, np.random.default_rng(1).integers(0, 255, (480, 640)).astype(np.uint8))),
        ("few-corners", lambda: (A3, picture(at=(170.0, 95.0, 700.0)))),
        ("blurred", lambda: (A3, picture(blur_px=1.9))),
        ("blurred-lost", lambda: (A3, picture(blur_px=6.0))),
        ("dark", lambda: (A3, picture(black=10.0, white=38.0, noise=0.5))),
        ("over-exposed", lambda: (A3, picture(white=420.0))),
    ],
)
def test_a_poor_picture_says_why(key, make):
    board, made = make()
    assert sentence(board, made) == key


def test_camera_from_pictures(tmp_path):
    result = procedure.calibrate_camera(session.of_pictures(write_pictures(tmp_path / "p"), A3))
    camera = result.calibration.camera
    sigma = result.calibration.extra["sigmas"]["camera"]
    for at, name in (((0, 0), "fx"), ((1, 1), "fy"), ((0, 2), "cx"), ((1, 2), "cy")):
        assert abs(camera.matrix[at] - MATRIX[at]) < max(4 * sigma[name], 0.3), name
    assert not result.findings
    assert camera.distortion[4] == 0  # k3 is not asked for


def test_a_folder_without_pictures(tmp_path):
    with pytest.raises(CalibrationError, match="there is no picture in"):
        session.of_pictures(tmp_path, A3)


def test_pictures_of_two_sizes(tmp_path):
    write_pictures(tmp_path, 2)
    cv2.imwrite(str(tmp_path / "99.png"), np.zeros((100, 100), np.uint8))
    with pytest.raises(CalibrationError, match=r"99.png is 100 x 100 px"):
        session.of_pictures(tmp_path, A3)


def test_one_picture_twice(tmp_path):
    write_pictures(tmp_path, 2)
    (tmp_path / "99.png").write_bytes((tmp_path / "00.png").read_bytes())
    taken = session.of_pictures(tmp_path, A3)
    assert [item.key for item in taken.findings] == ["twice"]
    assert len(taken.seen.views) == 2


def test_a_wrong_board_is_refused_at_once(tmp_path):
    write_pictures(tmp_path, 2, replace(A3, first_marker=40))
    with pytest.raises(CalibrationError, match=r"markers 4[0-9] to"):
        session.of_pictures(tmp_path, A3)
