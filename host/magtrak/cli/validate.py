"""``magtrak validate``: how good is it?"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from ..arrays import Records
    from ..validate.artefacts import Result
    from ..validate.virtual import Recording

PATH = click.Path(path_type=Path)
VIRTUAL = click.option(
    "--virtual", type=PATH, metavar="DIR", help="Record with the virtual card into this folder first."
)


@click.group()
def main() -> None:
    """Measure how good the scanner is: the paper's own tests, and artefacts of known size.

    Each test takes clouds as magtrak-recv writes them, or, with --virtual DIR, records what it needs with the virtual
    card first, and the paper's method on the same scene beside it. docs/validation.md explains the figures.
    """


def artefact(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of a test that wants clouds."""
    for option in (
        click.option("--picture", "drawing", type=PATH, metavar="FILE.png", help="Draw the residuals."),
        click.option("--scene", metavar="NAME|FILE.toml", help="Scene for --virtual, if not the usual one."),
        click.option("--scans", type=click.IntRange(1, 20), default=1, show_default=True, help="For --virtual."),
        VIRTUAL,
        click.argument("clouds", type=PATH, nargs=-1),
    ):
        command = option(command)
    return command


def boarded(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of a test that wants a picture of a board."""
    for option in (
        VIRTUAL,
        click.option("--target", type=PATH, metavar="FILE.json", help="What is printed on the board(s)."),
        click.option("--board-picture", type=PATH, metavar="FILE.png", help="The board(s), laser off."),
        click.option("--calibration", type=PATH, metavar="FILE.json", help="Of camera and laser."),
    ):
        command = option(command)
    return command


@main.command()
@artefact
def plane(clouds: tuple[Path, ...], **options: Any) -> None:
    """Flatness of the largest plane, and with several CLOUDS its repeatability."""
    from ..validate import artefacts

    _artefact("plane", clouds, artefacts.planes, "Plane", **options)


@main.command()
@artefact
@click.option("--radius", "radii", type=float, multiple=True, metavar="MM", help="Of each sphere, from left to right.")
@click.option("--distance", "distances", type=float, multiple=True, metavar="MM", help="From each to the next.")
def spheres(clouds: tuple[Path, ...], radii: tuple[float, ...], distances: tuple[float, ...], **options: Any) -> None:
    """Sizes, form errors and spacing of spheres (VDI/VDE 2634 part 2)."""
    from ..validate import artefacts

    if options["virtual"] is not None and not radii:
        radii, distances = (75.0, 75.0), (502.4938,)
    _needed("--radius", radii)
    _artefact("artefacts", clouds, lambda them: artefacts.spheres(them, radii, distances), "Spheres", **options)


@main.command()
@artefact
@click.option("--radius", type=float, metavar="MM", help="Nominal.")
def cylinder(clouds: tuple[Path, ...], radius: float | None, **options: Any) -> None:
    """Radius and form error of a cylinder."""
    from ..validate import artefacts

    size = 80.0 if radius is None and options["virtual"] is not None else radius
    _needed("--radius", size)
    _artefact("artefacts", clouds, lambda them: artefacts.cylinders(them, size or 0.0), "Cylinder", **options)


@main.command()
@artefact
@click.option("--height", type=float, metavar="MM", help="Nominal.")
def step(clouds: tuple[Path, ...], height: float | None, **options: Any) -> None:
    """Height of a step between two parallel planes."""
    from ..validate import artefacts

    size = 60.0 if height is None and options["virtual"] is not None else height
    _needed("--height", size)
    _artefact("artefacts", clouds, lambda them: artefacts.steps(them, size or 0.0), "Step", **options)


@main.command()
@artefact
@click.option("--radius", type=float, default=160.0, show_default=True, metavar="MM", help="Of the cylinder.")
@click.option(
    "--box", type=float, nargs=3, default=(380.0, 620.0, 300.0), show_default=True, metavar="X Y Z", help="Size."
)
def shapes(clouds: tuple[Path, ...], radius: float, box: tuple[float, float, float], **options: Any) -> None:
    """The paper's Example 2: a cylinder and a box, and whether their shapes are kept."""
    from ..validate import artefacts

    def test(them: "list[Records]") -> "Result":
        return artefacts.shapes(them[-1], radius, box)

    _artefact("default", clouds, test, "Example 2: a cylinder and a box", **options)


@main.command()
@boarded
def camera(**options: Any) -> None:
    """The paper's test of the camera (eq 11, Table 1): fix one coordinate of a point, recover two."""

    def test() -> "Result":
        from ..calibrate.detect import read_picture
        from ..calibration import Calibration
        from ..validate import boards, paper
        from ..validate.virtual import record

        folder = options["virtual"]
        if folder is not None:
            record("corner", folder, scans=0, boards=True)
            calibration, picture, target = _files(folder)
        else:
            calibration, picture, target = _given(options)
        read = read_picture(picture)
        return paper.camera_test(Calibration.load(calibration), read, boards.Target.load(target))

    _told(test, "Camera (eq 11): two coordinates of points, the third known", None)


@main.command()
@boarded
@click.argument("cloud", type=PATH, required=False)
def laser(cloud: Path | None, **options: Any) -> None:
    """The paper's test of the laser (eq 12): its angle by distances on a plane, and by the encoder."""
    _on_board(cloud, None, options, "laser", 0.0, "Laser (eq 12): angle by distances on a plane, and by the encoder")


@main.command()
@boarded
@click.argument("cloud", type=PATH, required=False)
@click.option("--angle", type=float, default=10.0, show_default=True, metavar="DEG", help="Of the slit.")
@click.option("--compare", type=PATH, metavar="FILE.ply", help="The same scan by the paper's method.")
def slit(cloud: Path | None, angle: float, compare: Path | None, **options: Any) -> None:
    """The paper's Example 1: one slit on a plane, reconstructed."""
    _on_board(cloud, compare, options, "slit", angle, "Example 1: a slit on a plane")


def _artefact(
    scene_name: str,
    clouds: tuple[Path, ...],
    test: "Callable[[list[Records]], Result]",
    title: str,
    *,
    virtual: Path | None,
    scans: int,
    scene: str | None,
    drawing: Path | None,
) -> None:
    from ..cloud.ply import read_ply
    from ..errors import MagtrakError

    def run() -> "Result":
        others: Path | None = None
        files = list(clouds)
        if virtual is not None:
            if clouds:
                raise MagtrakError("give either clouds or --virtual, which makes its own")
            recording = _recording(scene or scene_name, virtual, scans)
            files, others = recording.clouds, recording.paper
        if not files:
            raise MagtrakError("give at least one cloud (PLY), or --virtual DIR")
        found = test([read_ply(file) for file in files])
        return found if others is None else _beside(found, test, read_ply(others))

    _told(run, title, drawing)


def _recording(scene: str, folder: Path, scans: int) -> "Recording":
    from ..validate.virtual import record

    return record(scene, folder, scans=scans)


def _beside(found: "Result", test: "Callable[[list[Records]], Result]", cloud: "Records") -> "Result":
    """The same test on the paper's cloud, as a column of its own; where it fails on it, that is said."""
    from dataclasses import replace

    from ..errors import MagtrakError
    from ..validate.artefacts import Result

    try:
        others = test([cloud]).lines
    except MagtrakError as error:
        click.echo(f"by the paper's method the test can't be made: {error}", err=True)
        return found
    # In step: names repeat, and only repeatability, which one cloud has not, is left out of the other's lines.
    rest = iter(others)
    lines = [
        line if "repeatability" in line.what or "lean" in line.what else replace(line, other=next(rest).value)
        for line in found.lines
    ]
    return Result(lines, found.fits)


def _on_board(
    cloud: Path | None, compare: Path | None, options: dict[str, Any], which: str, angle: float, title: str
) -> None:
    def run() -> "Result":
        from math import radians

        from ..calibrate.detect import read_picture
        from ..calibration import Calibration
        from ..cloud.ply import read_ply
        from ..errors import MagtrakError
        from ..validate import boards, paper
        from ..validate.virtual import record

        file, other, folder = cloud, compare, options["virtual"]
        if folder is not None:
            if file is not None:
                raise MagtrakError("give either a cloud or --virtual, which makes its own")
            recording = record("metric", folder, boards=True, paper=which == "slit")
            file, other = recording.clouds[0], recording.paper
            files = _files(folder)
        else:
            files = _given(options)
        if file is None:
            raise MagtrakError("give a cloud (PLY) of the board, or --virtual DIR")
        calibration, picture, target = Calibration.load(files[0]), read_picture(files[1]), files[2]
        board = boards.Target.load(target)
        if which == "laser":
            return paper.laser_test(calibration, read_ply(file), picture, board)
        beside = None if other is None else read_ply(other)
        return paper.slit_test(calibration, read_ply(file), picture, board, radians(angle), beside)

    _told(run, title, None)


def _files(folder: Path) -> tuple[Path, Path, Path]:
    return folder / "calibration.json", folder / "board.png", folder / "target.json"


def _given(options: dict[str, Any]) -> tuple[Path, Path, Path]:
    from ..errors import MagtrakError

    for name in ("calibration", "board_picture", "target"):
        if options[name] is None:
            raise MagtrakError(f"--{name.replace('_', '-')} is needed, or --virtual DIR")
    return options["calibration"], options["board_picture"], options["target"]


def _needed(option: str, value: object) -> None:
    from . import fail

    if not value:
        fail(f"{option} is needed: the nominal size of the artefact in mm")


def _told(run: "Callable[[], Result]", title: str, drawing: Path | None) -> None:
    """Run a test, print its table, draw its picture; a user's mistake becomes one sentence."""
    from ..errors import MagtrakError
    from . import fail

    try:
        try:
            import scipy  # noqa: F401
        except ModuleNotFoundError:
            raise MagtrakError("validation needs SciPy and OpenCV: pip install 'magtrak[calib]'") from None
        found = run()
        from ..validate.report import table

        click.echo(table(found.lines, title))
        if drawing is not None and found.fits:
            from ..validate.picture import draw

            draw(found.fits, drawing, title)
    except MagtrakError as error:
        fail(str(error))
