"""Loads a board's bitstream, through openFPGALoader.

``python -m boards.program BOARD [--link uart|usb] [--source pattern]``
"""

import subprocess
import sys
from pathlib import Path

import click

from .board import Board
from .build import UNITS, check, folder, kept, known
from .catalogue import find
from .errors import BoardError

_LOADER = Path(sys.executable).with_name("openfpgaloader-cli")
_LIBRARIES = "libusb-1.0, libftdi1 (Debian and Ubuntu: apt install libusb-1.0-0 libftdi1-2)"


def bitstream(board: Board, link: str | None, source: str = "pattern") -> Path:
    """The file to load.

    Raises
    ------
    BoardError
        It was not built, or does not meet its timing.
    """
    known(board, link, source)
    place, result = folder(board, link, source), kept(board, link, source)
    if result:
        check(board, result)
    for file in (place / "top.dfu", place / UNITS[board.family].bitstream):
        if result and file.exists():
            return file
    raise BoardError(
        f"{board.name} has no bitstream in {place}: run 'make bitstream' first, with the same BOARD, LINK, SOURCE"
    )


def program(board: Board, link: str | None, source: str = "pattern", loader: Path = _LOADER) -> None:
    """Load it: into the FPGA's memory where the board allows that, else into its flash.

    Raises
    ------
    BoardError
        There is no bitstream, or openFPGALoader cannot load it; with what it said.
    """
    file = bitstream(board, link, source)
    if not loader.exists():
        raise BoardError(f"{loader} is missing: run 'make setup'")
    done = subprocess.run(
        [loader, *board.program, file], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    click.echo(done.stdout, nl=False)
    if "error while loading shared libraries" in done.stdout:
        raise BoardError(f"openFPGALoader needs libraries of the system: {_LIBRARIES}")
    if done.returncode:
        raise BoardError(
            f"{board.name} was not programmed: is it plugged in, and may you use it? ('magtrak doctor --udev' helps)"
        )


@click.command()
@click.argument("name", metavar="BOARD", default="")
@click.option("--link", metavar="uart|usb", default="", help="The build to load; by default that of the first link.")
@click.option("--source", metavar="NAME", default="pattern", show_default=True, help="Where its images come from.")
def main(name: str, link: str, source: str) -> None:
    """Load the bitstream of BOARD, which was built before."""
    try:
        program(find(name), link or None, source)
    except BoardError as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main()
