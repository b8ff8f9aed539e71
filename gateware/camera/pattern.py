"""A test picture: brings a board up before it has a camera."""

import numpy as np
from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..layouts import Video

_BLANK_COLUMNS = 32
_SLOPE = 32  # grey levels per column


class Pattern(wiring.Component):
    """Images of a green line on black that leans by a column a row and moves by a column an image.

    A pixel a clock, 32 clocks of blanking after each row, a blank row after each image, and then a pause where the
    next image is not due.

    Parameters
    ----------
    columns : 32 to 2048
    rows : 1 to 2048
    period : clocks from image to image; where an image takes longer, or at 0, there is no pause

    Members
    -------
    run : images are wanted; the one that has begun is completed
    video : images

    Raises
    ------
    ValueError
        A size is out of range.
    """

    def __init__(self, columns: int, rows: int, period: int = 0) -> None:
        for name, value, low in (("columns", columns, 32), ("rows", rows, 1)):
            if not low <= value <= 2048:
                raise ValueError(f"{name} is {value}; {low} to 2048 are possible")
        if period < 0:
            raise ValueError(f"period is {period}; it cannot be negative")
        self.columns = columns
        self.rows = rows
        self.period = period
        super().__init__({"run": In(1), "video": Out(Video())})

    def reference(self, number: int) -> np.ndarray:
        """The definition: image ``number`` since reset, (rows, columns, 3) uint8, RGB."""
        centre = (np.arange(self.rows)[:, None] + number) % self.columns
        green = np.maximum(255 - _SLOPE * np.abs(np.arange(self.columns) - centre), 0)
        return np.stack([green >> 2, green, green >> 2], axis=-1).astype(np.uint8)

    def elaborate(self, platform):
        m = Module()
        column = Signal(range(self.columns + _BLANK_COLUMNS))
        row = Signal(range(self.rows + 1))
        start = Signal(range(self.columns))  # of the line, in this image
        centre = Signal(range(self.columns))
        going = Signal()

        def following(place):
            return Mux(place == self.columns - 1, 0, place + 1)

        due = Signal(init=1)
        begins = ~going & self.run & due
        if self.period > 1:
            left = Signal(range(self.period - 1))
            with m.If(begins):
                m.d.sync += [left.eq(self.period - 2), due.eq(0)]
            with m.Elif(left != 0):
                m.d.sync += left.eq(left - 1)
            with m.Else():
                m.d.sync += due.eq(1)

        with m.If(~going):
            m.d.sync += [going.eq(begins), centre.eq(start)]
        with m.Elif(column != self.columns + _BLANK_COLUMNS - 1):
            m.d.sync += column.eq(column + 1)
        with m.Else():
            m.d.sync += [column.eq(0), row.eq(row + 1), centre.eq(following(centre))]
            with m.If(row == self.rows):
                m.d.sync += [row.eq(0), start.eq(following(start)), going.eq(0)]

        distance = Signal(range(self.columns))
        places = Signal(4)
        placed = Signal(4)
        green = Signal(8)
        pixel = self.video.pixel.payload
        in_row = going & (row != self.rows)
        m.d.comb += [
            places[0].eq(in_row & (column < self.columns)),
            places[1].eq(in_row & (column == 0)),
            places[2].eq(in_row & (column == self.columns - 1)),
            places[3].eq(in_row & (column == 0) & (row == 0)),
            green.eq(Mux(distance < 8, 255 - _SLOPE * distance[:3], 0)),  # 255 - 32 * 7 = 31
        ]
        m.d.sync += [
            placed.eq(places),
            distance.eq(Mux(column > centre, column - centre, centre - column)),
            self.video.pixel.valid.eq(placed[0]),
            pixel.row_first.eq(placed[1]),
            pixel.row_last.eq(placed[2]),
            pixel.frame_first.eq(placed[3]),
            pixel.r.eq(green >> 2),
            pixel.g.eq(green),
            pixel.b.eq(green >> 2),
            self.video.frame_end.eq(going & (row == self.rows) & (column == _BLANK_COLUMNS - 1)),
        ]
        return m
