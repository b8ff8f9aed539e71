"""``magtrak-recv``: receives a scan and writes the cloud."""

from pathlib import Path

import click

PATH = click.Path(path_type=Path)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="magtrak")
@click.option("--port", required=True, help="Serial port or serial number of the card, or the virtual card's link.")
@click.option("--calibration", required=True, type=PATH, metavar="FILE.json", help="Calibration of camera and laser.")
@click.option("--output", required=True, type=PATH, metavar="FILE.ply", help="Where the cloud goes.")
@click.option("--frames", type=click.IntRange(min=1), metavar="N", help="End after N frames.")
@click.option("--seconds", type=click.FloatRange(min=0), metavar="S", help="End after S seconds.")
@click.option(
    "--settings",
    default="green",
    show_default=True,
    metavar="NAME|FILE.toml",
    help="What the card is told: green or red, each with -daylight or -ambient if need be, paper, or a file.",
)
@click.option("--picture", type=PATH, metavar="FILE.png", help="Also draw a picture of the cloud.")
@click.option(
    "--min-quality",
    type=click.FloatRange(0, 1),
    default=0.0,
    show_default=True,
    metavar="Q",
    help="Leave out points of less quality.",
)
@click.option(
    "--angle",
    type=click.Choice(["rows", "bare"]),
    default="rows",
    show_default=True,
    help="The laser's angle: for each row, from the encoder's edges; or one bare count for each image.",
)
@click.option("--record", type=PATH, metavar="FILE.mcap", help="Also record everything the card sends.")
@click.option(
    "--reconnect",
    type=click.FloatRange(min=0),
    default=0.0,
    show_default=True,
    metavar="S",
    help="Wait S seconds for a card that goes away, then arm the laser and go on.",
)
@click.option("--baud", type=click.IntRange(min=1), default=3_000_000, show_default=True, help="Of a UART.")
def main(
    port: str,
    calibration: Path,
    output: Path,
    frames: int | None,
    seconds: float | None,
    settings: str,
    picture: Path | None,
    min_quality: float,
    angle: str,
    record: Path | None,
    reconnect: float,
    baud: int,
) -> None:
    """Receive a scan and write the cloud.

    Ends after N frames, S seconds, at the end of the stream or with Ctrl-C, and then writes the cloud in any case. The
    last line tells frames, points, lost frames, damaged packets and encoder errors.
    """
    from ..errors import MagtrakError
    from ..receive import Limits, receive
    from . import fail

    try:
        receive(
            port=port,
            baud=baud,
            calibration=calibration,
            settings=settings,
            output=output,
            picture=picture,
            limits=Limits(frames, seconds),
            min_quality=min_quality,
            bare=angle == "bare",
            record=record,
            reconnect_s=reconnect,
        )
    except MagtrakError as error:
        fail(str(error))
    except KeyboardInterrupt:
        fail("interrupted before the first frame; nothing was written")
