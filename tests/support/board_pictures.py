"""Quick pictures of a board, warped by OpenCV: for what tools say of pictures, not for accuracy."""

from pathlib import Path

import cv2
import numpy as np

from magtrak.calibrate.board import A3, Board
from magtrak.calibrate.detect import charuco
from tests.support.calibration_rig import rotation

SIZE = (640, 480)
MATRIX = np.array([[800.0, 0, 319.5], [0, 800.0, 239.5], [0, 0, 1]])
FINE = 3


def picture(
    board: Board = A3,
    turn: tuple[float, float, float] = (0.3, -0.2, 0.05),
    at: tuple[float, float, float] = (-150.0, -110.0, 700.0),
    *,
    black: float = 20.0,
    white: float = 210.0,
    blur_px: float = 0.5,
    noise: float = 1.0,
    seed: int = 0,
) -> np.ndarray:
    """(480, 640) uint8: a board whose upper left corner stands at ``at``, turned by ``turn`` (rad)."""
    scale = 4.0
    width, height = (round(size * scale) for size in board.size_mm)
    if board.pattern == "charuco":
        pattern = charuco(board).generateImage((width, height), marginSize=0)
    else:
        row, column = np.indices((board.rows, board.columns))
        side = round(board.square_mm * scale)
        pattern = (np.kron((row + column) % 2, np.ones((side, side))) * 255).astype(np.uint8)
    border = round(30 * scale)
    sheet = cv2.copyMakeBorder(pattern, border, border, border, border, cv2.BORDER_CONSTANT, value=255)
    r = rotation(np.array(turn))
    to_camera = MATRIX @ np.c_[r[:, 0], r[:, 1], np.array(at)]
    to_board = np.array([[1 / scale, 0, (0.5 - border) / scale], [0, 1 / scale, (0.5 - border) / scale], [0, 0, 1]])
    fine = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1]])
    size = (SIZE[0] * FINE, SIZE[1] * FINE)
    seen = cv2.warpPerspective(sheet, fine @ to_camera @ to_board, size, flags=cv2.INTER_AREA, borderValue=128)
    small = cv2.resize(seen, SIZE, interpolation=cv2.INTER_AREA).astype(float)
    if blur_px:
        small = cv2.GaussianBlur(small, (0, 0), blur_px)
    result = black + (white - black) * small / 255
    result = result + np.random.default_rng(seed).normal(0, noise, result.shape)
    return np.clip(np.round(result), 0, 255).astype(np.uint8)


def write_pictures(folder: Path, count: int = 10, board: Board = A3, seed: int = 0, **options: float) -> Path:
    """``count`` pictures of a board in all parts of the picture, tilted all ways."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    for number in range(count):
        z = rng.uniform(500, 800)
        u, v = [(120, 110), (500, 110), (120, 370), (500, 370), (320, 240)][number % 5]
        middle = np.linalg.inv(MATRIX) @ [u, v, 1] * z
        turn = np.array([*rng.uniform(-0.5, 0.5, 2), rng.normal(0, 0.1)])
        width, height = board.size_mm
        at = middle - rotation(turn) @ [width / 2, height / 2, 0]
        made = picture(board, tuple(turn), tuple(at), seed=number, **options)
        cv2.imwrite(str(folder / f"{number:02}.png"), made)
    return folder
