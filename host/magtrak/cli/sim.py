"""``magtrak-sim``: the virtual card."""

from pathlib import Path

import click

PATH = click.Path(path_type=Path)


@click.command()
@click.option("--scene", metavar="NAME|FILE.toml", help="Show a scene: 'default', 'quick', or a file.")
@click.option("--pattern", is_flag=True, help="Show the card's own test picture, for `magtrak self-test`; for ever.")
@click.option("--board", metavar="NAME", help="Built as the card on that board.  [default: with everything]")
@click.option("--frames", type=PATH, metavar="DIR", help="Show the pictures of a folder, in name order.")
@click.option(
    "--angles", type=PATH, metavar="FILE.csv", help="Angles of the pictures: frame,angle_start_deg,angle_end_deg."
)
@click.option(
    "--counts-per-turn",
    type=int,
    metavar="N",
    default=8192,
    show_default=True,
    help="Of the encoder, after x4, with --frames.",
)
@click.option("--link", type=PATH, metavar="PATH", help="Make a symbolic link to the port here when the card is ready.")
@click.option("--frame-rate", type=float, metavar="HZ", help="Pictures per second.  [default: the scene's, else 50]")
@click.option(
    "--row-time", type=float, metavar="US", help="Time from row to row.  [default: rows fill 80 % of the period]"
)
@click.option("--exposure", type=float, metavar="MS", help="Exposure of a row, with --scene.  [default: the scene's]")
@click.option(
    "--pace",
    type=click.Choice(["real", "max"]),
    default="real",
    show_default=True,
    help="Keep to the wall clock, and drop what nobody reads; or as fast as possible, waiting for the host.",
)
@click.option("--loop", is_flag=True, help="Go on for ever.")
@click.option("--truth", type=PATH, metavar="FILE.npz", help="Write the true angle of every row, to compare with.")
@click.option(
    "--speckle", type=float, metavar="CONTRAST", help="Speckle contrast, with --scene.  [default: the scene's]"
)
@click.option("--serial", default="0", metavar="HEX", help="Serial number of the card.  [default: none]")
@click.option("--seed", type=int, default=0, show_default=True, help="Of noise and speckle, with --scene.")
def main(**options: object) -> None:
    """The card without hardware: its gateware, compiled, with a world around it, on a pseudo-terminal.

    It waits for a host (magtrak-recv) before the first picture and ends when the last one is sent.
    """
    from . import fail

    try:
        from sim.errors import SimError
        from sim.run import run
    except ImportError as error:
        fail(f"this needs {error.name}, which a checkout has: clone the repository and run 'make setup' there.")
    try:
        run(**options)  # type: ignore[arg-type]
    except SimError as error:
        fail(str(error))
    except KeyboardInterrupt:
        raise SystemExit(130) from None
