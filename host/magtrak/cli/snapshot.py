"""``magtrak snapshot``: a picture of what the card sees."""

from pathlib import Path

import click

from .common import BAUD, PORT, connected


@click.command()
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FILE.png")
@click.option(
    "--source",
    type=click.Choice(["raw", "gate", "weight"]),
    default="raw",
    show_default=True,
    help="The camera's colours; which pixels can be the laser by their colour; the weight that is measured.",
)
@click.option("--columns", nargs=2, type=click.IntRange(0, 4095), default=(0, 4095), metavar="FIRST LAST")
@click.option("--rows", nargs=2, type=click.IntRange(0, 4095), default=(0, 4095), metavar="FIRST LAST")
@click.option(
    "--step", type=click.IntRange(1, 63), default=1, show_default=True, help="Every so many-th row and column."
)
@PORT
@BAUD
def main(
    output: Path,
    source: str,
    columns: tuple[int, int],
    rows: tuple[int, int],
    step: int,
    port: str | None,
    baud: int,
) -> None:
    """Fetch a picture of what the card sees, with the settings in force.

    It comes in pieces between the frames of the measurement, so that a large one takes a while; --step 4 is sixteen
    times as fast. Laser and motor stay as they are.
    """
    from ..errors import MagtrakError
    from ..png import write_png
    from ..receive import check_outputs
    from ..snapshot import Area, take_snapshot
    from . import fail

    for name, (first, last) in (("--columns", columns), ("--rows", rows)):
        if last < first:
            fail(f"{name} {first} {last}: the last one lies before the first")
    try:
        check_outputs(output, None)
    except MagtrakError as error:
        fail(str(error))
    with connected(port, baud) as card:
        snapshot = take_snapshot(card, source, Area(*columns, *rows, step))
        write_png(output, snapshot.picture)
    height, width = snapshot.picture.shape[:2]
    images = snapshot.last_frame - snapshot.first_frame + 1
    click.echo(f"{output}: {source}, {width} x {height}, from {images} images")
    if snapshot.faults:
        click.echo(f"magtrak: {snapshot.faults} pieces are of rows that broke the camera's contract", err=True)
