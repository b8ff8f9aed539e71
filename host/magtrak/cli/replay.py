"""``magtrak replay``: a recording made into a cloud again."""

from pathlib import Path

import click

PATH = click.Path(path_type=Path)


@click.command()
@click.argument("recording", type=PATH, metavar="FILE.mcap")
@click.option("--output", type=PATH, metavar="FILE.ply", help="Where the cloud goes; without it, only a summary.")
@click.option("--calibration", type=PATH, metavar="FILE.json", help="Instead of the one that was used.")
@click.option("--picture", type=PATH, metavar="FILE.png", help="Also draw a picture of the cloud.")
@click.option("--min-quality", type=click.FloatRange(0, 1), metavar="Q", help="Instead of the one that was used.")
@click.option("--angle", type=click.Choice(["rows", "bare"]), help="Instead of the one that was used.")
def main(
    recording: Path,
    output: Path | None,
    calibration: Path | None,
    picture: Path | None,
    min_quality: float | None,
    angle: str | None,
) -> None:
    """Make the cloud of a recording anew: with the same calibration the same points, bit by bit.

    A recording that was cut short, because the program or the computer died, is repaired in its place first.
    """
    import sys

    from ..calibration import Calibration
    from ..errors import MagtrakError
    from ..receive import check_outputs, write_cloud
    from ..replay import RecordingError, Replay, open_recording
    from ..scan import Scan
    from ..summary import summary
    from . import fail

    try:
        if output is not None:
            check_outputs(output, picture)
        opened = open_recording(recording)
        if opened.cut is not None:
            print(f"magtrak: {recording} was cut short; repaired, {opened.cut} bytes given up", file=sys.stderr)
        if opened.damaged:
            print(f"magtrak: {recording} has {opened.damaged} damaged parts, left out", file=sys.stderr)
        if not opened.clock_hz:
            raise RecordingError(f"{recording} ends before the card was started: there is nothing in it to replay")
        scan = Scan(
            opened.calibration if calibration is None else Calibration.load(calibration),
            opened.clock_hz,
            bare=(angle or opened.card.get("angle")) == "bare",
            min_quality=float(opened.card.get("min_quality", 0)) if min_quality is None else min_quality,
        )
        run = Replay(opened)
        run.run(scan)
        comments = [f"recording {recording.name}", "camera frame, mm"]
        if run.time_zero is not None:
            comments.append(f"time 0 is {run.time_zero}")
        if output is not None:
            write_cloud(scan, output, picture, comments)
        print(summary(scan.counts, run.link, run.damaged_frames, None, 1.0))
    except MagtrakError as error:
        fail(str(error))
