"""Pictures of a board from a card that runs: which of them are new views, and what the next one should show."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Floats, Integers
from ..card import Card
from ..errors import CalibrationError, LinkError
from ..png import write_png
from ..snapshot import Area, take_snapshot
from .board import Board
from .detect import Detected, detect, read_picture
from .session import SUFFIXES

STILL_PX = 0.4
"""A board that moved less than this from one snapshot to the next is at rest: its rows are from one place."""

SAME = 0.9
"""Part of the corners that both show then."""

MOVED_PX = 15.0
"""A view differs from all others where corners that both show lie so far apart."""

DOWN, ACROSS = 6, 8
"""Cells of the picture in which corners are counted."""

NAMES = (("upper", "middle", "lower"), ("left", "middle", "right"))


@dataclass(frozen=True)
class Step:
    """What became of a snapshot.

    Attributes
    ----------
    taken : file of the picture, where it is a new view
    text : what to tell
    views : taken so far
    """

    taken: Path | None
    text: str
    views: int


class ViewTaker:
    """Decides on snapshots, one after another, and keeps those that are new views.

    Parameters
    ----------
    board : that is shown
    folder : of the pictures; what it holds already counts

    Attributes
    ----------
    cells : (6, 8) corners in each cell of the picture
    """

    def __init__(self, board: Board, folder: Path) -> None:
        self._board, self._folder = board, folder
        self._views: list[Detected] = []
        self._last: Detected | None = None
        self.cells: Integers = np.zeros((DOWN, ACROSS), np.int64)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            known = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
        except OSError as error:
            raise CalibrationError(f"the folder {folder} cannot be used: {error.strerror}") from None
        for path in known:
            picture = read_picture(path)
            self._keep(detect(picture, board, path.name), picture.shape)
        self._next = len(known)

    @property
    def views(self) -> int:
        """How many views there are."""
        return len(self._views)

    def offer(self, picture: Any) -> Step:
        """A snapshot (height, width, 3), RGB: taken, or why not."""
        import cv2

        grey = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY)
        found = detect(grey, self._board, "the picture")
        before, self._last = self._last, found
        for item in found.findings:
            if item.refused:
                raise CalibrationError(str(item))
            return self._step(None, str(item))
        if before is None or not _at_rest(before, found):
            return self._step(None, "the board is seen: hold it still")
        if any((other := _apart(view, found)) is not None and other < MOVED_PX for view in self._views):
            return self._step(None, f"this view is taken: show the board {self.wanted()}, or tilted another way")
        path = self._folder / self._name()
        write_png(path, picture)
        self._keep(found, grey.shape)
        return self._step(path, f"{path.name}: view {self.views}, {len(found.ids)} corners; next {self.wanted()}")

    def wanted(self) -> str:
        """Where in the picture corners are fewest."""
        ninths = self.cells.reshape(3, 2, ACROSS).sum(axis=1)
        columns = np.stack([ninths[:, :3].sum(axis=1), ninths[:, 3:5].sum(axis=1), ninths[:, 5:].sum(axis=1)], axis=1)
        row, column = np.unravel_index(int(np.argmin(columns)), columns.shape)
        down, across = NAMES[0][int(row)], NAMES[1][int(column)]
        return "in the middle" if down == across else f"at the {down} {across}"

    def coverage(self) -> str:
        """The cells as text, for a terminal."""
        return "\n".join(
            "  " + " ".join(f"{int(value):4d}" if value else "   ." for value in row) for row in self.cells
        )

    def _step(self, taken: Path | None, text: str) -> Step:
        return Step(taken, text, self.views)

    def _name(self) -> str:
        while (self._folder / f"{self._next:03}.png").exists():
            self._next += 1
        return f"{self._next:03}.png"

    def _keep(self, found: Detected, shape: tuple[int, ...]) -> None:
        if len(found.ids):
            self._views.append(found)
            at = found.corners / (shape[1], shape[0]) * (ACROSS, DOWN)
            column, row = np.clip(at.astype(np.int64), 0, (ACROSS - 1, DOWN - 1)).T
            np.add.at(self.cells, (row, column), 1)


def _at_rest(before: Detected, now: Detected) -> bool:
    """Whether two snapshots show the same corners in the same places: none of the two is put together of two places."""
    ids, at, there = np.intersect1d(before.ids, now.ids, return_indices=True)
    if len(ids) < SAME * max(len(before.ids), len(now.ids)):
        return False
    gaps = np.linalg.norm(before.corners[at] - now.corners[there], axis=1)
    return bool(np.percentile(gaps, 90) < STILL_PX)


def _apart(a: Detected, b: Detected) -> float | None:
    """Median distance of the corners that both show, px; None where they share too few to tell."""
    ids, at, there = np.intersect1d(a.ids, b.ids, return_indices=True)
    if len(ids) < 4:
        return None
    gaps: Floats = np.linalg.norm(a.corners[at] - b.corners[there], axis=1)
    return float(np.median(gaps))


def take_views(card: Card, taker: ViewTaker, views: int) -> Iterator[Step]:
    """Snapshots of a card, until there are ``views``; the laser stays off, for nobody arms it.

    Raises
    ------
    MagtrakError
        In one sentence; the end of the stream among them.
    """
    running = card.read("run")
    card.write("run", 1)
    try:
        while taker.views < views:
            yield taker.offer(take_snapshot(card, "raw", Area()).picture)
    finally:
        with suppress(LinkError):  # why it went is told already
            card.write("run", running)
