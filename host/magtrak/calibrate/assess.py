"""Judges observations and fits: what is refused, what is worth a warning, and the likely cause of large residuals.

A cause is looked for by freeing one more parameter at a time (the board's bend, a jump of the laser's zero between two
views ...), to first order, and taking the one that explains most of the residuals: Rao's score test.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..arrays import Floats
from ..errors import CalibrationError
from . import score
from .findings import Finding, finding, refuse
from .joint import Estimates, estimate_laser
from .observations import Lines, Observations
from .rig import Predictions, Rig
from .solve import Solution, Solver

MIN_VIEWS = 8
MIN_TILT_DEG = 8.0
MIN_IMAGES = 9
MIN_ANGLE_DEG = 3.0
MIN_DEPTH = 1.25
WALL_DEG, WALL_PART = 3.0, 0.03
DISTANCES_MM = (60.0, 20_000.0)
CORNER_PX, LINE_PX = 0.4, 0.3
ANGLE_COUNTS = 0.25
BAD_VIEW, BAD_PX = 4.0, 0.05
"""A view is bad where its corners are so many times as far off as those of most, and not below so many px."""

GAIN = 40.0
"""Chi squared that a cause must explain: more than six sigma."""

COUNT_FACTORS = (4.0, 2.0, 0.5, 0.25)


def before_camera(seen: Observations) -> list[Finding]:
    """What corners alone tell."""
    if len(seen.views) < MIN_VIEWS:
        raise refuse("few-views", views=len(seen.views), needed=MIN_VIEWS, more=MIN_VIEWS - len(seen.views))
    corners = np.concatenate([view.corners for view in seen.views])
    x, y = corners[:, 0] / (seen.width - 1), corners[:, 1] / (seen.height - 1)
    bare = []
    for name, low, high in (("upper left", 0, 0), ("upper right", 1, 0), ("lower left", 0, 1), ("lower right", 1, 1)):
        if not ((np.abs(x - low) < 0.25) & (np.abs(y - high) < 0.25)).any():
            bare.append(f"the {name} corner")
    return [finding("uncovered", where=" and ".join(bare))] if bare else []


def after_camera(seen: Observations, found: Solution) -> list[Finding]:
    """What the fit of camera and poses tells."""
    rig = found.rig
    distance = np.linalg.norm(rig.translations, axis=1)
    for number, board in enumerate(seen.boards):
        mine = [i for i, view in enumerate(seen.views) if view.board.name == board.name]
        middle = float(np.median(distance[mine]))
        if not DISTANCES_MM[0] < middle < DISTANCES_MM[1]:
            text = f"{middle:.2g} mm" if middle < 1000 else f"{middle / 1000:.0f} m"
            raise refuse("scale", board=seen.boards[number].name, distance=text, square=board.square_mm)
    tilt = _spread_deg(rig.rotations[:, :, 2])
    if tilt < MIN_TILT_DEG:
        raise refuse("no-tilt", degrees=MIN_TILT_DEG)
    return [*_bad_views(seen, found), *_camera_cause(seen, found)]


def before_laser(seen: Observations, rig: Rig, timed: bool) -> list[Finding]:
    """What the lines and the boards' poses tell, before a laser is fitted."""
    if not seen.images:
        raise refuse("no-lines")
    if seen.images < MIN_IMAGES:
        raise refuse("few-lines", images=seen.images, needed=MIN_IMAGES)
    at = Predictions(seen)
    views = np.unique(at.line_view)
    normals = rig.rotations[views, :, 2]
    offsets = np.einsum("vi,vi->v", normals, rig.translations[views])
    points = at.on_board(rig, at.model(rig).ray(at.column, at.row))
    near, far = np.percentile(points[:, 2], [2, 98])
    if _spread_deg(normals) < WALL_DEG and np.ptp(offsets) < WALL_PART * np.abs(offsets).mean():
        raise refuse("wall", degrees=WALL_DEG, mm=float(np.ptp(offsets)))
    if far < MIN_DEPTH * near:
        raise refuse("shallow", near=float(near), far=float(far))
    spread = float(np.ptp(at.counts)) * 360 / seen.counts_per_turn
    if spread < MIN_ANGLE_DEG:
        raise refuse("few-angles", degrees=spread)
    return [] if timed else [finding("one-way")]


