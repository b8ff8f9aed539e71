"""A calibration session on disk: what was taken of a rig, as it was taken.

A folder with

``session.json``
    ``counts_per_turn``; ``boards``, by name, as :class:`magtrak.calibrate.board.Board` has them; ``views``, each with
    its ``board``, its ``picture`` (or ``corners``, a CSV of ``id,u,v``) and the ``frames`` of its laser lines
pictures
    the board at rest, laser off, in the light of the room
``lines.csv``
    rows of the laser's lines, as the card measured them:
    ``frame,row,column_px,counts,counts_per_s,peak,width_px,flags``

Unknown keys are left alone. Nothing is thrown away while taking: what is not used is left out, and counted, here.
"""

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..arrays import Floats, Integers
from ..checked import Checked
from ..errors import CalibrationError
from .board import Board
from .detect import detect, read_picture
from .findings import Finding, finding, refuse
from .observations import Lines, Observations, View
from .rig import Predictions, Rig

FIELDS = ("frame", "row", "column_px", "counts", "counts_per_s", "peak", "width_px", "flags")
FLAGS = {"ambiguous": "a", "saturated": "s", "cut": "c", "overflow": "o", "standing": "t"}
SPARED = "acot"
"""Flags of rows that are not used. A saturated row is still measured on its flanks."""

REACH_PX = 10.0
"""A row is used where the band reaches so far to both sides of its line: the detector looks at 7 px to each side."""

DOWN_PX = 1.5
SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
MAX_SATURATED, MAX_RIVALS, MAX_STANDING = 0.2, 0.2, 0.05


@dataclass(frozen=True)
class Session:
    """What was taken, and what is wrong with it so far.

    Attributes
    ----------
    seen : views with corners; lines as taken, not yet limited to the bands
    findings : warnings
    """

    seen: Observations
    findings: list[Finding]


def load(folder: Path) -> Session:
    """Read a session and find the boards in its pictures.

    Raises
    ------
    CalibrationError
        Names file, field or picture.
    """
    path = folder / "session.json"
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CalibrationError(
            f"session {path} does not exist: give the folder of a session, or pictures with --board"
        ) from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise CalibrationError(f"session {path} cannot be read: {error}") from None
    top = Checked(str(path), values, CalibrationError)
    section = top.section("boards")
    boards = {name: Board.parse(name, section.section(name)) for name in section.values}
    entries = values.get("views")
    if not isinstance(entries, list) or not entries:
        raise CalibrationError(f"{path}: views must be a list of views, each with its board and picture")
    rows = _read_lines(folder / "lines.csv")
    findings = _flagged(rows)
    views: list[View] = []
    size: tuple[int, int] | None = None
    if "width" in values or "height" in values:
        size = top.integer("width", 1, 65535), top.integer("height", 1, 65535)
    for number, entry in enumerate(entries):
        table = Checked(str(path), entry, CalibrationError, f"views[{number}]")
        board = boards[table.choice("board", list(boards))]
        lines = _lines(rows, entry.get("frames", []), str(entry.get("picture", f"view {number}")))
        if "corners" in entry:
            name = str(entry["corners"])
            ids, corners = _read_corners(folder / name)
        else:
            name = str(table.values.get("picture", ""))
            picture = read_picture(folder / name)
            size = _same_size(size, picture.shape, name)
            found = detect(picture, board, name)
            _collect(findings, found.findings)
            ids, corners = found.ids, found.corners
        if len(ids):
            views.append(View(name, board, ids, corners, lines))
    if size is None:
        raise CalibrationError(f"{path}: width and height of the pictures are missing")
    views, twice = _without_repeats(views)
    seen = Observations(size[0], size[1], views, top.integer("counts_per_turn", 4, 2**24 - 1, 8192))
    return Session(seen, findings + twice)


def of_pictures(folder: Path, board: Board) -> Session:
    """Pictures of one board, all in a folder, without lines."""
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES) if folder.is_dir() else []
    if not paths:
        raise refuse("no-pictures", folder=folder)
    findings: list[Finding] = []
    views = []
    size: tuple[int, int] | None = None
    for path in paths:
        picture = read_picture(path)
        size = _same_size(size, picture.shape, path.name)
        found = detect(picture, board, path.name)
        _collect(findings, found.findings)
        if len(found.ids):
            views.append(View(path.name, board, found.ids, found.corners))
    assert size is not None
    views, twice = _without_repeats(views)
    return Session(Observations(size[0], size[1], views), findings + twice)


