"""``magtrak calibrate``: boards, camera, laser, everything; looks at and checks calibrations."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ..calibrate.board import Board
    from ..calibrate.procedure import Result
    from ..calibrate.session import Session

PATH = click.Path(path_type=Path)
HELP = {"help_option_names": ["-h", "--help"]}


@click.group(context_settings=HELP)
def main() -> None:
    """Calibrate camera and laser, look at a calibration, check it.

    docs/calibration.md leads through it: print two boards, show them at least 30 times at 0.4 to 3 m, three laser lines
    each, then 'magtrak calibrate joint SESSION --output calibration.json'.
    """


@contextmanager
def _sentences(*, needs: bool = True) -> Iterator[None]:
    """What a user can mend, in one sentence."""
    from ..calibrate import require
    from ..errors import MagtrakError
    from . import fail

    try:
        if needs:
            require()
        yield
    except MagtrakError as error:
        fail(str(error))


@main.command(context_settings=HELP)
@click.argument("output", type=PATH)
@click.option(
    "--name", default="a3", show_default=True, help="a3, large, or a name of your own with the options below."
)
@click.option("--pattern", type=click.Choice(["charuco", "chessboard"]))
@click.option("--columns", type=int, help="Squares.")
@click.option("--rows", type=int, help="Squares.")
@click.option("--square", "square_mm", type=float, metavar="MM", help="Side of a square.")
@click.option("--marker", "marker_mm", type=float, metavar="MM", help="Side of a marker.")
@click.option("--dictionary", help="Of the markers, OpenCV's name.")
@click.option("--band", "band_mm", type=float, metavar="MM", help="Height of the blank band below the squares.")
def board(output: Path, name: str, **changes: object) -> None:
    """Print a board to OUTPUT, a .pdf or .png file."""
    with _sentences():
        from ..calibrate.printing import page_mm, write_board

        what = _board(name, changes)
        write_board(what, output)
        width, height = page_mm(what)
        print(
            f"{output}: board {what.name}, {width:.0f} x {height:.0f} mm; print it at 100 % and measure the scale bar"
        )


@main.command(context_settings=HELP)
@click.argument("source", type=PATH)
@click.option("--output", required=True, type=PATH, metavar="FILE.json")
@click.option(
    "--board", "name", default="a3", show_default=True, help="Where SOURCE is a folder of pictures: a3, large."
)
@click.option("--square", "square_mm", type=float, metavar="MM", help="Its square, as measured.")
@click.option("--marker", "marker_mm", type=float, metavar="MM")
@click.option("--columns", type=int)
@click.option("--rows", type=int)
@click.option("--pattern", type=click.Choice(["charuco", "chessboard"]))
@click.option("--dictionary")
@click.option("--legacy/--no-legacy", default=None, help="Pattern of OpenCV before 4.6.")
@click.option("--pairs", is_flag=True, help="SOURCE is a CSV of x,y,z,u,v: the paper's linear model.")
@click.option("--size", type=(int, int), metavar="W H", help="Of the picture, px, for --pairs.")
@click.option("--laser-from", type=PATH, metavar="FILE.json", help="Keep the laser of this calibration.")
@click.option("--picture", type=PATH, metavar="FILE.png", help="Draw coverage and residuals.")
def camera(
    source: Path,
    output: Path,
    name: str,
    pairs: bool,
    size: tuple[int, int] | None,
    laser_from: Path | None,
    picture: Path | None,
    **changes: object,
) -> None:
    """Calibrate the camera from SOURCE: a session, a folder of pictures of one board, or point pairs."""
    with _sentences():
        from ..calibrate import procedure, session
        from ..calibration import Calibration

        previous = None if laser_from is None else Calibration.load(laser_from)
        if pairs:
            _linear(source, output, size, previous)
            return
        if (source / "session.json").exists():
            taken = session.load(source)
        else:
            taken = session.of_pictures(source, _board(name, changes))
        _finish(procedure.calibrate_camera(taken, previous), output, picture)


@main.command(context_settings=HELP)
@click.argument("source", type=PATH, metavar="SESSION")
@click.option("--output", required=True, type=PATH, metavar="FILE.json")
@click.option("--calibration", type=PATH, metavar="FILE.json", help="An earlier one: its error table is the start.")
@click.option("--measured-mm", type=float, metavar="MM", help="Distance of the laser's axis from the camera, by hand.")
@click.option("--picture", type=PATH, metavar="FILE.png", help="Draw coverage and residuals.")
def joint(
    source: Path, output: Path, calibration: Path | None, measured_mm: float | None, picture: Path | None
) -> None:
    """Calibrate camera, laser, encoder and time together from a SESSION. This is the way."""
    with _sentences():
        from ..calibrate import procedure
        from ..calibration import Calibration

        previous = None if calibration is None else Calibration.load(calibration)
        _finish(procedure.calibrate_joint(_session(source), previous, measured_mm), output, picture)


@main.command(context_settings=HELP)
@click.argument("source", type=PATH, metavar="[SESSION]", required=False)
@click.option("--calibration", required=True, type=PATH, metavar="FILE.json", help="Has the camera.")
@click.option("--output", required=True, type=PATH, metavar="FILE.json")
@click.option("--zero-only", is_flag=True, help="Renew the zero alone; a wall or one pose of the board will do.")
@click.option(
    "--measured",
    type=(float, float, float, float),
    metavar="X Y Z ZERO_DEG",
    help="No session: by hand, as in the paper. The axis' place in the camera's frame, mm, axis down; zero, degrees.",
)
@click.option("--sense", type=click.Choice(["1", "-1"]), default="1", show_default=True, help="For --measured.")
@click.option("--counts-per-turn", type=int, default=8192, show_default=True, help="For --measured.")
def laser(
    source: Path | None,
    calibration: Path,
    output: Path,
    zero_only: bool,
    measured: tuple[float, float, float, float] | None,
    sense: str,
    counts_per_turn: int,
) -> None:
    """Calibrate the laser with a camera that is known and held."""
    with _sentences(needs=measured is None):
        from dataclasses import replace

        from ..calibration import Calibration
        from ..errors import CalibrationError

        known = Calibration.load(calibration)
        if measured is not None:
            from ..calibrate.measured import measured_laser

            replace(known, laser=measured_laser(measured, int(sense), counts_per_turn)).save(output)
            print(f"{output}: the laser as measured by hand; about 10 mm at 2 m is what to expect of it")
            return
        if source is None:
            raise CalibrationError("give a SESSION, or --measured X Y Z ZERO_DEG")
        from ..calibrate import procedure

        _finish(procedure.calibrate_laser(_session(source), known, zero_only=zero_only), output, None)


@main.command(context_settings=HELP)
@click.argument("source", type=PATH, metavar="SESSION")
@click.option("--calibration", required=True, type=PATH, metavar="FILE.json", help="Camera and laser, made in air.")
@click.option(
    "--measured", type=PATH, metavar="FILE.json", help="Ports as measured by rule; without it, those of --calibration."
)
@click.option("--output", required=True, type=PATH, metavar="FILE.json")
def ports(source: Path, calibration: Path, measured: Path | None, output: Path) -> None:
    """Find the panes before camera and laser from a SESSION under water; camera and laser stay as in air."""
    with _sentences():
        from ..calibrate import report, underwater
        from ..calibration import Calibration
        from ..errors import CalibrationError

        known = Calibration.load(calibration)
        nominal = known.ports if measured is None else underwater.read_nominal(measured)
        if nominal is None:
            raise CalibrationError(
                f'{calibration} has no ports: measure panes and laser with a rule, and give --measured with "ports" as'
                " docs/validation.md shows"
            )
        result = underwater.calibrate_under_water(_session(source), known, nominal)
        result.calibration.save(output)
        print(report.describe(result.calibration))
        fit = result.found
        print(f"left      corners {fit.corner_rms_px:.3f} px, rows {fit.line_rms_px:.3f} px under water")
        for item in result.findings:
            print(f"warning: {item}")
        print(f"written to {output}")


@main.command(context_settings=HELP)
@click.argument("source", type=PATH, metavar="SESSION")
@click.option("--port", required=True, help="Serial port of the card, or the virtual card's link.")
@click.option("--settings", default="green", show_default=True, metavar="NAME|FILE.toml", help="As for magtrak-recv.")
@click.option("--view", metavar="PICTURE", help="The lines belong to this view; without it, session.json says so.")
@click.option("--frames", type=click.IntRange(min=1), metavar="N", help="End after N frames.")
@click.option("--baud", type=click.IntRange(min=1), default=3_000_000, show_default=True)
def lines(source: Path, port: str, settings: str, view: str | None, frames: int | None, baud: int) -> None:
    """Take laser lines from a card into SESSION/lines.csv: rows and angles, as the card measures them."""
    with _sentences(needs=False):
        from ..calibrate.capture import take_lines
        from ..settings_file import load_settings

        count, rows = take_lines(source, port, load_settings(settings), baud=baud, frames=frames, view=view)
        print(f"{source / 'lines.csv'}: {count} frames, {rows} rows")


@main.command(context_settings=HELP)
@click.argument("calibration", type=PATH)
@click.option("--ros", type=PATH, metavar="FILE.yaml", help="Also write camera_info for ROS.")
def show(calibration: Path, ros: Path | None) -> None:
    """Show what a calibration file holds, with sigmas where it has them."""
    with _sentences(needs=False):
        from ..calibrate.report import describe
        from ..calibration import Calibration

        known = Calibration.load(calibration)
        print(describe(known))
        if ros is not None:
            from ..calibrate.ros import save

            save(known, ros)


@main.command(context_settings=HELP)
@click.argument("source", type=PATH)
@click.option("--calibration", required=True, type=PATH, metavar="FILE.json")
@click.option(
    "--board", "name", default="a3", show_default=True, help="Where SOURCE is a picture or folder of pictures."
)
@click.option("--square", "square_mm", type=float, metavar="MM")
@click.option("--marker", "marker_mm", type=float, metavar="MM")
def check(source: Path, calibration: Path, name: str, **changes: object) -> None:
    """Is this calibration still good? SOURCE is one picture of the board, a folder, or a session with laser lines.

    Exit status 1 where it is not.
    """
    with _sentences():
        from ..calibrate import drift, session
        from ..calibration import Calibration

        if (source / "session.json").exists():
            taken = session.load(source)
        else:
            taken = session.of_pictures(source, _board(name, changes))
        found = drift.drift(taken, Calibration.load(calibration))
        print(f"corners lie {found.corner_px:.3f} px from where the calibration has them")
        print(f"focal length differs by {100 * found.focal:+.2f} +- {100 * found.focal_sigma:.2f} %")
        if found.focal_sigma > drift.FOCAL:
            print("so little tells a changed focal length or scale badly: tilt the board more, or give more pictures")
        if found.line_px == found.line_px:
            print(f"laser lines lie {found.line_px:+.3f} px from where the calibration has them")
        else:
            print("no laser line: only the camera was checked")
        for item in found.findings:
            print(f"magtrak calibrate: {item}", file=sys.stderr)
        if found.findings:
            raise SystemExit(1)
        print("still good")


def _session(source: Path) -> Session:
    from ..calibrate.session import load

    return load(source)


def _board(name: str, changes: dict[str, object]) -> Board:
    from dataclasses import replace

    from ..calibrate.board import A3, BOARDS

    given = {key: value for key, value in changes.items() if value is not None}
    base = BOARDS.get(name, A3)
    band = given.pop("band_mm", None)
    if given.get("pattern") == "chessboard":
        given.setdefault("marker_mm", 0.0)
    elif "square_mm" in given and "marker_mm" not in given:
        given["marker_mm"] = base.marker_mm * float(str(given["square_mm"])) / base.square_mm
    result = replace(base, name=name, **given)  # type: ignore[arg-type]
    if given or band is not None:
        # The band goes with the pattern's size; its sides and height stay.
        width, height = result.size_mm
        old = base.band_mm or (0.0, 0.0, 0.0, 45.0)
        deep = float(str(band)) if band is not None else old[3] - old[1]
        side = -old[0]
        result = replace(result, band_mm=(-side, height, width + side, height + deep) if deep else None)
    return result


def _finish(result: Result, output: Path, picture: Path | None) -> None:
    from ..calibrate import report

    result.calibration.save(output)
    print(report.describe(result.calibration))
    print(report.views_text(result))
    for item in result.findings:
        print(f"warning: {item}")
    if picture is not None:
        report.draw(result, picture)
    print(f"written to {output}")


def _linear(source: Path, output: Path, size: tuple[int, int] | None, previous: object) -> None:
    from ..calibrate.measured import linear_calibration
    from ..errors import CalibrationError

    if size is None:
        raise CalibrationError("--pairs needs --size W H: the picture's size in px")
    calibration, text = linear_calibration(source, size, previous)
    calibration.save(output)
    print(text)
    print(f"written to {output}")
