"""Ways to get a calibration wrong, on the observation level: each ends in a sentence that names the cause."""

import json
from dataclasses import replace

import numpy as np
import pytest

from magtrak.calibrate import procedure, session
from magtrak.calibrate.board import A3
from magtrak.calibrate.drift import drift
from magtrak.calibrate.findings import KINDS, table
from magtrak.calibrate.linear import linear_camera
from magtrak.calibrate.observations import Lines, Observations, View
from magtrak.calibrate.session import Session
from magtrak.errors import CalibrationError
from tests.support.calibration_rig import Procedure, as_calibration, random_rig, rotation

SEED = 5
PLAN = Procedure(views=12)


@pytest.fixture(scope="module")
def rig():
    return random_rig(np.random.default_rng(SEED))


@pytest.fixture(scope="module")
def good(rig):
    return PLAN.observe(rig, np.random.default_rng(SEED)).thinned(10)


@pytest.fixture(scope="module")
def known(good):
    return procedure.calibrate_joint(Session(good, []))


def changed(seen: Observations, change) -> Observations:
    return replace(seen, views=[change(number, view) for number, view in enumerate(seen.views)])


def with_lines(view: View, **values) -> View:
    return replace(view, lines=replace(view.lines, **values))


def with_board(view: View, factor: float) -> View:
    board = view.board
    band = tuple(side * factor for side in board.band_mm)
    return replace(view, board=replace(board, square_mm=board.square_mm * factor, band_mm=band))


def other_plan(rig, **values) -> Observations:
    return replace(PLAN, **values).observe(rig, np.random.default_rng(SEED)).thinned(10)


def keys(seen: Observations, **options) -> list[str]:
    return [item.key for item in procedure.calibrate_joint(Session(seen, []), **options).findings]


def test_a_good_session_has_no_findings(known):
    assert known.findings == []


# Warnings of the joint calibration.


def test_moved_rig(good):
    assert "moved" in keys(changed(good, lambda n, v: with_lines(v, counts=v.lines.counts + 8 * (n >= 6))))


def test_slipping_encoder(good):
    assert "slipping" in keys(changed(good, lambda n, v: with_lines(v, counts=v.lines.counts + 0.4 * n)))


def test_board_moved_before_its_lines(good):
    seen = changed(good, lambda n, v: with_lines(v, column=v.lines.column + 4 * (n == 4)))
    assert "board-moved" in keys(seen)


def test_one_square_wrong(good):
    assert "square-size" in keys(changed(good, lambda n, v: with_board(v, 0.97 if v.board.name == "large" else 1.0)))


def test_both_squares_wrong(good):
    assert keys(changed(good, lambda n, v: with_board(v, 1.1)), measured_mm=500.0) == ["baseline"]


def test_loose_angles(good):
    rng = np.random.default_rng(1)
    assert "angles-noisy" in keys(
        changed(good, lambda n, v: with_lines(v, counts=v.lines.counts + rng.normal(0, 2, 3)[v.lines.image]))
    )


def test_one_way_and_noisy_lines(rig):
    found = keys(other_plan(rig, both_ways=False, line_px=0.7))
    assert "one-way" in found
    assert "lines-noisy" in found


def test_curved_line(good, rig):
    pose = np.asarray(rig.laser.camera_from_laser)

    def bend(_, view):
        # A sheet bent by 2 mm where the fan is 0.3 to the side, seen 0.5 m to the side at about 800 px.
        rays = rig.camera.rays(view.lines.column, view.lines.row)
        index = [v.name for v in good.views].index(view.name)
        turn, shift = PLAN_POSES(rig)[index]
        points = rays * ((turn[:, 2] @ shift) / (rays @ turn[:, 2]))[:, None]
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        fan = local[:, 2] / np.hypot(local[:, 0], local[:, 1])
        return with_lines(view, column=view.lines.column + 2 * (fan / 0.3) ** 2 * 800 / points[:, 2])

    assert "curved-line" in keys(changed(good, bend))


def PLAN_POSES(rig):
    plan = replace(PLAN)
    plan.observe(rig, np.random.default_rng(SEED))
    return plan.poses


# Refusals of the joint calibration.