def on_bands(seen: Observations, rig: Rig) -> tuple[Observations, list[Finding]]:
    """Only rows whose line, with all that the detector looks at, lies on the blank band of its board."""
    for board in seen.boards:
        if board.band_mm is None and any(len(view.lines) for view in seen.views if view.board.name == board.name):
            raise refuse("no-band", board=board.name)
    at = Predictions(seen)
    keep = np.ones(len(at.row), bool)
    model = at.model(rig)
    for across, down in ((0.0, 0.0), (REACH_PX, 0.0), (-REACH_PX, 0.0), (0.0, DOWN_PX), (0.0, -DOWN_PX)):
        points = at.on_board(rig, model.ray(at.column + across, at.row + down))
        turn, shift = rig.rotations[at.line_view], rig.translations[at.line_view]
        local = np.einsum("nji,nj->ni", turn, points - shift)[:, :2] / rig.scales[at.board_of_view][at.line_view, None]
        for number, view in enumerate(seen.views):
            mine = at.line_view == number
            keep[mine] &= view.board.on_band(local[mine])
        keep &= points[:, 2] > 0
    findings, views, first = [], [], 0
    for view in seen.views:
        mine = keep[first : first + len(view.lines)]
        first += len(view.lines)
        if len(mine) and not mine.any():
            findings.append(finding("off-band", view=view.name))
        views.append(replace(view, lines=view.lines[mine]))
    return replace(seen, views=views), findings


def write_lines(path: Path, rows: Sequence[Sequence[object]], *, add: bool = False) -> None:
    """Write or lengthen ``lines.csv``."""
    try:
        with path.open("a" if add else "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            if not add:
                writer.writerow(FIELDS)
            writer.writerows(rows)
    except OSError as error:
        raise CalibrationError(f"{path} cannot be written: {error.strerror}") from None


def _collect(findings: list[Finding], more: list[Finding]) -> None:
    for item in more:
        if item.refused:
            raise CalibrationError(str(item))
        findings.append(item)


def _same_size(size: tuple[int, int] | None, shape: tuple[int, ...], name: str) -> tuple[int, int]:
    if size is not None and size != (shape[1], shape[0]):
        raise refuse("sizes", picture=name, width=shape[1], height=shape[0], first_width=size[0], first_height=size[1])
    return shape[1], shape[0]


def _without_repeats(views: list[View]) -> tuple[list[View], list[Finding]]:
    """Views whose corners all lie within 0.3 px of an earlier view's count once; their lines stay."""
    kept: list[View] = []
    findings = []
    for view in views:
        for other in kept:
            same = np.array_equal(view.ids, other.ids) and other.board.name == view.board.name
            if same and np.abs(view.corners - other.corners).max() < 0.3 and not len(view.lines):
                findings.append(finding("twice", picture=view.name, other=other.name))
                break
        else:
            kept.append(view)
    return kept, findings


@dataclass(frozen=True)
class _Rows:
    values: Floats
    flags: list[str]

    @property
    def frame(self) -> Integers:
        return self.values[:, 0].astype(np.int64)


def _read_lines(path: Path) -> _Rows | None:
    if not path.exists():
        return None
    values, flags = [], []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            if tuple(next(reader, ())) != FIELDS:
                raise CalibrationError(f"{path}: the first line must be {','.join(FIELDS)}")
            for line in reader:
                values.append([float(text) for text in line[: len(FIELDS) - 1]])
                flags.append(line[len(FIELDS) - 1])
    except (OSError, ValueError, IndexError) as error:
        raise CalibrationError(f"{path} cannot be read: {error}") from None
    return _Rows(np.array(values).reshape(-1, len(FIELDS) - 1), flags)


def _flagged(rows: _Rows | None) -> list[Finding]:
    if rows is None or not rows.flags:
        return []
    limits = (("s", MAX_SATURATED, "saturated"), ("a", MAX_RIVALS, "ambiguous"), ("t", MAX_STANDING, "standing"))
    found = []
    for letter, limit, key in limits:
        share = float(np.mean([letter in flags for flags in rows.flags]))
        if share > limit:
            found.append(finding(key, percent=100 * share))
    return found


def _lines(rows: _Rows | None, frames: Sequence[int], view: str) -> Lines:
    if rows is None or not frames:
        return Lines()
    good = np.array([not set(flags) & set(SPARED) for flags in rows.flags], dtype=bool)
    have = set(rows.frame.tolist())
    for number in frames:
        if number not in have:
            raise refuse("lost-frames", view=view, frame=number)
    use = good & np.isin(rows.frame, np.asarray(frames))
    mine = rows.values[use]
    return Lines(rows.frame[use], mine[:, 1], mine[:, 2], mine[:, 3], mine[:, 4])


def _read_corners(path: Path) -> tuple[Integers, Floats]:
    try:
        values = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError) as error:
        raise CalibrationError(f"corners {path} cannot be read: {error}") from None
    return values[:, 0].astype(np.int64), values[:, 1:3]
