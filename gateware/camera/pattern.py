"""A test picture: brings a board up before it has a camera."""

import numpy as np
from amaranth.hdl import Cat, Module, Mux, Signal
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
        width = self.columns + _BLANK_COLUMNS
        column = Signal(range(width))
        row = Signal(range(self.rows + 1))
        # Of the line, in this image.
        start = Signal(range(self.columns))
        next_start = Signal(range(self.columns))
        centre = Signal(range(self.columns))
        next_centre = Signal(range(self.columns))
        going = Signal()

        def following(place):
            return Mux(place == self.columns - 1, 0, place + 1)

        # It is due when the clocks that are left fall below 0.
        due = Signal()
        begins = ~going & self.run & due
        if self.period > 1:
            left = Signal(range(-self.period, self.period), init=-1)
            with m.If(begins):
                m.d.sync += left.eq(self.period - 2)
            with m.Elif(~left[-1]):
                m.d.sync += left.eq(left - 1)
            m.d.comb += due.eq(left[-1])
        else:
            m.d.comb += due.eq(1)

        # What a row ends with is known a clock before, what an image ends with for longer.
        row_ends = Signal()
        blank = Signal()
        m.d.sync += [
            row_ends.eq(going & (column == width - 2)),
            blank.eq(row == self.rows),
            next_start.eq(following(start)),
            next_centre.eq(following(centre)),
        ]
        with m.If(~going):
            m.d.sync += [going.eq(begins), centre.eq(start)]
        with m.Elif(row_ends):
            m.d.sync += [column.eq(0), row.eq(row + 1), centre.eq(next_centre)]
            with m.If(blank):
                m.d.sync += [row.eq(0), start.eq(next_start), going.eq(0)]
        with m.Else():
            m.d.sync += column.eq(column + 1)

        # 1: where it is; 2: what that means. A row's number has been known for long where its first column is 0.
        in_columns = Signal()
        first = Signal()
        last = Signal()
        ends = Signal()
        in_row = Signal()
        in_blank = Signal()
        in_first = Signal()
        beyond = Signal(range(-self.columns, width))  # the line
        near = Signal()
        low = Signal(3)
        placed = Signal(4)
        m.d.sync += [
            in_columns.eq(column < self.columns),
            first.eq(column == 0),
            last.eq(column == self.columns - 1),
            ends.eq(column == _BLANK_COLUMNS - 1),
            in_row.eq(going & (row != self.rows)),
            in_blank.eq(going & (row == self.rows)),
            in_first.eq(row == 0),
            beyond.eq(column - centre),
            placed.eq(Cat(in_row & in_columns, in_row & first, in_row & last, in_row & first & in_first)),
            near.eq(Mux(beyond[-1], beyond[3:].all() & beyond[:3].any(), ~beyond[3:].any())),
            low.eq(Mux(beyond[-1], -beyond[:3], beyond[:3])),
        ]
        # 3: the pixel.
        pixel = self.video.pixel.payload
        green = Mux(near, 255 - _SLOPE * low, 0)  # 255 - 32 * 7 = 31
        m.d.sync += [
            self.video.pixel.valid.eq(placed[0]),
            pixel.row_first.eq(placed[1]),
            pixel.row_last.eq(placed[2]),
            pixel.frame_first.eq(placed[3]),
            pixel.r.eq(green >> 2),
            pixel.g.eq(green),
            pixel.b.eq(green >> 2),
            self.video.frame_end.eq(in_blank & ends),
        ]
        return m