def refusal(seen: Observations, **options) -> str:
    with pytest.raises(CalibrationError) as caught:
        procedure.calibrate_joint(Session(seen, []), **options)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_counts_per_turn(good):
    assert "8192 counts per turn, and the session says 2048" in refusal(replace(good, counts_per_turn=2048))


def test_counts_per_turn_of_a_similar_encoder(good):
    assert "counts per turn, and the session says 8000" in refusal(replace(good, counts_per_turn=8000))


def test_an_encoder_of_something_else(good):
    seen = changed(good, lambda n, v: with_lines(v, counts=np.random.default_rng(n).permutation(v.lines.counts)))
    assert "fit no plane that turns" in refusal(seen)


def test_a_frozen_encoder(good):
    seen = changed(good, lambda n, v: with_lines(v, counts=100 + 1e-3 * np.arange(len(v.lines))))
    assert "differ by 0.0 degrees" in refusal(seen)


def test_few_views(good):
    assert "5 views of the board are usable, and 8 are needed" in refusal(replace(good, views=good.views[:5]))


def test_metres(good):
    text = refusal(changed(good, lambda n, v: replace(v, board=replace(v.board, square_mm=0.04, marker_mm=0.03))))
    assert "would be" in text and "measure a square, in mm" in text


def test_no_tilt(rig):
    assert "tilted by less than" in refusal(other_plan(rig, tilt_rad=0.02))


def test_no_lines(good):
    assert "no laser lines" in refusal(changed(good, lambda n, v: replace(v, lines=Lines())))


def test_few_lines(good):
    assert "only 6 laser images" in refusal(changed(good, lambda n, v: v if n < 2 else replace(v, lines=Lines())))


def test_no_band(good):
    seen = changed(good, lambda n, v: replace(v, board=replace(v.board, band_mm=None)))
    assert "has no blank band" in refusal(seen)


def test_shallow(rig):
    plan = {"distances_mm": ((900.0, 905.0), (900.0, 905.0)), "boards": (A3, A3), "tilt_rad": 0.18}
    assert "mm only" in refusal(other_plan(rig, **plan))


def test_a_wall(good):
    # Lines on one view only: a board that stood in one plane is a wall.
    seen = changed(good, lambda n, v: v if n == 1 else replace(v, lines=Lines()))
    wall = seen.views[1]
    many = np.concatenate([wall.lines.image + 3 * part for part in range(3)])
    lines = Lines(many, *(np.tile(getattr(wall.lines, name), 3) for name in ("row", "column", "counts", "rate")))
    views = [replace(view, lines=lines) if number == 1 else view for number, view in enumerate(seen.views)]
    assert "a wall looks flat with any laser calibration" in refusal(replace(seen, views=views))


# Warnings of the camera.


def camera_keys(seen: Observations) -> list[str]:
    return [item.key for item in procedure.calibrate_camera(Session(seen, [])).findings]


def bare(seen: Observations) -> Observations:
    return changed(seen, lambda n, v: replace(v, lines=Lines()))


def moved_corners(seen: Observations, shift) -> Observations:
    return changed(bare(seen), lambda n, v: replace(v, corners=v.corners + shift(n, v)))


def test_bad_view(good):
    rng = np.random.default_rng(1)
    seen = moved_corners(good, lambda n, v: rng.normal(0, 0.8, v.corners.shape) * (n == 4))
    assert "bad-view" in camera_keys(seen)


def test_noisy_corners(good):
    rng = np.random.default_rng(1)
    assert "corners-noisy" in camera_keys(moved_corners(good, lambda n, v: rng.normal(0, 0.7, v.corners.shape)))


def test_refocused(good):
    middle = np.array([319.5, 239.5])
    seen = moved_corners(good, lambda n, v: 0.01 * (v.corners - middle) * (n >= 6))
    assert "refocused" in camera_keys(seen)


def reshaped(good, rig, shape) -> Observations:
    """Corners of boards that are not what they are said to be: ``shape`` takes (N, 2) mm to (N, 3) mm."""
    poses = PLAN_POSES(rig)
    rng = np.random.default_rng(3)

    def change(number, view):
        turn, shift = poses[number]
        points = shape(view.board.points(view.ids), view.board) @ turn.T + shift
        return replace(view, corners=rig.camera.project(points) + rng.normal(0, 0.05, view.corners.shape))

    return changed(bare(good), change)