def after_laser(seen: Observations, camera: Solution, stepwise: Solution) -> None:
    """Refuses what fits no swept plane, and says so where other counts per turn would."""
    if stepwise.noise.line < 3 * LINE_PX and stepwise.noise.angle < 3e-4 * seen.counts_per_turn:
        return
    for factor in COUNT_FACTORS:
        other = replace(seen, counts_per_turn=round(seen.counts_per_turn * factor))
        try:
            better = estimate_laser(other, camera)
        except CalibrationError:
            continue
        if better.noise.line < 0.3 * stepwise.noise.line or (
            better.noise.line < 1.2 * stepwise.noise.line and better.noise.angle * factor < 0.1 * stepwise.noise.angle
        ):
            raise refuse("counts-per-turn", found=other.counts_per_turn, given=seen.counts_per_turn)
    if stepwise.noise.line >= 3 * LINE_PX:
        raise refuse("not-turning", px=stepwise.noise.line)


def after_joint(estimates: Estimates) -> list[Finding]:
    """What the joint fit tells."""
    found, seen = estimates.joint, estimates.seen
    if found is None:
        return []
    findings = [*_moved_boards(seen, found), *_laser_cause(seen, found)]
    if found.noise.angle > ANGLE_COUNTS and not findings:
        findings.append(finding("angles-noisy", counts=found.noise.angle))
    if found.noise.line > LINE_PX:
        findings.append(finding("lines-noisy", px=found.noise.line))
    return findings


def against_measured(found: Solution, seen: Observations, measured_mm: float) -> list[Finding]:
    """The distance of the laser's axis from the camera beside a hand measurement: the only check of a wrong square."""
    assert found.rig.laser is not None
    baseline = float(np.linalg.norm(found.rig.laser.camera_from_laser[:3, 3]))
    if abs(baseline / measured_mm - 1) < 0.04:
        return []
    square = seen.boards[0].square_mm
    return [
        finding("baseline", found=baseline, measured=measured_mm, square=square * measured_mm / baseline, given=square)
    ]


def _spread_deg(normals: Floats) -> float:
    """Greatest angle between two of the directions."""
    return float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1, 1))))


def _view_rms(seen: Observations, found: Solution) -> Floats:
    owner = np.repeat(np.arange(len(seen.views)), [len(view.ids) for view in seen.views])
    square = np.bincount(owner, np.sum(found.corners**2, axis=1) / 2, len(seen.views))
    return np.asarray(np.sqrt(square / np.bincount(owner, minlength=len(seen.views))))


def _bad_views(seen: Observations, found: Solution) -> list[Finding]:
    rms = _view_rms(seen, found)
    usual = float(np.median(rms))
    findings = []
    if usual > CORNER_PX:
        findings.append(finding("corners-noisy", px=usual))
    for number in np.flatnonzero(rms > max(BAD_VIEW * usual, BAD_PX)):
        findings.append(finding("bad-view", view=seen.views[int(number)].name, times=rms[number] / usual))
    return findings


def _camera_cause(seen: Observations, found: Solution) -> list[Finding]:
    solver = Solver(seen_without_lines(seen), frozenset({"k3"}) if found.rig.camera[8] == 0 else frozenset())
    at = solver.predictions
    columns: dict[str, Floats] = {}
    texts: dict[str, Callable[[float], Finding | None]] = {}
    for number, board in enumerate(seen.boards):
        mine = at.board_of_view[at.corner_view] == number
        width, height = board.size_mm
        xy = at.corner_at - np.array([width, height]) / 2
        for name, along in (("across", xy[:, 0] / width * 2), ("down", xy[:, 1] / height * 2)):
            lift = np.zeros((len(xy), 3))
            lift[mine, 2] = (along**2)[mine]
            columns[f"bent {name} {number}"] = score.by_points(solver, found, lift)
            texts[f"bent {name} {number}"] = _above(0.15, "bent", "mm", 1.0, board=board.name)
        shift = np.zeros((len(xy), 3))
        shift[mine, 0] = xy[mine, 0]
        columns[f"stretched {number}"] = score.by_points(solver, found, shift)
        texts[f"stretched {number}"] = _above(3e-4, "stretched", "percent", 100.0, board=board.name)
    focal = score.derivative(solver, found, "fx") + score.derivative(solver, found, "fy")
    owner = np.repeat(at.corner_view, 2)
    for first in range(2, len(seen.views) - 1):
        column = focal.copy()
        column[: len(owner)] *= owner >= first
        columns[f"refocused {first}"] = column
        texts[f"refocused {first}"] = _above(
            0.3, "refocused", "percent", 100 / float(found.rig.camera[0]), view=seen.views[first].name
        )
    return _best(solver, found, columns, texts)


