"""Boards, their photographs and calibration sessions, against OpenCV's detector and against geometry done here."""

import json
from dataclasses import replace
from math import sqrt

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from sim.blur import smear
from sim.boards import A3, BOARDS, INK, LARGE, Board
from sim.errors import SimError
from sim.parts import Object, pose_of
from sim.photo import photo
from sim.scene import Scene
from sim.session import EXPOSURE_S, main, timing_of, views
from sim.surfaces import Plane
from tests.sim.rig import at, rig
from tests.support.scenes import small

CHESS = Board("chessboard", 4, 3, 10.0, margins_mm=(2.0, 3.0, 2.0, 20.0))


def test_print_by_hand() -> None:
    panel = CHESS.panel(at(5, 6, 700))
    points = np.array([[1.0, 1, 0], [11, 1, 0], [11, 11, 0], [39, 29, 0], [-1, 5, 0], [20, 31, 0], [20, 49, 0]])
    white = CHESS.white(panel, points + np.array([5, 6, 700]))
    assert white.tolist() == [INK, 1, INK, 1, 1, 1, 1]
    assert CHESS.band_mm == (-2, 30, 42, 50)
    assert CHESS.size_mm == (44, 53)
    assert np.allclose(CHESS.pose(panel), at(5, 6, 700))
    assert CHESS.corners().tolist()[:2] == [[10, 10, 0], [20, 10, 0]]
    mirrored = replace(CHESS, mirrored=True)
    assert mirrored.white(panel, points[:2] + np.array([5, 6, 700])).tolist() == [1, INK]


def test_panel_reaches_as_far_as_its_margins() -> None:
    panel = CHESS.panel(at(0, 0, 100))
    rays = np.array([[-1.9, -2.9, 100], [41.9, 49.9, 100], [-2.1, 0, 100], [0, 50.1, 100]])
    assert np.isfinite(panel.intersect((0, 0, 0), rays).t).tolist() == [True, True, False, False]


def test_smear_keeps_the_light_and_has_the_width() -> None:
    picture = np.zeros((1, 61, 1))
    picture[0, 30] = 1
    out = smear(picture, 1.7, 1)[0, :, 0]
    assert out.sum() == pytest.approx(1)
    assert sqrt((out * (np.arange(61) - 30) ** 2).sum()) == pytest.approx(1.7, rel=2e-3)
    assert smear(np.ones((5, 5)), 2.0, 0) == pytest.approx(np.ones((5, 5)))


@pytest.mark.parametrize("sigma", [0.0, 2.4])
def test_smear_by_steps_is_the_mean_of_the_smeared(sigma: float) -> None:
    picture = np.random.default_rng(3).random((12, 20, 3))
    for axis, shape in ((0, (3, 4, 20, 3)), (1, (12, 5, 4, 3))):
        assert smear(picture, sigma, axis, 4) == pytest.approx(
            smear(picture, sigma, axis).reshape(shape).mean(axis + 1)
        )


@pytest.mark.parametrize("name", BOARDS)
def test_opencv_finds_the_corners_where_they_are(name: str) -> None:
    board = BOARDS[name]
    scene = small(Scene.load("rig"))
    distance = 9.5 * board.columns / 9 * board.square_mm * 1.3
    pose = pose_of((-4 * board.square_mm, -3.2 * board.square_mm, distance), np.array([0.35, -0.3, 0.1]))
    scene = replace(scene, objects=(Object(board.panel(pose), (0.9,) * 3, board), *scene.objects))
    grey = cv2.cvtColor(photo(scene, 3, (220.0, 220.0, 220.0)), cv2.COLOR_RGB2GRAY)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    printed = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_mm, board.marker_mm, dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(printed).detectBoard(grey)
    assert ids is not None
    assert len(ids) > 30
    found = board.corners()[ids.ravel()] @ pose[:3, :3].T + pose[:3, 3]
    error = corners.reshape(-1, 2) - scene.camera.project(found)
    print(f"{name}: {len(ids)} corners, RMS {np.sqrt(np.mean(error**2)):.3f} px")
    assert np.sqrt(np.mean(error**2)) < 0.12
    assert np.abs(error.mean(axis=0)).max() < 0.05


def test_photo_of_a_plain_wall_is_the_wall() -> None:
    wall = rig([Plane(pose=at(0, 0, 2000))], noise=0.0, ambient=100.0)
    assert np.all(photo(wall) == 100)
    noisy = photo(replace(wall, camera=replace(wall.camera, noise=2.0, gain=1.5)), 4).astype(float)
    assert (noisy.mean(), noisy.std()) == (pytest.approx(150, abs=0.1), pytest.approx(2, rel=0.05))
    assert not np.array_equal(photo(replace(wall, camera=replace(wall.camera, noise=2.0)), 5), noisy)


def test_blur_widens_an_edge() -> None:
    """Half a wall, dark beside it: the second moment of the edge's derivative is that of the blur and of the pixel."""
    scene = rig([Plane((800, 8000), at(400, 0, 2000))], ambient=200.0)
    for blur in (0.0, 1.5):
        row = photo(replace(scene, camera=replace(scene.camera, blur_px=blur)))[12].mean(axis=1)
        rise = np.diff(row) / 200
        middle = (rise * np.arange(len(rise))).sum()
        spread = (rise * (np.arange(len(rise)) - middle) ** 2).sum()
        assert spread == pytest.approx(blur**2 + 1 / 4, abs=0.15)


