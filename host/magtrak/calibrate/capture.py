"""Takes the rows of the laser's lines from a card into a session."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..angle import AngleTracker, RowAngles
from ..card import Card
from ..errors import CalibrationError, EndOfStreamError
from ..frames import Frame
from ..link import Link
from ..settings import Settings
from .findings import refuse
from .session import FLAGS, write_lines

Row = tuple[object, ...]


class LineTaker:
    """Turns frames into rows of ``lines.csv``.

    Parameters
    ----------
    clock_hz : of the card
    first : number of the first frame

    Attributes
    ----------
    frames : taken
    unreferenced : of them, without an index before them; they give no rows
    """

    def __init__(self, clock_hz: float, first: int = 0) -> None:
        self._tracker = AngleTracker(clock_hz)
        self._clock_hz = clock_hz
        self._first = first
        self._begin: int | None = None
        self.frames = 0
        self.unreferenced = 0

    def push(self, frame: Frame) -> Iterator[Row]:
        """Rows that are known now; those of a frame come a few frames later."""
        if self._begin is None:
            self._begin = frame.number
        for ready, angles in self._tracker.push(frame):
            yield from self._rows(ready, angles)

    def finish(self) -> Iterator[Row]:
        """The rows held back."""
        for ready, angles in self._tracker.flush():
            yield from self._rows(ready, angles)

    def _rows(self, frame: Frame, angles: RowAngles) -> Iterator[Row]:
        assert self._begin is not None
        self.frames += 1
        if not frame.flags["index_seen"]:
            self.unreferenced += 1
            return
        number = self._first + ((frame.number - self._begin) & 0xFFFF_FFFF)
        times = frame.row_times / self._clock_hz
        # One rate for an image: its rows are too few edges for more.
        rate = float(np.polyfit(times, angles.counts, 1)[0]) if len(times) > 1 and np.ptp(times) > 0 else 0.0
        rows = frame.rows
        for i in np.flatnonzero(rows.valid):
            flags = "".join(letter for name, letter in FLAGS.items() if name != "standing" and getattr(rows, name)[i])
            flags += FLAGS["standing"] if angles.standing[i] else ""
            yield (
                number,
                int(rows.row[i]),
                f"{rows.column_px[i]:.4f}",
                f"{angles.counts[i]:.5f}",
                f"{rate:.4f}",
                int(rows.peak[i]),
                int(rows.width_px[i]),
                flags,
            )


def take_lines(
    folder: Path,
    port: str,
    settings: Settings,
    *,
    baud: int = 3_000_000,
    frames: int | None = None,
    view: str | None = None,
) -> tuple[int, int]:
    """Receive frames until the stream ends or there are ``frames``; gives numbers of frames and rows.

    Parameters
    ----------
    folder : of the session
    view : picture whose view the frames belong to: they are added to the session; None where the session names frames
        already

    Raises
    ------
    MagtrakError
        In one sentence; no index among them.
    """
    values = _read(folder)
    entry = None
    first = 0
    path = folder / "lines.csv"
    if view is not None:
        entry = next((item for item in values["views"] if item.get("picture") == view), None)
        if entry is None:
            raise CalibrationError(f"session {folder} has no view of picture {view}: add it to session.json first")
        first = 1 + max((n for item in values["views"] for n in item.get("frames", [])), default=-1)
    chosen = replace(settings, encoder=replace(settings.encoder, counts_per_turn=int(values["counts_per_turn"])))
    rows: list[Row] = []
    with Link(port, baud) as link:
        card = Card(link)
        taker = LineTaker(card.identity.clock_hz, first)
        generation = card.apply(chosen)
        card.start(chosen)
        try:
            for frame in card.frames():
                if frame is None or (not taker.frames and frame.header["generation"] != generation):
                    continue
                rows += taker.push(frame)
                if frames is not None and taker.frames >= frames:
                    break
        except EndOfStreamError:
            pass
        else:
            card.stop()
        rows += taker.finish()
    if taker.frames and taker.unreferenced == taker.frames:
        raise refuse("no-index")
    write_lines(path, rows, add=view is not None and path.exists())
    if entry is not None:
        entry["frames"] = sorted({int(str(row[0])) for row in rows})
        (folder / "session.json").write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    return taker.frames, len(rows)


def _read(folder: Path) -> dict[str, Any]:
    try:
        values = json.loads((folder / "session.json").read_text(encoding="utf-8"))
        int(values["counts_per_turn"])
        return dict(values)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CalibrationError(f"session {folder / 'session.json'} cannot be used: {error}") from None
