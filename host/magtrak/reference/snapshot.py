"""Which pieces a snapshot consists of."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..protocol import SNAPSHOT_PIXELS

Picture = NDArray[np.uint8]


class Piece(NamedTuple):
    """Pixels of one row, ``step`` columns apart.

    Attributes
    ----------
    row, column : of the first one
    pixels : (n, ...) as the picture's; none: the snapshot is complete
    """

    row: int
    column: int
    pixels: Picture


def snapshot(picture: Picture, columns: tuple[int, int], rows: tuple[int, int], step: int) -> list[Piece]:
    """The pieces of a region of a picture in the order in which the card sends them.

    Place and row of the last piece, which has no pixels, mean nothing; here they are 0.

    Parameters
    ----------
    picture : (rows, columns, ...)
    columns, rows : first and last of the region; what the picture does not have of it is left out
    step : from pixel to pixel and from row to row
    """
    height, width = picture.shape[:2]
    region = range(columns[0], min(columns[1] + 1, width), step)
    pieces = [
        Piece(row, strip[0], picture[row, strip])
        for strip in (region[at : at + SNAPSHOT_PIXELS] for at in range(0, len(region), SNAPSHOT_PIXELS))
        for row in range(rows[0], min(rows[1] + 1, height), step)
    ]
    return [*pieces, Piece(0, 0, picture[0, :0])]
