"""What was seen of boards: corners in pictures, and rows of laser lines with the encoder's position."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import Floats, Integers
from .board import Board

ROWS = 24
"""Rows of an image that a fit uses: more tell little, for all share the error of the image's angle."""


@dataclass(frozen=True)
class Lines:
    """Rows of laser lines, an entry for each; all arrays (N,).

    Attributes
    ----------
    image : number of the image; rows of one image share the error of their angle
    row, column : px, distorted picture
    counts : encoder's position from the index at the row's time (time offset 0)
    rate : counts per second at that time
    """

    image: Integers = field(default_factory=lambda: np.zeros(0, np.int64))
    row: Floats = field(default_factory=lambda: np.zeros(0))
    column: Floats = field(default_factory=lambda: np.zeros(0))
    counts: Floats = field(default_factory=lambda: np.zeros(0))
    rate: Floats = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.row)

    def __getitem__(self, which: object) -> "Lines":
        return Lines(*(getattr(self, name)[which] for name in ("image", "row", "column", "counts", "rate")))


@dataclass(frozen=True)
class View:
    """One placement of a board.

    Attributes
    ----------
    name : of the picture, for messages
    board : which board it is
    ids : (N,) numbers of the corners found
    corners : (N, 2) where, px
    lines : laser lines on the board, the camera and the board not having moved
    """

    name: str
    board: Board
    ids: Integers
    corners: Floats
    lines: Lines = field(default_factory=Lines)


@dataclass(frozen=True)
class Observations:
    """All that a calibration is made from.

    Attributes
    ----------
    width, height : of the pictures, px
    views : one for each placement
    counts_per_turn : of the encoder
    """

    width: int
    height: int
    views: Sequence[View]
    counts_per_turn: int = 8192

    def thinned(self, rows: int = ROWS) -> "Observations":
        """With at most so many rows of each image, evenly spread."""
        return replace(self, views=[replace(view, lines=_thin(view.lines, rows)) for view in self.views])

    @property
    def boards(self) -> list[Board]:
        """The boards in use, each once, in order."""
        return list({view.board.name: view.board for view in self.views}.values())

    @property
    def images(self) -> int:
        """Laser images."""
        return sum(len(np.unique(view.lines.image)) for view in self.views)


def _thin(lines: Lines, rows: int) -> Lines:
    keep = []
    for image in np.unique(lines.image):
        mine = np.flatnonzero(lines.image == image)
        if len(mine) > rows:
            mine = mine[np.round(np.linspace(0, len(mine) - 1, rows)).astype(np.int64)]
        keep.append(mine)
    return lines[np.concatenate(keep)] if keep else lines
