"""Writes a page for each kind of board, with its wiring: ``python -m boards.pages`` (``make docs``)."""

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from . import ecpix5, icebreaker, icepi_zero, orangecrab, ulx3s
from .board import Board
from .wiring import INVERTED, ROLES

PAGES = Path(__file__).resolve().parent.parent / "docs" / "boards"
MODULES: tuple[ModuleType, ...] = (ulx3s, ecpix5, orangecrab, icepi_zero, icebreaker)

_DIRECTIONS = {"i": "in", "o": "out", "io": "both"}


def name(module: ModuleType) -> str:
    """Name of the page of a board file."""
    return module.__name__.rsplit(".", 1)[-1].replace("_", "-")


def page(module: ModuleType) -> str:
    """The page of a board file, in Markdown."""
    boards: list[Board] = module.BOARDS
    first = boards[0]
    default = next(iter(first.links))
    names = ", ".join(f"`{board.name}`" for board in boards)
    lines = [
        f"# {first.title.split(',')[0]}",
        "",
        "<!-- Rendered by `python -m boards.pages`; a test compares. Change the board's file in `boards/` instead. -->",
        "",
        (module.__doc__ or "").strip(),
        "",
        f"Boards: {names}. Clock of the card {first.sync_hz / 1e6:g} MHz. Pins as in {first.source}.",
        "",
        first.about,
        "",
        "## Links",
        "",
        "| `LINK=` | where |",
        "|---|---|",
        *(f"| `{link}`{', the default' if link == default else ''} | {at} |" for link, at in first.links.items()),
        "",
        "## Wiring",
        "",
        "All at 3.3 V; connect the grounds. The laser's driver needs a pull-down of its own at its enable input, and",
        "the interlock's contact in series with its supply: see [safety](../safety.md).",
        "",
        "| what | signal | place | ball | |",
        "|---|---|---|---|---|",
        *rows(first),
        "",
    ]
    missing = [
        f"{resource}.{signal}"
        for resource, roles in ROLES.items()
        for signal in roles
        if signal not in first.wiring.get(resource, {})
    ]
    if missing:
        lines += [f"Not wired here: {', '.join(f'`{one}`' for one in missing)}.", ""]
    return "\n".join(lines)


def rows(board: Board) -> Iterator[str]:
    """The lines of the wiring table."""
    balls = {
        f"{one.name}_{one.number}:{pin}": ball for one in board.platform.connectors for pin, ball in one.mapping.items()
    }
    for resource, signals in board.wiring.items():
        for signal, places in signals.items():
            role = ROLES[resource][signal]
            for number, place in enumerate(places.lstrip(INVERTED).split()):
                which = f"`{resource}.{signal}{number if role.width > 1 else ''}`"
                meaning = role.meaning if role.width == 1 else f"camera, D{number}"
                active = "active low" if places.startswith(INVERTED) else ""
                where = (board.label(place), balls.get(place, place), f"{_DIRECTIONS[role.direction]} {active}".strip())
                yield f"| {meaning} | {which} | {where[0]} | {where[1]} | {where[2]} |"


def main() -> None:
    for module in MODULES:
        (PAGES / f"{name(module)}.md").write_text(page(module))


if __name__ == "__main__":
    main()