def test_bent_board(good, rig):
    def bend(xy, board):
        return np.c_[xy, 1.5 * (2 * xy[:, 0] / board.size_mm[0] - 1) ** 2]

    assert "bent" in camera_keys(reshaped(good, rig, bend))


def test_stretched_print(good, rig):
    seen = reshaped(good, rig, lambda xy, board: np.c_[xy * [1.004, 1.0], np.zeros(len(xy))])
    assert "stretched" in camera_keys(seen)


def test_uncovered_corner(good):
    def without(number, view):
        keep = (view.corners[:, 0] > 250) | (view.corners[:, 1] > 200)
        return replace(view, ids=view.ids[keep], corners=view.corners[keep])

    seen = changed(bare(good), without)
    assert "uncovered" in camera_keys(replace(seen, views=[view for view in seen.views if len(view.ids) > 8]))


# Sessions on disk.


def write_session(folder, seen: Observations, flags="", frames=None):
    views, rows = [], []
    for number, view in enumerate(seen.views):
        np.savetxt(folder / f"{number}.csv", np.c_[view.ids, view.corners], "%.4f", delimiter=",", header="id,u,v")
        lines = view.lines
        first = 10 * number
        for i in range(len(lines)):
            rows.append(
                (first + lines.image[i], lines.row[i], lines.column[i], lines.counts[i], lines.rate[i], 200, 7, flags)
            )
        mine = sorted({int(first + image) for image in lines.image})
        views.append({"board": view.board.name, "corners": f"{number}.csv", "frames": frames or mine})
    boards = {board.name: board.as_dict() for board in seen.boards}
    values = {"width": seen.width, "height": seen.height, "counts_per_turn": 8192, "boards": boards, "views": views}
    (folder / "session.json").write_text(json.dumps(values))
    session.write_lines(folder / "lines.csv", rows)
    return folder


def test_a_session_comes_back(tmp_path, good):
    taken = session.load(write_session(tmp_path, good))
    assert not taken.findings
    assert len(taken.seen.views) == len(good.views)
    for found, view in zip(taken.seen.views, good.views, strict=True):
        np.testing.assert_allclose(found.corners, view.corners, atol=1e-4)
        np.testing.assert_allclose(found.lines.counts, view.lines.counts)
        assert found.board == view.board


@pytest.mark.parametrize(("flags", "key"), [("s", "saturated"), ("a", "ambiguous"), ("t", "standing")])
def test_flagged_rows(tmp_path, good, flags, key):
    taken = session.load(write_session(tmp_path, good, flags))
    assert [item.key for item in taken.findings] == [key]
    assert taken.seen.images == (good.images if flags == "s" else 0)


def test_lost_frames(tmp_path, good):
    with pytest.raises(CalibrationError, match=r"wants frame 777 of the laser's lines"):
        session.load(write_session(tmp_path, good, frames=[777]))


def test_lines_off_the_band(good):
    shifted = changed(good, lambda n, v: with_lines(v, row=v.lines.row - 150) if n == 2 else v)
    camera = procedure.estimate_camera(bare(good))
    seen, findings = session.on_bands(shifted, camera.rig)
    assert [item.key for item in findings] == ["off-band"]
    assert len(seen.views[2].lines) == 0
    assert len(seen.views[3].lines) > 0.3 * len(good.views[3].lines)


# After the calibration.


def test_swapped_encoder(good, known):
    seen = changed(good, lambda n, v: with_lines(v, counts=-v.lines.counts, rate=-v.lines.rate))
    assert "swapped" in keys(seen, previous=known.calibration)


def test_drift(good, rig, known):
    fresh = replace(PLAN, views=2).observe(rig, np.random.default_rng(77))
    still = drift(Session(fresh, []), known.calibration)
    assert still.findings == []
    turned = changed(fresh, lambda n, v: with_lines(v, counts=v.lines.counts + 4))
    found = drift(Session(turned, []), known.calibration)
    assert [item.key for item in found.findings] == ["drift"]
    expected = -known.calibration.laser.sense * 4 * 2 * np.pi / 8192
    assert found.zero_rad == pytest.approx(expected, rel=0.1)
    zoomed = changed(fresh, lambda n, v: replace(v, corners=v.corners + 0.2 * np.sin(40 * v.corners) * 5))
    assert [item.key for item in drift(Session(zoomed, []), known.calibration).findings][:1] == ["drift"]


