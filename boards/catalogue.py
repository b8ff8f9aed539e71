"""All boards by name."""

from . import ecpix5, icebreaker, icepi_zero, orangecrab, ulx3s
from .board import LEAN, Board
from .errors import BoardError

BOARDS: dict[str, Board] = {
    board.name: board
    for board in (*ulx3s.BOARDS, *ecpix5.BOARDS, *orangecrab.BOARDS, *icepi_zero.BOARDS, *icebreaker.BOARDS)
}


def find(name: str) -> Board:
    """The board of that name; with ``-lean`` behind it, with a lean card.

    Raises
    ------
    BoardError
        There is none; names those that there are.
    """
    plain = name.removesuffix(LEAN)
    if plain not in BOARDS:
        said = f"there is no board {name!r}" if name else "BOARD=name is missing"
        raise BoardError(f"{said}; the boards are: {', '.join(BOARDS)}; each with {LEAN} behind it takes fewer cells")
    return BOARDS[plain] if plain == name else BOARDS[plain].lean()
