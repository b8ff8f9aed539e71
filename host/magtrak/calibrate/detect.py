"""Finds a board in a picture, or says why it is not there."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Floats, Integers
from ..errors import CalibrationError
from .board import Board
from .corner import fit_corners
from .findings import Finding, finding

MIN_CORNERS = 8
BLURRED_PX = 3.4
"""An edge that takes so many px from black to white is blurred; a sharp one takes 2 to 3."""

LOST_PX = 8.0
"""Where no edge of the picture is narrower, no board can be found."""

DARK = 40.0
"""Grey levels between black and white squares."""

Picture = Any
"""(height, width) uint8."""


@dataclass(frozen=True)
class Detected:
    """What was found of a board.

    Attributes
    ----------
    ids, corners : (N,), (N, 2) px; empty where the board was not found
    findings : what is wrong with the picture, or why it was of no use
    """

    ids: Integers
    corners: Floats
    findings: list[Finding]


def read_picture(path: Path) -> Picture:
    """A picture in grey levels.

    Raises
    ------
    CalibrationError
        It cannot be read.
    """
    import cv2

    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise CalibrationError(f"picture {path} cannot be read: give PNG, JPEG or BMP files")
    return picture


def dictionary(name: str) -> Any:
    """OpenCV's dictionary of markers."""
    import cv2

    if not name.startswith("DICT_") or not hasattr(cv2.aruco, name):
        raise CalibrationError(f"OpenCV has no dictionary of markers called {name!r}; DICT_5X5_100 is one")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def charuco(board: Board) -> Any:
    """OpenCV's own description of a board."""
    import cv2

    markers = dictionary(board.dictionary)
    ids = np.arange(board.first_marker, board.first_marker + board.columns * board.rows // 2, dtype=np.int32)
    if ids[-1] >= len(markers.bytesList):
        raise CalibrationError(
            f"board {board.name} needs markers up to {ids[-1]}, and {board.dictionary} ends at"
            f" {len(markers.bytesList) - 1}: take a larger dictionary"
        )
    made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_mm, board.marker_mm, markers, ids)
    made.setLegacyPattern(board.legacy)
    return made


def detect(picture: Picture, board: Board, name: str) -> Detected:
    """The corners of a board in a picture; ``name`` of the picture, for messages."""
    ids, corners = _charuco(picture, board) if board.pattern == "charuco" else _chessboard(picture, board)
    if len(ids) < MIN_CORNERS:
        return Detected(np.zeros(0, np.int64), np.zeros((0, 2)), [_why(picture, board, name, len(ids))])
    return Detected(ids, corners, _quality(picture, board, ids, corners, name))


def _charuco(picture: Picture, board: Board) -> tuple[Integers, Floats]:
    import cv2

    detector = cv2.aruco.CharucoDetector(charuco(board))
    corners, ids, _, _ = detector.detectBoard(picture)
    if ids is None or len(ids) < 4:
        return np.zeros(0, np.int64), np.zeros((0, 2))
    return ids.ravel().astype(np.int64), _refine(picture, board, ids.ravel(), corners.reshape(-1, 2))


def _refine(picture: Picture, board: Board, ids: Integers, corners: Floats) -> Floats:
    """To a fraction of a pixel. The window stays clear of the markers: a quarter of a square at most."""
    import cv2

    half = int(np.clip(_square_px(board, ids, corners) * 0.18, 2, 9))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    start = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    about = cv2.cornerSubPix(picture, start, (half, half), (-1, -1), criteria).reshape(-1, 2).astype(np.float64)
    free = (1 - board.marker_mm / board.square_mm) / 2
    return fit_corners(picture, about, *_sides(board, ids, about), free)


def _sides(board: Board, ids: Integers, corners: Floats) -> tuple[Floats, Floats]:
    """(N, 2) px each: by how much a side of a square along the board's X, and one along its Y, runs at each corner."""
    import cv2

    printed = np.ascontiguousarray(board.points(ids)[:, :2], dtype=np.float64)
    matrix, _ = cv2.findHomography(printed, corners)
    if matrix is None:  # all corners in one row: none is fitted
        return np.zeros((len(ids), 2)), np.zeros((len(ids), 2))
    here = cv2.perspectiveTransform(printed[None], matrix)[0]
    steps = 0.01 * board.square_mm * np.eye(2)
    across, down = (100 * (cv2.perspectiveTransform((printed + step)[None], matrix)[0] - here) for step in steps)
    return across, down


def _square_px(board: Board, ids: Integers, corners: Floats) -> float:
    """Least side of a square, px: median distance of corners that are neighbours."""
    places = {int(number): corner for number, corner in zip(ids, corners, strict=True)}
    across = board.columns - 1
    sides = []
    for step, fits in ((1, lambda number: number % across != across - 1), (across, lambda number: True)):
        pairs = [
            np.linalg.norm(places[number + step] - places[number])
            for number in places
            if fits(number) and number + step in places
        ]
        if pairs:
            sides.append(float(np.median(pairs)))
    return min(sides, default=20.0)


