"""Scans of the virtual card to validate, made as a user would make them: with ``magtrak-sim`` and ``magtrak-recv``."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ..errors import MagtrakError

COLOUR = """
[weight]
mix = [-0.5, 1.0, -0.5]
"""
"""The room's light is white and shades round things, which pulls the line: green less the others is without it."""


@dataclass(frozen=True)
class Recording:
    """What was recorded in a folder.

    Attributes
    ----------
    calibration : the scene's own, as an ideal calibration would find it
    clouds : by the card's own detector
    paper : by the paper's method: mean of the gated pixels, one bare encoder count for an image; None if not asked for
    picture, target : of the scene's boards; None if there are none
    """

    calibration: Path
    clouds: list[Path]
    paper: Path | None
    picture: Path | None
    target: Path | None


def record(
    scene: str,
    out: Path,
    *,
    scans: int = 1,
    paper: bool = True,
    boards: bool = False,
    log: IO[str] = sys.stdout,
) -> Recording:
    """Scan a ready-made scene with the virtual card; without ``scans`` only its boards are photographed.

    The commands, and what they say, go to ``log``.

    Raises
    ------
    MagtrakError
        This is no checkout, or a command failed; it has told why itself.
    """
    try:
        from sim.demo import CommandError, call, scan
    except ImportError as error:
        raise MagtrakError(
            f"the virtual card needs {error.name}, which a checkout has: clone the repository, run 'make setup' in it"
        ) from None
    try:
        out.mkdir(parents=True, exist_ok=True)
        calibration, settings, binary = out / "calibration.json", out / "scan.toml", out / "paper.toml"
        call(["python", "-m", "sim.scene", scene, "--calibration", f"{calibration}", "--settings", f"{settings}"], log)
        picture, target = (out / "board.png", out / "target.json") if boards else (None, None)
        if boards:
            call(["python", "-m", "sim.photo", scene, f"{picture}", "--target", f"{target}"], log)
        binary.write_text(settings.read_text() + '[peak]\ndetector = "binary"\n')
        settings.write_text(settings.read_text() + COLOUR)
        receive = ["magtrak-recv", "--calibration", f"{calibration}"]
        clouds = []
        for number in range(scans):
            clouds.append(out / f"scan{number + 1}.ply")
            card = ["magtrak-sim", "--scene", scene, "--pace", "max", "--seed", f"{number}"]
            scan(card, [*receive, "--settings", f"{settings}", "--output", f"{clouds[-1]}"], out / "card", log)
        beside = out / "paper.ply" if paper and scans else None
        if beside is not None:
            in_its_way = ["--settings", f"{binary}", "--angle", "bare", "--output", f"{beside}"]
            scan(["magtrak-sim", "--scene", scene, "--pace", "max"], [*receive, *in_its_way], out / "card", log)
    except CommandError as error:
        raise MagtrakError(f"{error} failed; what it said is above") from None
    except OSError as error:
        raise MagtrakError(f"the folder {out} can't be used: {error.strerror}") from None
    return Recording(calibration, clouds, beside, picture, target)
