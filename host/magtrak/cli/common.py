"""What the commands that talk to a card share."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from . import fail

if TYPE_CHECKING:
    from ..card import Card

PORT = click.option("--port", metavar="PORT|SERIAL", help="Port or serial number of the card; by default the only one.")
BAUD = click.option("--baud", type=click.IntRange(min=1), default=3_000_000, show_default=True, help="Of a UART.")


@contextmanager
def connected(port: str | None, baud: int) -> Iterator["Card"]:
    """A card to talk to; errors end the program with one sentence, Ctrl-C without one."""
    from ..card import Card
    from ..discover import resolve
    from ..errors import MagtrakError
    from ..link import Link

    try:
        with Link(resolve(port, baud), baud) as link:
            yield Card(link)
    except MagtrakError as error:
        fail(str(error))
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def table(rows: Sequence[tuple[str, ...]], indent: str = "") -> str:
    """Columns as wide as they must be, two spaces apart."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    return "\n".join(indent + line.rstrip() for line in lines)
