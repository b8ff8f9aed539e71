"""A calibration session: somebody holds a board before the rig, again and again, at rest each time.

``python -m sim.session OUT [--scene NAME] [--board a3|large|both] [--views N] [--frames N] [--seed S]``

For every view there is a picture in the light of the room with the laser off, and a few pictures of the laser's line on
the board while the motor turns steadily, forward in one view and backward in the next. OUT then holds

``pictures/NNN.png``
    the board, one picture for each view
``laser/NNNNN.png`` and ``angles.csv``
    for ``magtrak-sim --frames OUT/laser --angles OUT/angles.csv`` with the frame rate in ``session.json``
``session.json``
    what whoever calibrates knows: the boards, and which picture and which frames belong to which view
``truth/truth.json``
    what nobody knows: the calibration, and the boards' poses

Each view begins and ends with a dark picture, in which the motor gets up to speed and leaves; their numbers are not
among the view's frames.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt

from .boards import BOARDS, Board
from .errors import SimError
from .parts import Object, pose_of
from .photo import photo
from .playback import HEADER
from .render import Renderer
from .scene import Scene
from .surfaces import Floats, visible
from .timing import Timing

FRAME_RATE_HZ = 20.0
EXPOSURE_S = 1e-3
ROOM = (225.0, 225.0, 220.0)
"""Grey levels of white paper in the pictures of the board."""

PAPER = (0.86, 0.86, 0.84)
SPEED_RAD_S = np.radians(60)
"""At most, for the motor."""

RANGES_MM = {"a3": (550.0, 1300.0), "large": (1200.0, 3000.0)}
TILT_RAD = np.radians(38)
ROLL_RAD = np.radians(15)


@dataclass(frozen=True)
class View:
    """What is seen of one pose of a board.

    Members
    -------
    board : name of the board in :data:`BOARDS`
    pose : (4, 4) from the board's frame to the camera's: the truth
    picture : (height, width, 3), laser off
    frames : (n, height, width, 3), with the laser; the first and the last are dark
    angles_rad : (n, 2) the motor's angle at the first and at the last row of each frame
    """

    board: str
    pose: Floats
    picture: npt.NDArray[np.uint8]
    frames: npt.NDArray[np.uint8]
    angles_rad: Floats


def timing_of(scene: Scene) -> Timing:
    """Timing of the frames with the laser."""
    return Timing(scene.camera.height, FRAME_RATE_HZ, None, EXPOSURE_S, scene.timing.readout_delay_s)


def with_board(scene: Scene, board: Board, pose: Floats) -> Scene:
    """The scene with a board in front of what else is there."""
    item = Object(board.panel(pose), PAPER, board)
    return replace(scene, timing=timing_of(scene), objects=(item, *scene.objects))


def views(scene: Scene, boards: list[str], lit: int = 4, seed: int = 0) -> Iterator[View]:
    """A view for each board named in ``boards``, at a random pose, with ``lit`` pictures of the laser's line.

    The poses fill the picture: the boards' middles lie in the cells of a grid, the distances in steps, in random order.

    Raises
    ------
    SimError : no pose was found at which laser and camera both see the board
    """
    random = np.random.default_rng([seed, 71])
    cells = random.permutation(max(len(boards), 12))
    steps = random.permutation(len(boards))
    for number, name in enumerate(boards):
        near, far = RANGES_MM[name]
        z = near * (far / near) ** ((steps[number] + random.uniform()) / len(boards))
        pose, (low, high), row = _place(scene, BOARDS[name], z, int(cells[number]), random)
        timing = timing_of(scene)
        span = min(high - low, SPEED_RAD_S * timing.period_s * (lit - 1))
        first = random.uniform(low, high - span)
        # The dark pictures continue the steady movement to both sides. The angles are wanted when the band is exposed.
        step = span / (lit - 1)
        alpha = first + step * (np.arange(-1, lit + 1))
        alpha = alpha if number % 2 == 0 else alpha[::-1]
        alpha = alpha - (alpha[1] - alpha[0]) * row * timing.row_period_s / timing.period_s
        motor = (alpha - scene.laser.zero_rad) * scene.laser.sense
        yield _shoot(scene, name, pose, motor, seed * 100_003 + number)


def _place(
    scene: Scene, board: Board, z: float, cell: int, random: np.random.Generator
) -> tuple[Floats, tuple[float, float], float]:
    """A pose at about that distance whose board is in the picture; the angles between which the line crosses its band,
    and the row of the picture where it does.
    """
    camera = scene.camera
    middle = np.array([board.columns, board.rows, 0]) * board.square_mm / 2
    size = np.array([camera.width, camera.height])
    for attempt in range(400):
        at = (np.array([cell % 4, cell // 4 % 3]) + random.uniform(0, 1, 2)) / (4, 3)
        start, ray = (np.atleast_2d(part)[0] for part in scene.sight(camera.rays(*(at * size)[:, None])))
        axis = random.uniform(0, 2 * np.pi)
        tilt = random.uniform(0.3, 1) * TILT_RAD * np.array([np.cos(axis), np.sin(axis), 0.0])
        pose = pose_of((0, 0, 0), tilt) @ pose_of((0, 0, 0), np.array([0, 0, random.uniform(-ROLL_RAD, ROLL_RAD)]))
        pose[:3, 3] = start + ray * z / ray[2] - pose[:3, :3] @ middle
        corners = board.corners() @ pose[:3, :3].T + pose[:3, 3]
        seen = scene.project(corners)
        inside = np.mean(np.all((seen > 3) & (seen < size - 4), axis=1))
        crossing = _crossing(scene, board, pose)
        if inside > 0.7 and crossing is not None:
            return pose, *crossing
        if attempt % 40 == 39:
            cell = int(random.integers(12))
    raise SimError(f"no place for a board of {board.size_mm[0]:.0f} mm was found at {z:.0f} mm; take another scene")


def _crossing(scene: Scene, board: Board, pose: Floats) -> tuple[tuple[float, float], float] | None:
    """Angles between which the line crosses the blank band in the camera's sight, and the band's middle row; None where
    it does not.
    """
    x0, y0, x1, y1 = board.band_mm
    x, y = np.meshgrid(np.linspace(x0, x1, 41), np.linspace(y0 + 0.2 * (y1 - y0), y1 - 0.2 * (y1 - y0), 5))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
    seen = scene.project(points)
    alpha, _, source = scene.lit_from(points)
    good = np.all((seen > 12) & (seen < np.array([scene.camera.width, scene.camera.height]) - 13), axis=1)
    towards = np.sum((points - source) * pose[:3, 2], axis=1)
    good &= (towards > 0.35 * np.linalg.norm(points - source, axis=1)) & (points @ pose[:3, 2] > 0)
    good &= visible([board.panel(pose)], source, points)
    columns = good.reshape(x.shape).mean(axis=0) > 0.5
    if columns.sum() < 16:
        return None
    middle = alpha.reshape(x.shape)[2][columns]
    row = float(seen.reshape(*x.shape, 2)[2, columns, 1].mean())
    return (float(np.percentile(middle, 6)), float(np.percentile(middle, 94))), row


def _shoot(scene: Scene, name: str, pose: Floats, motor: Floats, seed: int) -> View:
    there = with_board(scene, BOARDS[name], pose)
    timing = there.timing
    rows_s = (timing.height - 1) * timing.row_period_s
    speed = (motor[1] - motor[0]) / timing.period_s
    renderer = Renderer(there, seed)
    frames = []
    for frame, start in enumerate(motor):
        times = timing.rows(0.0)
        lit = 0 < frame < len(motor) - 1
        frames.append(renderer.rows(frame, 0, timing.height, times, _steady(float(start), float(speed)), lit))
    angles = np.stack([motor, motor + speed * rows_s], axis=1)
    return View(name, pose, photo(there, seed, ROOM), np.array(frames), angles)


def _steady(start: float, speed: float) -> Any:
    return lambda times: start + speed * np.asarray(times)


def write(out: Path, scene: Scene, boards: list[str], lit: int, seed: int) -> None:
    """Make a session in a folder; see the module.

    Raises
    ------
    SimError : it can't be written
    """
    from PIL import Image

    timing = timing_of(scene)
    known: dict[str, Any] = {
        "frame_rate_hz": timing.frame_rate_hz,
        "row_time_us": timing.row_period_s * 1e6,
        "counts_per_turn": scene.counts_per_turn,
        "boards": {name: BOARDS[name].describe() for name in dict.fromkeys(boards)},
        "views": [],
    }
    calibration = scene.calibration()
    calibration["camera"]["time_offset_s"] = timing.offset_s
    truth: dict[str, Any] = {"calibration": calibration, "poses": []}
    lines = [",".join(HEADER)]
    try:
        for folder in ("pictures", "laser", "truth"):
            (out / folder).mkdir(parents=True, exist_ok=True)
        for number, view in enumerate(views(scene, boards, lit, seed)):
            picture = f"pictures/{number:03}.png"
            Image.fromarray(view.picture).save(out / picture)
            first = len(lines) - 1
            for frame, (start, end) in zip(view.frames, view.angles_rad, strict=True):
                Image.fromarray(frame).save(out / f"laser/{len(lines) - 1:05}.png")
                lines.append(f"{len(lines) - 1},{np.degrees(start):.9f},{np.degrees(end):.9f}")
            frames = list(range(first + 1, len(lines) - 2))
            known["views"].append({"board": view.board, "picture": picture, "frames": frames})
            truth["poses"].append(view.pose.tolist())
        (out / "angles.csv").write_text("\n".join(lines) + "\n")
        (out / "session.json").write_text(json.dumps(known, indent=1) + "\n")
        (out / "truth" / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    except OSError as error:
        raise SimError(f"the session {out} can't be written: {error.strerror}") from error


@click.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option("--scene", "name", default="rig", show_default=True, help="Rig and background.")
@click.option("--board", type=click.Choice([*BOARDS, "both"]), default="both", show_default=True)
@click.option("--views", "count", type=click.IntRange(1, 500), default=30, show_default=True)
@click.option("--frames", "lit", type=click.IntRange(2, 50), default=4, show_default=True, help="Lit, of each view.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of poses, noise and speckle.")
def main(out: Path, name: str, board: str, count: int, lit: int, seed: int) -> None:
    """Make the pictures of a calibration session in the folder OUT."""
    boards = [board] * count if board != "both" else ["a3"] * (count - count // 2) + ["large"] * (count // 2)
    try:
        write(out, Scene.load(name), boards, lit, seed)
    except SimError as error:
        raise click.ClickException(str(error)) from None


if __name__ == "__main__":
    main()
