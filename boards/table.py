"""Builds every board and writes what came out into ``docs/boards/README.md``: ``make boards``.

Boards that were built before from the same sources are not built again. The exit status is 1 where one does not fit,
or is too slow.
"""

from pathlib import Path

from .board import Board
from .build import UNITS, Result, build, check
from .catalogue import BOARDS
from .errors import BoardError
from .pages import PAGES

README = PAGES / "README.md"
BEGIN, END = "<!-- figures: make boards -->", "<!-- end of figures -->"
HEAD = "| board | link | clocks, MHz reached (needed) | seed | cells | block RAMs | multipliers | time to build, s |"


def line(board: Board, link: str, result: Result) -> str:
    """A build as a line of the table."""
    units = UNITS[board.family]
    counts = [f"{result.used[unit]} of {result.available[unit]}" for unit in (units.cells, units.memories)]
    multipliers = f"{result.used[units.multipliers]} of {result.available[units.multipliers]}"
    clocks = ", ".join(f"{clock} {mhz:.0f} ({result.wanted_mhz[clock]:.4g})" for clock, mhz in result.mhz.items())
    built = (*counts, multipliers, f"{result.seconds:.0f}")
    return f"| `{board.name}` | {link} | {clocks} | {result.seed} | {' | '.join(built)} |"


def insert(lines: list[str], page: Path = README) -> None:
    """Put a table in place of the page's last."""
    before, rest = page.read_text().split(BEGIN)
    after = rest.split(END)[1]
    table = "\n".join([HEAD, "|---|---|---|---:|---:|---:|---:|---:|", *lines])
    page.write_text(f"{before}{BEGIN}\n{table}\n{END}{after}")


def main() -> None:
    lines, bad = [], []
    for board in BOARDS.values():
        for link in board.links:
            try:
                result = build(board, link)
                lines.append(line(board, link, result))
                check(board, result)
            except BoardError as error:
                bad.append(str(error))
                if not lines or f"| `{board.name}` | {link} |" not in lines[-1]:
                    lines.append(f"| `{board.name}` | {link} | {error} | | | | | |")
            print(lines[-1], flush=True)
    insert(lines)
    if bad:
        raise SystemExit("\n".join(f"error: {text}" for text in bad))


if __name__ == "__main__":
    main()