def test_the_line_of_a_session_lies_where_the_plane_meets_the_band() -> None:
    """The middle of the light in each row of the band, as a ray on the board's true plane, against the motor."""
    scene = small(Scene.load("rig"))
    quiet = replace(scene, camera=replace(scene.camera, noise=0.0), laser=replace(scene.laser, speckle=0.0))
    timing = timing_of(quiet)
    errors, steps = [], []
    for view in views(quiet, ["a3", "large"], 3, seed=2):
        board, frames = BOARDS[view.board], view.frames.astype(float)[..., 1]
        assert max(frames[0].max(), frames[-1].max()) < 30, "the first and the last picture are dark"
        steps.append(np.diff(view.angles_rad[:, 0]))
        assert np.ptp(steps[-1]) < 1e-12
        for picture, (start, end) in zip(frames[1:-1], view.angles_rad[1:-1], strict=True):
            light = np.maximum(picture - 30, 0)
            rows = np.flatnonzero(light.max(axis=1) > 60)
            columns = (light @ np.arange(320.0))[rows] / light.sum(axis=1)[rows]
            rays = quiet.camera.rays(columns, rows)
            normal = view.pose[:3, 2]
            points = rays * (normal @ view.pose[:3, 3] / (rays @ normal))[:, None]
            on_board = (points - view.pose[:3, 3]) @ view.pose[:3, :3]
            x0, y0, x1, y1 = board.band_mm
            inside = (on_board[:, 0] > x0 + 20) & (on_board[:, 0] < x1 - 20)
            inside &= (on_board[:, 1] > y0 + 8) & (on_board[:, 1] < y1 - 8)
            assert inside.sum() > 3, "the line has to cross the band"
            alpha, _ = quiet.laser.meets(quiet.laser.points(points[inside]))
            # Row r gathers its light around its arrival less the delay and half the exposure.
            speed = (end - start) / ((timing.height - 1) * timing.row_period_s)
            motor = start + speed * (rows[inside] * timing.row_period_s - quiet.timing.readout_delay_s - EXPOSURE_S / 2)
            errors += (alpha - quiet.laser.alpha(motor)).tolist()
    assert len(errors) > 40
    print(f"angle of the line: mean {np.mean(errors):.2e}, RMS {np.std(errors):.2e} rad over {len(errors)} rows")
    assert np.abs(np.mean(errors)) < 1e-4
    assert np.std(errors) < 5e-4
    assert steps[0][0] * steps[1][0] < 0, "forward and backward"


def test_session_command(tmp_path) -> None:
    text = 'like = "quick"\n[[object]]\nshape = "plane"\nposition_mm = [0, 0, 4000]\nalbedo = [0.5, 0.5, 0.5]\n'
    (tmp_path / "tiny.toml").write_text(text)
    out = tmp_path / "new" / "session"
    options = [str(out), "--scene", str(tmp_path / "tiny.toml"), "--board", "a3", "--views", "2", "--frames", "2"]
    done = CliRunner().invoke(main, options)
    assert done.exit_code == 0, done.output
    known = json.loads((out / "session.json").read_text())
    assert [view["frames"] for view in known["views"]] == [[1, 2], [5, 6]]
    assert known["boards"]["a3"]["band_mm"] == list(A3.band_mm)
    assert len(list((out / "laser").iterdir())) == 8
    assert (out / "angles.csv").read_text().count("\n") == 9
    truth = json.loads((out / "truth" / "truth.json").read_text())
    assert len(truth["poses"]) == 2
    assert truth["calibration"]["camera"]["time_offset_s"] == -(EXPOSURE_S / 2 + 0.5e-3)
    hidden = json.dumps(known)
    assert "pose" not in hidden
    assert "zero" not in hidden


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"marker_mm": 41.0}, "markers of 41 mm don't fit into squares of 40 mm"),
        ({"pattern": "dots"}, "a board's pattern is charuco or chessboard, not dots"),
        ({"dictionary": "DICT_9X9"}, "OpenCV has no dictionary of markers called DICT_9X9"),
        ({"first_marker": 90}, "DICT_5X5_100 has 100 markers, and this board needs 117"),
    ],
)
def test_boards_that_cannot_be_printed(change: dict, message: str) -> None:
    with pytest.raises(SimError, match=message):
        _ = replace(A3, **change).print


def test_board_in_a_scene_file(tmp_path) -> None:
    path = tmp_path / "scene.toml"
    board = '[[object]]\nshape = "board"\npattern = "charuco"\ncolumns = 9\nrows = 6\nsquare_mm = 95\n'
    board += "margins_mm = [60, 20, 60, 150]\nposition_mm = [0, 0, 2000]\nalbedo = [0.9, 0.9, 0.9]\n"
    path.write_text(f'like = "quick"\n{board}')
    (item,) = Scene.load(path).objects
    assert item.board == LARGE
    path.write_text(f'like = "quick"\n{board}mirrored = 1\n')
    with pytest.raises(SimError, match="mirrored has to be true or false, not 1"):
        Scene.load(path)
    path.write_text('like = "nowhere"\n')
    with pytest.raises(SimError, match="there is no scene called nowhere"):
        Scene.load(path)
