"""What a board under water shows, from the simulator's optics and noise, without pictures."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from magtrak.calibrate.board import Board
from magtrak.calibrate.observations import Lines, Observations, View
from magtrak.calibrate.session import write_lines
from sim.boards import BOARDS
from sim.scene import Scene
from sim.session import RANGES_MM, _place

CORNER_PX, COLUMN_PX = 0.05, 0.025


def board(name: str) -> Board:
    printed = BOARDS[name]
    return Board(
        name, "charuco", printed.columns, printed.rows, printed.square_mm, printed.marker_mm, band_mm=printed.band_mm
    )


def observe(scene: Scene, count: int, seed: int, lines: int = 3) -> Observations:
    """``count`` views of both boards, with ``lines`` still laser lines on each and the noise of a good detector."""
    rng = np.random.default_rng([seed, 5])
    views = []
    for number in range(count):
        name = "a3" if number % 2 else "large"
        printed = BOARDS[name]
        near, far = RANGES_MM[name]
        z = near + (far - near) * (number + rng.uniform()) / count
        pose, (low, high), _ = _place(scene, printed, z, int(rng.integers(12)), rng)
        corners = printed.corners()
        pixels = scene.project(corners @ pose[:3, :3].T + pose[:3, 3])
        ids = np.flatnonzero(np.all((pixels > 2) & (pixels < [637, 477]), axis=1))
        seen = pixels[ids] + rng.normal(0, CORNER_PX, (len(ids), 2))
        views.append(
            View(f"{number}", board(name), ids, seen, _lines(scene, printed, pose, (low, high), lines, number, rng))
        )
    return Observations(scene.camera.width, scene.camera.height, views, scene.counts_per_turn)


def _lines(scene: Scene, printed, pose: np.ndarray, span: tuple[float, float], count: int, number: int, rng) -> Lines:
    x0, y0, x1, y1 = printed.band_mm
    x, y = np.meshgrid(np.linspace(x0, x1, 121), np.linspace(y0 + 8, y1 - 8, 12))
    grid = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
    alpha = scene.lit_from(grid)[0].reshape(x.shape)
    parts = []
    for line, goal in enumerate(np.linspace(*span, count)):
        at = np.array([np.interp(goal, *_rising(alpha[row], x[row])) for row in range(len(y))])
        points = np.stack([at, y[:, 0], np.zeros(len(at))], axis=1) @ pose[:3, :3].T + pose[:3, 3]
        exact = scene.lit_from(points)[0]  # what interpolation left
        pixels = scene.project(points)
        counts = scene.laser.sense * (exact - scene.laser.zero_rad) * scene.counts_per_turn / (2 * np.pi)
        column = pixels[:, 0] + rng.normal(0, COLUMN_PX, len(at))
        image = np.full(len(at), number * count + line)
        parts.append(Lines(image, pixels[:, 1], column, counts, np.zeros(len(at))))
    return Lines(*(np.concatenate([getattr(part, name) for part in parts]) for name in Lines.__annotations__))


def _rising(alpha: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (alpha, x) if alpha[-1] > alpha[0] else (alpha[::-1], x[::-1])


def nominal(scene: Scene, seed: int):
    """Ports as somebody measures them with a rule."""
    from magtrak.calibration import Calibration

    rng = np.random.default_rng([seed, 6])
    true = Calibration.parse(scene.calibration()).ports
    assert true is not None

    def off(port):
        normal = port.normal + rng.normal(0, 0.02, 3)
        return replace(port, distance_mm=port.distance_mm + rng.normal(0, 3), normal=normal / np.linalg.norm(normal))

    return replace(
        true, camera=off(true.camera), laser=off(true.laser), apex_beam_mm=true.apex_beam_mm + rng.normal(0, 3),
        apex_axis_mm=true.apex_axis_mm + rng.normal(0, 3), water_index=true.water_index + rng.normal(0, 0.002),
    )  # fmt: skip


def write_session(folder: Path, seen: Observations) -> Path:
    """Observations as a session on disk, corners in files instead of pictures."""
    folder.mkdir()
    values = {
        "counts_per_turn": seen.counts_per_turn,
        "width": seen.width,
        "height": seen.height,
        "boards": {board.name: board.as_dict() for board in seen.boards},
        "views": [],
    }
    rows = []
    for number, view in enumerate(seen.views):
        name, lines = f"{number:02}.csv", view.lines
        text = "".join(f"{at},{u:.5f},{v:.5f}\n" for at, (u, v) in zip(view.ids, view.corners, strict=True))
        (folder / name).write_text("id,u,v\n" + text)
        entry = {"board": view.board.name, "corners": name, "frames": np.unique(lines.image).tolist()}
        values["views"].append(entry)
        for item in zip(lines.image, lines.row, lines.column, lines.counts, lines.rate, strict=True):
            rows.append((*item, 200, 6, ""))
    (folder / "session.json").write_text(json.dumps(values))
    write_lines(folder / "lines.csv", rows)
    return folder
