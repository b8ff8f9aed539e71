"""All boards by name."""

from types import ModuleType

from . import ecpix5, icebreaker, icepi_zero, orangecrab, ulx3s
from .board import LEAN, Board
from .errors import BoardError

MODULES: tuple[ModuleType, ...] = (ulx3s, ecpix5, orangecrab, icepi_zero, icebreaker)
"""The files of boards."""

BOARDS: dict[str, Board] = {board.name: board for module in MODULES for board in module.BOARDS}


def find(name: str) -> Board:
    """The board of that name; with ``-lean`` behind it, with a lean card.

    Raises
    ------
    BoardError
        There is none, and names those that there are; or it has no more than a lean card.
    """
    plain = name.removesuffix(LEAN)
    if plain not in BOARDS:
        said = f"there is no board {name!r}" if name else "BOARD=name is missing"
        raise BoardError(f"{said}; the boards are: {', '.join(BOARDS)}; each with {LEAN} behind it takes fewer cells")
    board = BOARDS[plain]
    if plain == name:
        return board
    if board.lean().features == board.features:
        raise BoardError(f"{plain} is lean as it is: leave out the {LEAN!r}")
    return board.lean()
