"""Calibration boards: a flat panel with squares printed on it and a blank white band for the laser's line.

The board's frame is OpenCV's: the origin is the upper left corner of the squares, X goes right along the print, Y down,
Z away from who reads it; millimetres. The squares of a chessboard begin with a black one; those of a ChArUco board
are whatever OpenCV prints, so that its detector finds them. Only the print comes from OpenCV: where a point of it
is seen is this package's own business.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import SimError
from .surfaces import Floats, Plane

SQUARE_PX = 280
"""Pixels of a square's print: a marker of 3/4 of a square with 5 x 5 bits and its border has 30 to each."""

INK = 0.06
"""Part of the light that black ink reflects, in parts of what the paper does."""


@dataclass(frozen=True)
class Board:
    """What is printed, and where on the panel.

    Parameters
    ----------
    pattern : "charuco" or "chessboard"
    columns, rows : squares
    square_mm : side of a square
    marker_mm : side of a ChArUco marker
    dictionary : of the markers, by OpenCV's name
    first_marker : id of the first marker, so that several boards can stand in one picture
    margins_mm : blank panel left of, above, right of and below the squares; the widest of the last two is the band
    mirrored : printed the wrong way round, a mistake that tools have to notice

    Raises
    ------
    SimError : it can't be printed
    """

    pattern: str
    columns: int
    rows: int
    square_mm: float
    marker_mm: float = 0.0
    dictionary: str = "DICT_5X5_100"
    first_marker: int = 0
    margins_mm: tuple[float, float, float, float] = (30.0, 8.0, 30.0, 49.0)
    mirrored: bool = False

    def __post_init__(self) -> None:
        if self.pattern not in ("charuco", "chessboard"):
            raise SimError(f"a board's pattern is charuco or chessboard, not {self.pattern}")
        if self.pattern == "charuco" and not 0 < self.marker_mm < self.square_mm:
            raise SimError(
                f"markers of {self.marker_mm:g} mm don't fit into squares of {self.square_mm:g} mm; make them smaller"
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the panel."""
        left, top, right, bottom = self.margins_mm
        return left + self.columns * self.square_mm + right, top + self.rows * self.square_mm + bottom

    @property
    def corner_mm(self) -> tuple[float, float]:
        """The panel's upper left corner in the board's frame."""
        return -self.margins_mm[0], -self.margins_mm[1]

    @property
    def band_mm(self) -> tuple[float, float, float, float]:
        """The blank band: least x, least y, greatest x, greatest y in the board's frame."""
        _, top, _, bottom = self.margins_mm
        x, y = self.corner_mm
        width, height = self.size_mm
        if bottom >= top:
            return x, self.rows * self.square_mm, x + width, y + height
        return x, y, x + width, 0.0

    def panel(self, pose: npt.ArrayLike) -> Plane:
        """The panel as a surface, for a 4 x 4 pose of the board's frame in the camera's."""
        middle = np.eye(4)
        middle[:2, 3] = np.asarray(self.corner_mm) + np.asarray(self.size_mm) / 2
        return Plane(self.size_mm, np.asarray(pose, dtype=np.float64) @ middle)

    def pose(self, panel: Plane) -> Floats:
        """The pose of the board's frame for that of its panel."""
        back = np.eye(4)
        back[:2, 3] = -(np.asarray(self.corner_mm) + np.asarray(self.size_mm) / 2)
        return np.asarray(panel.pose @ back)

    def white(self, panel: Plane, points: Floats) -> Floats:
        """Part of the paper's reflectance (N,) at points (N, 3) of the panel in the camera's frame."""
        pose = self.pose(panel)
        x, y = ((points - pose[:3, 3]) @ pose[:3, :2]).T
        if self.mirrored:
            x = self.columns * self.square_mm - x
        scale = SQUARE_PX / self.square_mm
        column, row = np.floor(x * scale).astype(np.int64), np.floor(y * scale).astype(np.int64)
        height, width = self.print.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        bright = self.print[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.where(inside & ~bright, INK, 1.0)

    def corners(self) -> Floats:
        """(N, 3) inner corners of the squares in the board's frame, row by row."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        corners = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
        return np.asarray(corners * self.square_mm, dtype=np.float64)

    def describe(self) -> dict[str, Any]:
        """What is known of the print to whoever holds the board, for JSON."""
        known: dict[str, Any] = {"pattern": self.pattern, "columns": self.columns, "rows": self.rows}
        known["square_mm"] = self.square_mm
        if self.pattern == "charuco":
            known |= {"marker_mm": self.marker_mm, "dictionary": self.dictionary, "first_marker": self.first_marker}
        return known | {"band_mm": list(self.band_mm)}

    @cached_property
    def print(self) -> npt.NDArray[np.bool_]:
        """The squares, :data:`SQUARE_PX` pixels each: where the paper stays white."""
        row, column = np.indices((self.rows, self.columns))
        squares = np.kron((row + column) % 2 == 1, np.ones((SQUARE_PX, SQUARE_PX), np.bool_))
        if self.pattern == "chessboard":
            return np.asarray(squares)
        import cv2  # here, so that scenes without a ChArUco board need no OpenCV

        if not hasattr(cv2.aruco, self.dictionary):
            raise SimError(f"OpenCV has no dictionary of markers called {self.dictionary}; DICT_5X5_100 is one")
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        # A marker in every second square, counted from 0; the white squares of a chessboard hold them.
        ids = np.arange(self.first_marker, self.first_marker + (self.columns * self.rows) // 2, dtype=np.int32)
        if ids[-1] >= len(markers.bytesList):
            raise SimError(
                f"{self.dictionary} has {len(markers.bytesList)} markers, and this board needs {ids[-1] + 1}"
            )
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_mm, self.marker_mm, markers, ids)
        size = (self.columns * SQUARE_PX, self.rows * SQUARE_PX)
        return np.asarray(board.generateImage(size, marginSize=0) > 127)


A3 = Board("charuco", 9, 6, 40.0, 30.0, margins_mm=(30.0, 8.0, 30.0, 49.0))
"""A sheet of A3, for distances to 1.3 m."""

LARGE = Board("charuco", 9, 6, 95.0, 71.25, margins_mm=(60.0, 20.0, 60.0, 150.0))
"""A panel of 0.98 x 0.74 m, for distances to 3 m."""

BOARDS = {"a3": A3, "large": LARGE}
"""The boards by name."""
