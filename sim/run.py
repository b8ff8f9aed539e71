"""Builds the virtual card that ``magtrak-sim``'s options ask for, and runs it."""

import signal
import sys
from pathlib import Path

import click

from .card import VirtualCard, World, clock_hz
from .core import library
from .errors import SimError
from .pattern import run_pattern
from .pictures import Pictures
from .playback import read_angles
from .scene import Scene
from .terminal import Terminal
from .timing import Timing
from .truth import TruthLog
from .worlds import PictureWorld, SceneWorld


def run(
    *,
    scene: str | None,
    pattern: bool,
    board: str | None,
    frames: Path | None,
    angles: Path | None,
    counts_per_turn: int,
    link: Path | None,
    frame_rate: float | None,
    row_time: float | None,
    exposure: float | None,
    pace: str,
    loop: bool,
    truth: Path | None,
    speckle: float | None,
    seed: int,
    serial: str,
) -> None:
    """Options as in ``magtrak-sim --help``; :exc:`SimError` where they can't be."""
    log: TruthLog | None = None
    world: World
    try:
        number = int(serial, 16)
    except ValueError:
        number = -1
    if not 0 <= number < 2**64:
        raise SimError(f"--serial {serial} has to be a hexadecimal number of up to 16 digits.")
    if (scene is not None) + (frames is not None) + pattern != 1:
        raise SimError("Give either --scene NAME, or --frames DIR with --angles FILE.csv, or --pattern.")
    if pattern:
        for name, value in (
            *(("--angles", angles), ("--frame-rate", frame_rate), ("--row-time", row_time), ("--exposure", exposure)),
            *(("--truth", truth), ("--speckle", speckle)),
        ):
            if value is not None:
                raise SimError(f"{name} does not go with --pattern: the picture is the card's own.")
        run_pattern(link, number, board or "", real_time=pace == "real")
        return
    if scene is not None:
        if angles is not None:
            raise SimError("--angles goes with --frames: a scene has a motor of its own.")
        what = Scene.load(scene).override(frame_rate, row_time, exposure, speckle)
        clock = clock_hz(what.camera.width, what.timing)
        log = TruthLog(what) if truth is not None else None
        world = SceneWorld(what, log, seed)
    else:
        assert frames is not None
        if angles is None:
            raise SimError("--frames needs --angles FILE.csv: the angle of the laser at each picture.")
        for name, value in (("--exposure", exposure), ("--truth", truth), ("--speckle", speckle)):
            if value is not None:
                raise SimError(f"{name} goes with --scene: pictures from files are as they are.")
        if counts_per_turn < 4 or counts_per_turn % 4:
            raise SimError(f"--counts-per-turn {counts_per_turn} has to be a positive multiple of 4.")
        pictures = Pictures(frames)
        timing = Timing(pictures.height, 50.0 if frame_rate is None else frame_rate, row_time and row_time * 1e-6)
        clock = clock_hz(pictures.width, timing)
        world = PictureWorld(pictures, read_angles(angles, len(pictures)), timing, counts_per_turn, clock)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the link goes when the card is told to end
    compiled = library(None, board or "")  # before the port appears: a host that opens it gets answers
    terminal = Terminal(link)
    try:
        card = VirtualCard(world, terminal, clock, compiled, real_time=pace == "real", serial=number)
        click.echo(
            f"virtual card on {terminal.name}: {world.width} x {world.height}, {world.frames} pictures", err=True
        )
        try:
            card.run(loop)
        finally:
            card.close()
            if log is not None and truth is not None:
                log.save(truth)
    finally:
        terminal.close()
