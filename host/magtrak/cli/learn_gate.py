"""``magtrak learn-gate``: the gate from pictures."""

from pathlib import Path

import click

PATH = click.Path(path_type=Path)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--picture", type=PATH, metavar="FILE", help="A picture of the line.")
@click.option(
    "--patch", type=int, nargs=4, metavar="X Y W H", help="Where the line is in it: left, top, width, height, in px."
)
@click.option("--on", type=PATH, metavar="FILE", help="A picture with the laser on, and ...")
@click.option("--off", type=PATH, metavar="FILE", help="... the same with it off; instead of picture and patch.")
@click.option("--output", required=True, type=PATH, metavar="FILE.toml", help="Settings for magtrak-recv.")
@click.option(
    "--settings",
    default="green",
    show_default=True,
    metavar="NAME|FILE.toml",
    help="Where all but the gate comes from.",
)
def main(
    picture: Path | None,
    patch: tuple[int, int, int, int] | None,
    on: Path | None,
    off: Path | None,
    output: Path,
    settings: str,
) -> None:
    """Learn the laser's colours and write settings that pass them.

    From one picture and a rectangle on the line, or from two pictures of a scene that stands still, with the laser on
    and off. Tells how much of the line passes, and how much of the rest.
    """
    from ..errors import MagtrakError
    from ..learned import learn_gate
    from . import fail

    try:
        learn_gate(picture=picture, patch=patch, on=on, off=off, output=output, settings=settings)
    except MagtrakError as error:
        fail(str(error))