def _laser_cause(seen: Observations, found: Solution) -> list[Finding]:
    assert found.rig.laser is not None
    held = frozenset(name for name in found.rig.names() if name not in found.names)
    solver = Solver(seen, held)
    at = solver.predictions
    by_counts = score.by_counts(solver, found)
    corners = 2 * len(at.corner_view)
    owner = at.line_view
    views = len(seen.views)
    columns: dict[str, Floats] = {}
    texts: dict[str, Callable[[float], Finding | None]] = {}

    def part(share: Floats) -> Floats:
        column = by_counts.copy()
        column[corners : corners + len(owner)] *= share
        return column

    columns["slipping"] = part(owner / max(views - 1, 1))
    texts["slipping"] = _above(0.3, "slipping", "counts", 1.0)
    degrees = 360 / seen.counts_per_turn
    for first, second in pairwise(np.unique(owner)):
        columns[f"moved {second}"] = part((owner > first).astype(np.float64))
        texts[f"moved {second}"] = _above(0.3, "moved", "degrees", degrees, view=seen.views[int(second)].name)
    columns["counts"] = by_counts.copy()
    columns["counts"][corners : corners + len(owner)] *= at.counts
    texts["counts"] = _counts_per_turn(seen.counts_per_turn)
    for number, board in enumerate(seen.boards if len(seen.boards) > 1 else []):
        columns[f"square {number}"] = score.derivative(solver, found, f"scale{number}")
        columns[f"square {number}"][corners + len(owner) :] = 0
        texts[f"square {number}"] = _above(2e-3, "square-size", "percent", 100.0, board=board.name)
    columns["curved"] = score.by_columns(solver, found, _curve(solver, found))
    texts["curved"] = _above(0.15, "curved-line", "mm", 1.0)
    return _best(solver, found, columns, texts)


def _curve(solver: Solver, found: Solution) -> Floats:
    """Shift of each row, px, by a sheet that is bent by 1 mm for each unit of (Z_L / X_L)^2 over its greatest."""
    at, rig = solver.predictions, found.rig
    assert rig.laser is not None
    points = at.on_board(rig, at.model(rig).ray(at.column, at.row))
    pose = rig.laser.camera_from_laser
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    fan = local[:, 2] / np.hypot(local[:, 0], local[:, 1])
    return np.asarray(fan**2 / max(float((fan**2).max()), 1e-9) / at.slopes(rig))


def _counts_per_turn(given: int) -> Callable[[float], Finding | None]:
    def make(value: float) -> Finding | None:
        if abs(value) < 1e-3:
            return None
        raise refuse("counts-per-turn", found=given / (1 + value), given=given)

    return make


def _above(least: float, key: str, field: str, factor: float, **fields: object) -> Callable[[float], Finding | None]:
    """The finding, where its value reaches ``least``."""

    def make(value: float) -> Finding | None:
        return finding(key, **{field: value * factor}, **fields) if abs(value) >= least else None

    return make


def _best(
    solver: Solver, found: Solution, columns: dict[str, Floats], texts: dict[str, Callable[[float], Finding | None]]
) -> list[Finding]:
    """The cause that explains most, if it explains much and is large enough to matter."""
    gains = score.gain(found, columns)
    least = min(GAIN, 0.4 * solver.predictions.images) if found.rig.laser is not None else GAIN
    most = max((gain for gain, _ in gains.values()), default=0.0)
    for name in sorted(gains, key=lambda key: -gains[key][0]):
        gain, value = gains[name]
        if gain < max(least, 0.5 * most):
            break
        result = texts[name](value)
        if result is not None:
            return [result]
    return []


def _moved_boards(seen: Observations, found: Solution) -> list[Finding]:
    """Views whose lines do not fit, angle errors of the images counted in, though their corners do."""
    bare = Solver(seen)
    at = bare.predictions
    rig = replace(found.rig, angles=np.zeros(at.images))
    square = (at.heights(rig) / at.slopes(rig)) ** 2
    count = np.bincount(at.line_view, minlength=len(seen.views))
    rms = np.sqrt(np.bincount(at.line_view, square, len(seen.views)) / np.maximum(count, 1))
    usual = float(np.median(rms[count > 0]))
    return [
        finding("board-moved", view=seen.views[int(number)].name, px=rms[number])
        for number in np.flatnonzero((count > 0) & (rms > max(6 * usual, 0.3)))
    ]


def seen_without_lines(seen: Observations) -> Observations:
    """Corners alone."""
    return replace(seen, views=[replace(view, lines=Lines()) for view in seen.views])