def one_view(rig, turn: np.ndarray, factor: tuple[float, float] = (1.0, 1.0)) -> Observations:
    """A picture of the small board at 0.7 m, scaled about its middle, without lines."""
    shift = np.array([0.0, 0.0, 700.0]) - rotation(turn) @ [180.0, 120.0, 0.0]
    ids = np.arange(A3.corners)
    points = np.c_[A3.points(ids), np.zeros(len(ids))] @ rotation(turn).T + shift
    middle = np.asarray(rig.camera.matrix)[:2, 2]
    corners = (rig.camera.project(points) - middle) * factor + middle
    corners += np.random.default_rng(3).normal(0, 0.05, corners.shape)
    return Observations(640, 480, [View("one", A3, ids, corners)])


STEEP, FACING = np.array([0.3, 0.5, 0.0]), np.array([0.02, 0.01, 0.0])


def test_one_picture_tells_a_stretch_and_a_zoom_if_tilted(rig, known):
    def asked(turn, factor):
        return drift(Session(one_view(rig, turn, factor), []), known.calibration)

    for turn in (STEEP, FACING):
        assert asked(turn, (1.0, 1.0)).findings == []
        found = asked(turn, (1.01, 1.0))
        assert found.stretch == pytest.approx(0.01, abs=0.003)
        assert "it is stretched by +" in str(found.findings[0])
        assert len(found.findings) == 1
    found = asked(STEEP, (1.02, 1.02))
    assert found.focal == pytest.approx(0.02, abs=4 * found.focal_sigma)
    assert "the focal length differs by +" in str(found.findings[0])
    # Facing the camera, a scaled picture is a nearer board; the sigma says that nothing is known of it.
    found = asked(FACING, (1.02, 1.02))
    assert found.findings == []
    assert found.focal_sigma > 0.005


def test_a_board_of_another_size_is_told_by_its_lines(rig, known):
    fresh = replace(PLAN, views=4).observe(rig, np.random.default_rng(78))
    small = changed(fresh, lambda n, v: with_board(v, 0.98))
    found = drift(Session(small, []), known.calibration)
    assert found.corner_px < 0.1
    assert abs(found.line_px) > 0.3
    assert [item.key for item in found.findings] == ["drift"]
    assert drift(Session(bare(small), []), known.calibration).findings == []  # no picture can


def test_zero_only_takes_a_wall(good, rig, known):
    """A later session on one board pose, the laser's zero having moved by 5 counts."""
    one = replace(good, views=[with_lines(good.views[1], counts=good.views[1].lines.counts + 5)])
    result = procedure.calibrate_laser(Session(one, []), known.calibration, zero_only=True)
    moved = result.calibration.laser.zero_rad - known.calibration.laser.zero_rad
    assert moved == pytest.approx(-known.calibration.laser.sense * 5 * 2 * np.pi / 8192, rel=0.02)
    with pytest.raises(CalibrationError, match=r"laser images|wall"):
        procedure.calibrate_laser(Session(one, []), known.calibration)


def test_linear_model_refuses():
    with pytest.raises(CalibrationError, match="5 pairs of points are given"):
        linear_camera(np.zeros((5, 3)), np.zeros((5, 2)))
    flat = np.random.default_rng(1).uniform(0, 100, (20, 3)) * [1, 1, 0]
    with pytest.raises(CalibrationError, match="all points lie in one plane"):
        linear_camera(flat, flat[:, :2])


def test_the_table_is_in_the_documentation():
    from pathlib import Path

    text = (Path(__file__).parents[2] / "docs" / "calibration.md").read_text()
    assert table() in text
    assert len(KINDS) >= 30


def test_accuracy_of_a_file(rig, good, known):
    """The small session is as good as it says."""
    from tests.support.calibration_rig import plane_error

    error = plane_error(rig, as_calibration(known.solution), 2000.0)
    expected = next(item for item in known.calibration.extra["expected"] if item["distance_mm"] == 2000.0)
    assert error.form < 1.5 * expected["form_mm"]
    assert error.place < 1.5 * expected["place_mm"]
