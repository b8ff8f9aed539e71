"""What a card is built with."""

from dataclasses import dataclass

from magtrak.reference.ambient import MIN_CELLS

DEFAULT_CELLS = 160 * 120
"""Ten block RAMs of an ECP5; VGA in blocks of 4 x 4."""

FEWER_CELLS = 128 * 64
"""Four block RAMs of an ECP5; VGA in blocks of 8 x 8, 1080p in blocks of 16 x 16 as with the default."""


@dataclass(frozen=True)
class Features:
    """What the gateware is built with; the defaults are everything. What is not built takes no cells.

    A setting that needs what is not built is refused as out of range; until then the block in question behaves as if
    the setting were the one that does without it.

    Parameters
    ----------
    max_columns : columns that an image may have, 32 to 2048
    max_rows : rows of an image that are stored, a power of two from 2 to 2048
    background_cells : blocks in which the picture of the room is kept, see
        :class:`~gateware.vision.background.Background`; 0: none is subtracted, ``ambient_mode`` has to be off
    isolate : the isolated-pixel filter, which holds a row; without it ``isolate`` has to be 0
    window : the centroid's second pass, over a memory of rows; without it ``centroid_window`` has to be the run
    speed_loop : the motor's speed is controlled; without it the motor takes a duty only
    snapshot : pictures for people

    Raises
    ------
    ValueError
        A limit is out of range.
    """

    max_columns: int = 2048
    max_rows: int = 2048
    background_cells: int = DEFAULT_CELLS
    isolate: bool = True
    window: bool = True
    speed_loop: bool = True
    snapshot: bool = True

    def __post_init__(self) -> None:
        if not 32 <= self.max_columns <= 2048:
            raise ValueError(f"max_columns is {self.max_columns}; 32 to 2048 are possible")
        if self.max_rows not in [1 << n for n in range(1, 12)]:
            raise ValueError(f"max_rows is {self.max_rows}; powers of two from 2 to 2048 are possible")
        if self.background_cells and not MIN_CELLS <= self.background_cells <= 2048 * 2048:
            raise ValueError(
                f"background_cells is {self.background_cells}; 0 and {MIN_CELLS} to {2048 * 2048} are possible"
            )


EVERYTHING = Features()