def _chessboard(picture: Picture, board: Board) -> tuple[Integers, Floats]:
    import cv2

    size = (board.columns - 1, board.rows - 1)
    flags = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCornersSB(picture, size, flags)
    if not found:
        return np.zeros(0, np.int64), np.zeros((0, 2))
    grid = corners.reshape(board.rows - 1, board.columns - 1, 2).astype(np.float64)
    if _level(picture, grid, (-1, -1)) > _level(picture, grid, (1, 1)):
        grid = grid[::-1, ::-1]
    return np.arange(board.corners), grid.reshape(-1, 2)


def _level(picture: Picture, grid: Floats, end: tuple[int, int]) -> float:
    """Grey level in the middle of the square beyond the first (-1) or last (1) corner: the first square is black."""
    at = 0 if end[0] < 0 else -1
    inward = grid[1, 1] - grid[0, 0] if at == 0 else grid[-2, -2] - grid[-1, -1]
    x, y = grid[at, at] - inward / 2
    height, width = picture.shape
    return float(picture[int(np.clip(y, 0, height - 1)), int(np.clip(x, 0, width - 1))])


def _why(picture: Picture, board: Board, name: str, found: int) -> Finding:
    """Why a board was not found."""
    import cv2

    if found:
        return finding("few-corners", picture=name, corners=found, needed=MIN_CORNERS)
    if board.pattern == "charuco":
        if len(_charuco(np.ascontiguousarray(picture[:, ::-1]), board)[0]) >= MIN_CORNERS:
            return finding("mirrored", picture=name, board=board.name)
        known = range(board.first_marker, board.first_marker + board.columns * board.rows // 2)
        seen = _markers(picture, board.dictionary)
        if len(seen) >= 4 and not set(seen) <= set(known):
            return finding(
                "other-board",
                picture=name,
                least=min(seen),
                most=max(seen),
                board=board.name,
                first=known[0],
                last=known[-1],
            )
        if len(seen) >= 4:
            return finding(
                "other-layout",
                picture=name,
                markers=len(seen),
                board=board.name,
                columns=board.columns,
                rows=board.rows,
            )
        for other in ("DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_36h11"):
            if len(_markers(picture, other)) >= 4:
                return finding(
                    "other-dictionary", picture=name, seen=other, board=board.name, dictionary=board.dictionary
                )
    if float(np.percentile(picture, 95)) - float(np.percentile(picture, 5)) < DARK:
        return finding("dark", picture=name, levels=float(np.percentile(picture, 95) - np.percentile(picture, 5)))
    smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.5)
    down, across = np.gradient(smooth)
    steep = float(np.percentile(np.hypot(down, across), 99.7))
    if float(np.ptp(np.percentile(smooth, [2, 98]))) > LOST_PX * steep:
        return finding("blurred-lost", picture=name)
    return finding("no-board", picture=name, board=board.name)


def _markers(picture: Picture, name: str) -> list[int]:
    import cv2

    _, ids, _ = cv2.aruco.ArucoDetector(dictionary(name)).detectMarkers(picture)
    return [] if ids is None else [int(number) for number in ids.ravel()]


def _quality(picture: Picture, board: Board, ids: Integers, corners: Floats, name: str) -> list[Finding]:
    """Blur, darkness, over-exposure around the corners."""
    found: list[Finding] = []
    half = int(np.clip(_square_px(board, ids, corners) * 0.35, 4, 12))
    height, width = picture.shape
    edges, contrasts, full = [], [], []
    for x, y in np.round(corners).astype(int):
        if half <= x < width - half and half <= y < height - half:
            patch = picture[y - half : y + half + 1, x - half : x + half + 1].astype(np.float64)
            contrast = float(np.percentile(patch, 90) - np.percentile(patch, 10))
            # The steepest edge of the patch; noise makes single differences large, so two pixels apart.
            steep = max(np.abs(patch[:, 2:] - patch[:, :-2]).max(), np.abs(patch[2:] - patch[:-2]).max()) / 2
            edges.append(contrast / max(float(steep), 1e-6))
            contrasts.append(contrast)
            full.append(float((patch >= 254).mean()))
    if not edges:
        return found
    if np.median(contrasts) < DARK:
        found.append(finding("dark", picture=name, levels=float(np.median(contrasts))))
    elif np.median(edges) > BLURRED_PX:
        found.append(finding("blurred", picture=name, px=float(np.median(edges))))
    if np.median(full) > 0.3:
        found.append(finding("over-exposed", picture=name, share=100 * float(np.median(full))))
    return found
