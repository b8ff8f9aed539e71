"""Calibration boards: what is printed where, in the board's own frame.

Board frame B: origin at the upper left corner of the pattern's first square, X to the right, Y down, Z into the board,
millimetres; so that a board that faces the camera upright has the camera's own axes.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Booleans, Floats, Integers
from ..checked import Checked
from ..errors import CalibrationError

PATTERNS = ("charuco", "chessboard")

SCALE_SIGMA = 3e-4
"""How well a printed board that was measured with a steel rule keeps its size, 1 sigma."""


@dataclass(frozen=True)
class Board:
    """A flat board with a pattern and a blank white band for the laser's line.

    Parameters
    ----------
    name : for messages and files
    pattern : ``"charuco"`` or ``"chessboard"``
    columns, rows : squares
    square_mm, marker_mm : sides of a square and of a marker in it (ChArUco)
    dictionary : OpenCV's name of the markers' dictionary
    legacy : pattern of OpenCV before 4.6: first square white where the number of rows is even
    first_marker : id of the first marker
    band_mm : blank rectangle (left, top, right, bottom), mm in B; None where the board has none
    scale_sigma : 1 sigma of the board's scale
    """

    name: str
    pattern: str
    columns: int
    rows: int
    square_mm: float
    marker_mm: float = 0.0
    dictionary: str = "DICT_5X5_100"
    legacy: bool = False
    first_marker: int = 0
    band_mm: tuple[float, float, float, float] | None = None
    scale_sigma: float = SCALE_SIGMA

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise CalibrationError(
                f"board {self.name}: pattern is {self.pattern!r}; it must be 'charuco' or 'chessboard'"
            )
        if self.columns < 3 or self.rows < 3:
            raise CalibrationError(
                f"board {self.name}: {self.columns} x {self.rows} squares are too few; take at least 3 x 3"
            )
        if self.square_mm <= 0 or (self.pattern == "charuco" and not 0 < self.marker_mm < self.square_mm):
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

    def on_band(self, points: Floats) -> Booleans:
        """Which of (N, 2) points lie on the blank band."""
        if self.band_mm is None:
            return np.zeros(len(points), bool)
        left, top, right, bottom = self.band_mm
        x, y = points[:, 0], points[:, 1]
        return np.asarray((x > left) & (x < right) & (y > top) & (y < bottom))

    def as_dict(self) -> dict[str, Any]:
        """For session files."""
        values: dict[str, Any] = {"pattern": self.pattern, "columns": self.columns, "rows": self.rows}
        values["square_mm"] = self.square_mm
        if self.pattern == "charuco":
            values |= {"marker_mm": self.marker_mm, "dictionary": self.dictionary, "first_marker": self.first_marker}
            values["legacy"] = self.legacy
        return values | {"band_mm": self.band_mm and list(self.band_mm), "scale_sigma": self.scale_sigma}

    @classmethod
    def parse(cls, name: str, table: Checked) -> "Board":
        """From a session file's table."""
        known = ("pattern", "columns", "rows", "square_mm", "marker_mm", "dictionary", "first_marker", "legacy")
        table.only([*known, "band_mm", "scale_sigma"])
        pattern = table.choice("pattern", PATTERNS)
        charuco = pattern == "charuco"
        band = None
        if table.values.get("band_mm") is not None:
            left, top, right, bottom = table.array("band_mm", (4,)).tolist()
            band = (left, top, right, bottom)
        return cls(
            name,
            pattern,
            table.integer("columns", 3, 100),
            table.integer("rows", 3, 100),
            table.number("square_mm", 0, 10_000),
            table.number("marker_mm", 0, 10_000) if charuco else 0.0,
            str(table.values.get("dictionary", "DICT_5X5_100")),
            table.boolean("legacy", False),
            table.integer("first_marker", 0, 10_000, 0),
            band,
            table.number("scale_sigma", 0, 0.1, SCALE_SIGMA),
        )


A3 = Board("a3", "charuco", 9, 6, 40.0, 30.0, band_mm=(-30.0, 240.0, 390.0, 289.0))
"""On a sheet of A3, for distances to 1.3 m."""

LARGE = Board("large", "charuco", 9, 6, 95.0, 71.25, band_mm=(-60.0, 570.0, 915.0, 720.0))
"""A panel of 0.98 x 0.74 m, for distances to 3 m."""

BOARDS = {board.name: board for board in (A3, LARGE)}
"""The boards of the guided procedure."""
