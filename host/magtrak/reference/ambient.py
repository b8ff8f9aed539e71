"""The room's light, taken in images without laser and subtracted from those with it.

A full image is more than a small FPGA holds. So the background has one value for each block of 2^shift x 2^shift
pixels: the greatest mix in the block. What is no brighter than anything its block showed without laser is not the
laser. Means, as one would have thought of first, leave the brighter half of each textured block as false lines: on ten
pairs of real pictures, blocks of 4 x 4 and the mean of the channels, 80 % of the rows were right with means and 96 %
with maxima.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..protocol import AmbientMode, Phase

Mixed = NDArray[np.int32]
"""(rows, columns) of :func:`magtrak.reference.mix`."""

MAX_SHIFT = 7
"""Blocks of at most 128 x 128 pixels."""

MIN_CELLS = 256
"""Blocks of 128 x 128 in an image of 2048 x 2048."""

LIT, DARKENING, DARK, LIGHTENING = range(4)
"""States of :class:`Alternation`: what the image is, or what it waits for."""


@dataclass(frozen=True)
class Alternation:
    """Which images are measured and which are background.

    Attributes
    ----------
    state : of the present image
    left : measured images that follow it before the next background
    """

    state: int = LIT
    left: int = 0

    @property
    def laser(self) -> bool:
        """Whether the laser may shine, from the end of the image before on."""
        return self.state in (LIT, LIGHTENING)

    def phase(self, mode: int, subtracted: bool) -> Phase:
        """What the frame says of the image; ``mode`` as of its first pixel."""
        if self.state == DARK:
            return Phase.BACKGROUND
        if self.state != LIT:
            return Phase.SKIPPED
        return Phase.MEASURED if subtracted or mode == AmbientMode.OFF else Phase.UNSUBTRACTED

    def after(self, mode: int, measured: int) -> "Alternation":
        """The next image, decided as this one ends; ``measured`` is the register ``ambient_measured``."""
        if mode == AmbientMode.OFF:
            return Alternation()
        if self.state == LIT and self.left:
            return Alternation(LIT, self.left - 1)
        if mode == AmbientMode.SKIP:
            state = (self.state + 1) % 4
        else:
            state = LIT if self.state == DARK else DARK
        return Alternation(state, measured - 1 if state == LIT else 0)


@dataclass(frozen=True)
class Background:
    """The light without laser.

    Attributes
    ----------
    shift : blocks are 2^shift x 2^shift pixels; those at the right and lower border may be smaller
    cells : greatest mix of each block
    """

    shift: int
    cells: Mixed

    @classmethod
    def of(cls, mixed: Mixed, shift: int) -> "Background":
        """Taken from an image."""
        size = 1 << shift
        rows, columns = mixed.shape
        padded = np.pad(mixed, ((0, -rows % size), (0, -columns % size)))
        high, wide = padded.shape[0] >> shift, padded.shape[1] >> shift
        return cls(shift, padded.reshape(high, size, wide, size).max(axis=(1, 3)))

    def spread(self, rows: int, columns: int) -> Mixed:
        """The value that each pixel has subtracted."""
        row, column = np.arange(rows) >> self.shift, np.arange(columns) >> self.shift
        spread: Mixed = self.cells[row[:, None], column]
        return spread


def subtract(mixed: Mixed, background: Background | None) -> Mixed:
    """The mix less the background, clipped at 0."""
    if background is None:
        return mixed
    left: Mixed = np.maximum(mixed - background.spread(*mixed.shape), 0)
    return left


class BackgroundStore:
    """When there is a background, and how fine it is.

    The blocks begin with single pixels. Each image of which there are more blocks than cells makes them coarser, so
    that after a few images the finest that fit are in use. After an image of another size all starts anew.

    Parameters
    ----------
    cells : capacity

    Attributes
    ----------
    background : what is subtracted from the next image, None for nothing
    shift : size of the blocks
    """

    def __init__(self, cells: int) -> None:
        self.cells = cells
        self.shift = 0
        self.background: Background | None = None
        self._size = (0, 0)

    def settings_change(self) -> None:
        """A background of other settings is of no use."""
        self.background = None

    def push(self, mixed: Mixed, *, take: bool, faulty: bool = False) -> None:
        """An image has ended. ``take``: it was a background; ``faulty``: it broke the camera's contract."""
        rows, columns = mixed.shape
        blocks = -(-rows >> self.shift) * -(-columns >> self.shift)
        if faulty:
            self.background = None if take else self.background
        elif (rows, columns) != self._size:
            self._size, self.shift, self.background = (rows, columns), 0, None
        elif blocks > self.cells:
            self.shift, self.background = self.shift + 1, None
        elif take:
            self.background = Background.of(mixed, self.shift)
