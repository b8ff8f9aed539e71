"""What a card is built with."""

from dataclasses import dataclass

from magtrak.protocol import COMPACT_ROW, FULL_ROW
from magtrak.reference.ambient import MIN_CELLS

DEFAULT_CELLS = 160 * 120
"""Ten block RAMs of an ECP5; VGA in blocks of 4 x 4."""

FEWER_CELLS = 128 * 64
"""Four block RAMs of an ECP5; VGA in blocks of 8 x 8, 1080p in blocks of 16 x 16 as with the default."""

ROW_WORDS = FULL_ROW.size // COMPACT_ROW.size
"""Rows in the compact form that take the room of one in the full form."""


def compact_rows(max_rows: int) -> int:
    """Rows in the compact form that fit where there is room for ``max_rows`` in the full one."""
    return min(ROW_WORDS * max_rows, 2048)


@dataclass(frozen=True)
class Features:
    """What the gateware is built with; the defaults are everything. What is not built takes no cells.

    A setting that needs what is not built is refused as out of range; until then the block in question behaves as if
    the setting were the one that does without it.

    Parameters
    ----------
    max_columns : columns that an image may have, 32 to 2048
    max_rows : rows of an image that are stored in the full form, a power of two from 2 to 2048; in the compact form
        there is room for :attr:`compact_rows`
    background_cells : blocks in which the picture of the room is kept, see
        :class:`~gateware.vision.background.Background`; 0: none is subtracted, ``ambient_mode`` has to be off
    isolate : the isolated-pixel filter, which holds a row; without it ``isolate`` has to be 0
    window : the centroid's second pass, over a memory of rows; without it ``centroid_window`` has to be the run
    runs : grey values are measured; without it only the gated pixels are, as the paper does: ``detector`` has to be
        ``BINARY`` and ``floor`` 255, see :class:`~gateware.vision.gated.GatedVision`. What works on grey values
        (background, ``isolate``, ``window``, ``snapshot``) cannot be built then.
    speed_loop : the motor's speed is measured, controlled and watched; without it the motor takes a duty only, no fault
        stops it, and ``motor_watch`` and ``laser_conditions`` have to be 0
    snapshot : pictures for people
    edge_log : frames carry the encoder's edges; without it a row's angle follows from the latches at the first and the
        last row alone, which is as exact while the speed is constant
    full_rows : rows may be sent in the full form; without it ``form`` has to be ``COMPACT``
    turn_check : the counts of every turn are checked; without it ``counts_per_turn`` has to be 0
    pwm_period : the PWM's period can be set; without it ``motor_period`` has to be 1024
    notes : frames carry ``exposure_us`` and ``time_offset_ns``; without it these have to be 0
    close_images : an image may begin right after the one before; without it one that begins within 480 clocks of
        that one's end is refused, and counted as dropped
    fast_clock : registers stand behind the block RAMs of frame and registers, which clocks above some 50 MHz need, and
        the next command may wait while one is executed

    Raises
    ------
    ValueError
        A limit is out of range, or a part is built without another that it needs.
    """

    max_columns: int = 2048
    max_rows: int = 2048
    background_cells: int = DEFAULT_CELLS
    isolate: bool = True
    window: bool = True
    runs: bool = True
    speed_loop: bool = True
    snapshot: bool = True
    edge_log: bool = True
    full_rows: bool = True
    turn_check: bool = True
    pwm_period: bool = True
    notes: bool = True
    close_images: bool = True
    fast_clock: bool = True

    @property
    def compact_rows(self) -> int:
        """Rows of an image that are stored in the compact form."""
        return compact_rows(self.max_rows)

    def __post_init__(self) -> None:
        if not 32 <= self.max_columns <= 2048:
            raise ValueError(f"max_columns is {self.max_columns}; 32 to 2048 are possible")
        if self.max_rows not in [1 << n for n in range(1, 12)]:
            raise ValueError(f"max_rows is {self.max_rows}; powers of two from 2 to 2048 are possible")
        if self.background_cells and not MIN_CELLS <= self.background_cells <= 2048 * 2048:
            raise ValueError(
                f"background_cells is {self.background_cells}; 0 and {MIN_CELLS} to {2048 * 2048} are possible"
            )
        if self.runs and not self.close_images:
            raise ValueError("close_images cannot be left out with runs: those take longer than images would be apart")
        needs = ("background_cells", "isolate", "window", "snapshot")
        without = [name for name in needs if getattr(self, name)]
        if not self.runs and without:
            raise ValueError(f"{', '.join(without)} cannot be built without runs: leave out these as well")


EVERYTHING = Features()
