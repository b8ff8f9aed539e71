"""A real hand-held scan of a board: pose by ChArUco, one laser plane for all frames.

Camera and laser are fixed to each other, so that every point of the line on the board lies in one plane of the
camera's frame. The line crosses print, which bends it: used are rows where the print is of one colour for 9 px to both
sides, as on the blank band of a calibration board.
"""

import json

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from magtrak.calibrate.board import Board
from magtrak.calibrate.detect import charuco, detect
from magtrak.reference.gate import luts_from_words
from magtrak.reference.rows import measure
from magtrak.settings_file import load_settings
from tests.support.pictures import folder

EVERY = 2  # frames; half of them are plenty
MIN_CORNERS = 12
BLUR_PX = 0.6  # RMS of the corners about the best pose; beyond, the hand moved
PRINT_PX_MM = 8
GROSS_MM = 1.0


@pytest.fixture(scope="module")
def points():
    """For each frame: (N, 3) mm, points of the line on the board; and which of them lie on print of one colour."""
    place = folder("board_video")
    known = json.loads((place / "camera.json").read_text())
    matrix = np.array(known["camera_matrix"], dtype=float)
    b = known["board"]
    board = Board(
        "video",
        "charuco",
        b["columns"],
        b["rows"],
        b["square_mm"],
        b["marker_mm"],
        b["dictionary"],
        b["legacy_pattern"],
    )
    size = (round(side * PRINT_PX_MM) for side in board.size_mm)
    printed = charuco(board).generateImage(tuple(size), marginSize=0)
    settings = load_settings("red")
    registers = {name: values[0] for name, values in settings.register_values(50e6)}
    luts = luts_from_words([words for _, words in settings.tables()])
    video = cv2.VideoCapture(str(next(place.glob("*.avi"))))
    found = []
    number = 0
    while True:
        there, frame = video.read()
        if not there:
            break
        number += 1
        if number % EVERY:
            continue
        pose = board_pose(frame, board, matrix)
        if pose is not None:
            found.append(line_points(frame, matrix, pose, printed, registers, luts))
    return found


def board_pose(frame, board, matrix):
    """Rotation and translation from the green channel, where the red line hardly shows."""
    seen = detect(np.ascontiguousarray(frame[:, :, 1]), board, "frame")
    if len(seen.ids) < MIN_CORNERS:
        return None
    flat = np.c_[board.points(seen.ids), np.zeros(len(seen.ids))]
    done, turn, shift = cv2.solvePnP(flat, seen.corners, matrix, None)
    error = cv2.projectPoints(flat, turn, shift, matrix, None)[0].reshape(-1, 2) - seen.corners
    if not done or np.sqrt(np.mean(error**2)) > BLUR_PX:
        return None
    return cv2.Rodrigues(turn)[0], shift.ravel()


def line_points(frame, matrix, pose, printed, registers, luts):
    turn, shift = pose
    rows = measure(np.ascontiguousarray(frame[:, :, ::-1]), registers, luts)
    good = (rows["valid"] == 1) & (rows["ambiguous"] == 0) & (rows["cut"] == 0)
    row, column = np.flatnonzero(good), rows["position"][good] / 256

    def on_board(u, v):
        rays = np.c_[(u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1], np.ones(len(u))]
        seen = rays * ((turn[:, 2] @ shift) / (rays @ turn[:, 2]))[:, None]
        return seen, ((seen - shift) @ turn)[:, :2]

    levels = []
    for across in (-9, -6, -3, 0, 3, 6, 9):
        for down in (-1.5, 0, 1.5):
            _, at = on_board(column + across, row + down)
            x, y = np.floor(at * PRINT_PX_MM).astype(int).T
            inside = (x >= 0) & (x < printed.shape[1]) & (y >= 0) & (y < printed.shape[0])
            levels.append(np.where(inside, printed[np.where(inside, y, 0), np.where(inside, x, 0)], -1))
    on = (np.array(levels) >= 0).all(axis=0)
    return on_board(column, row)[0][on], (np.ptp(levels, axis=0) == 0)[on]


def plane_distances(points):
    """Signed distances from the plane that fits best, large ones weighing less."""
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    start = normal / (normal @ middle)
    fit = least_squares(
        lambda p: (points @ p - 1) / np.linalg.norm(p), start, loss="soft_l1", f_scale=0.2, x_scale=np.abs(start) + 1e-4
    )
    return (points @ fit.x - 1) / np.linalg.norm(fit.x)


def test_one_plane_fits_all_frames(points):
    blank = np.concatenate([found[even] for found, even in points])
    every = np.concatenate([found for found, _ in points])
    d, all_d = plane_distances(blank), plane_distances(every)
    inner = np.abs(d) < GROSS_MM
    rms = float(np.sqrt(np.mean(d[inner] ** 2)))
    print(
        f"{len(points)} frames, {len(d)} points: {rms:.3f} mm RMS, {100 * np.mean(~inner):.1f} % beyond {GROSS_MM} mm;"
        f" with all of them {np.sqrt(np.mean(d**2)):.3f} mm; over the print's edges {np.sqrt(np.mean(all_d**2)):.2f} mm"
    )
    assert len(points) >= 40
    assert len(d) >= 600
    assert np.mean(~inner) < 0.08
    assert rms <= 0.35
