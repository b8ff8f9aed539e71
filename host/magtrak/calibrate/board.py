"""Calibration boards: what is printed where, in the board's own frame.

Board frame B: origin at the upper left corner of the pattern's first square, X to the right, Y down, Z into the board,
millimetres; so that a board that faces the camera upright has the camera's own axes.
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import Booleans, Floats, Integers
from ..errors import CalibrationError

KINDS = ("charuco", "chessboard")

BAND_MM = {"a3": 45.0}
"""Height of the blank band below the pattern."""

SCALE_SIGMA = 3e-4
"""How well a printed board that was measured with a steel rule keeps its size, 1 sigma."""


@dataclass(frozen=True)
class Board:
    """A flat board with a pattern and a blank white band for the laser's line.

    Parameters
    ----------
    name : for messages and files
    kind : ``"charuco"`` or ``"chessboard"``
    columns, rows : squares
    square_mm, marker_mm : sides of a square and of a marker in it (ChArUco)
    dictionary : OpenCV's name of the markers' dictionary
    legacy : pattern of OpenCV before 4.6: first square white where the number of rows is even
    first_marker : id of the first marker
    band_mm : blank rectangle (left, top, right, bottom), mm in B; None where the board has none
    scale_sigma : 1 sigma of the board's scale
    """

    name: str
    kind: str
    columns: int
    rows: int
    square_mm: float
    marker_mm: float = 0.0
    dictionary: str = "DICT_4X4_250"
    legacy: bool = False
    first_marker: int = 0
    band_mm: tuple[float, float, float, float] | None = None
    scale_sigma: float = SCALE_SIGMA

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise CalibrationError(f"board {self.name}: kind is {self.kind!r}; it must be 'charuco' or 'chessboard'")
        if self.columns < 3 or self.rows < 3:
            raise CalibrationError(
                f"board {self.name}: {self.columns} x {self.rows} squares are too few; take at least 3 x 3"
            )
        if self.square_mm <= 0 or (self.kind == "charuco" and not 0 < self.marker_mm < self.square_mm):
            raise CalibrationError(
                f"board {self.name}: markers of {self.marker_mm:g} mm do not fit into squares of"
                f" {self.square_mm:g} mm; measure both on the print"
            )

    @property
    def corners(self) -> int:
        """Inner corners of the pattern."""
        return (self.columns - 1) * (self.rows - 1)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the pattern."""
        return self.columns * self.square_mm, self.rows * self.square_mm

    def points(self, ids: Integers) -> Floats:
        """(N, 2) places of inner corners in B, mm; row by row from the upper left."""
        ids = np.asarray(ids)
        return np.stack([ids % (self.columns - 1) + 1.0, ids // (self.columns - 1) + 1.0], axis=-1) * self.square_mm

    def on_band(self, points: Floats, margin_mm: Floats) -> Booleans:
        """Which of (N, 2) points lie on the blank band, at least ``margin_mm`` (N,) from its border."""
        if self.band_mm is None:
            return np.zeros(len(points), bool)
        left, top, right, bottom = self.band_mm
        x, y = points[:, 0], points[:, 1]
        return np.asarray(
            (x > left + margin_mm) & (x < right - margin_mm) & (y > top + margin_mm) & (y < bottom - margin_mm)
        )
