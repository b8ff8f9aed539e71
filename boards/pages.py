"""Writes a page for each kind of board, with its wiring: ``python -m boards.pages`` (``make docs``)."""

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from .board import ROWS_1024, Board
from .catalogue import MODULES
from .wiring import INVERTED, ROLES

PAGES = Path(__file__).resolve().parent.parent / "docs" / "boards"

_PARTS = {
    "runs": "runs of grey values: the one detector is `binary`, the paper's mean column of the gated pixels"
    " (`--settings paper`); no peak, intensity or runner-up",
    "isolate": "filter of isolated pixels",
    "window": "windowed centroid",
    "background_cells": "subtraction of ambient light",
    "speed_loop": "speed loop: the motor takes a duty",
    "edge_log": "edge log: a row's angle follows from the latches at the first and the last row of each image, as exact"
    " at constant speed",
    "snapshot": "snapshots",
    "full_rows": "full form of rows: compact ones have position, flags, and widths up to 15",
    "turn_check": "check of every turn's counts",
    "pwm_period": "setting of the PWM's period: it is 1024 clocks",
    "notes": "`camera.exposure_s` and `camera.time_offset_s` in frames: give the time offset in the calibration",
    "close_images": "images that begin within 480 clocks of the end of the one before: they are dropped, and counted",
}
"""What a card may be built without, for people."""

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
        *_built(boards),
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


def _built(boards: list[Board]) -> list[str]:
    """What each board's card is built with, where that is not everything."""
    lines = []
    for board in boards:
        features = board.features
        if features == ROWS_1024:
            continue
        sizes = f"images of up to {features.max_columns} x {features.compact_rows} px"
        if features.full_rows:
            sizes += f", {features.max_rows} rows in the full form"
        if features.background_cells:
            sizes += f"; the light of the room in {features.background_cells} blocks"
        lines += [f"`{board.name}`: {sizes}.", ""]
        without = [what for name, what in _PARTS.items() if not getattr(features, name)]
        if without:
            lines += ["Without:", "", *(f"- {what}" for what in without), ""]
            lines += ["Settings that need one of these are refused, and `magtrak info` tells what the card has.", ""]
    return ["## Built with", "", *lines] if lines else []


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
