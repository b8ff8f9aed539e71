"""The positions: the test picture's line stands where it is known to, row by row.

The picture is :class:`gateware.camera.pattern.Pattern`: a line 15 columns wide, symmetric about the middle of a column,
which leans by a column a row and moves by a column an image. So a measurement without noise has to find the middle of
a column exactly, in every row in which the line is clear of the border.
"""

import numpy as np

from ..arrays import Booleans, Floats, Integers
from ..errors import SettingsError
from ..frames import Frame
from ..protocol import Detector, Window
from ..settings import Settings
from .bench import Bench, FailedError, NotTriedError

CLEAR_PX = 40
"""Nearer to the border than this a measurement may be cut: filter, reach and window end there."""

TOLERANCE_PX = 1 / 256
"""The step of a position."""

IMAGES = 3

_WAYS: tuple[tuple[str, dict[str, int]], ...] = (
    ("binary", {"detector": Detector.BINARY}),
    ("fir", {"detector": Detector.FIR}),
    ("centroid of the run", {"detector": Detector.CENTROID, "centroid_window": Window.RUN}),
    ("centroid in a window", {"detector": Detector.CENTROID, "centroid_window": Window.HALF_15}),
    ("maximum", {"detector": Detector.MAXIMUM}),
)


def known_picture(bench: Bench) -> None:
    """:class:`NotTriedError` where the user said that a camera is there."""
    if bench.options.camera:
        raise NotTriedError("the images are a camera's, nobody knows what they show")


def middles(frame: Frame) -> Integers:
    """The column of the line in each row: image n has it in column n of row 0."""
    return (frame.rows.row + frame.number) % frame.header["columns"]


def clear(frame: Frame) -> Booleans:
    """Rows in which the line is clear of the border."""
    known = middles(frame)
    return (known >= CLEAR_PX) & (known < frame.header["columns"] - CLEAR_PX)


def positions(bench: Bench) -> str:
    """By every detector, the line in each row of several images, to the step of a position."""
    known_picture(bench)
    worst, rows, done, missing = 0.0, 0, [], []
    tables = dict(Settings().tables())
    for name, values in _WAYS:
        try:
            frames = bench.measure({key: int(value) for key, value in values.items()}, tables, IMAGES)
        except SettingsError:
            missing.append(name)
            continue
        errors = _errors(name, frames)
        worst, rows = max(worst, float(errors.max())), rows + len(errors)
        done.append(name)
    without = f"; built without {', '.join(missing)}" if missing else ""
    return f"{rows} rows by {', '.join(done)}: {worst:.4f} px at most from where the line is{without}"


def _errors(name: str, frames: list[Frame]) -> Floats:
    all_errors = []
    for frame in frames:
        known, inside, rows = middles(frame), clear(frame), frame.rows
        errors = np.abs(rows.column_px - known)[inside]
        if not len(errors):
            continue  # a small image, and the line at its border
        if not rows.valid.any() or (errors > CLEAR_PX).all():
            raise FailedError(f"image {frame.number} is not the test picture; if a camera is connected, say --camera")
        for what, wrong in (("no line", ~rows.valid), ("a rival", rows.ambiguous), ("a cut line", rows.cut)):
            if (inside & wrong).any():
                raise FailedError(f"{name}: image {frame.number} has {what} in row {rows.row[inside & wrong][0]}")
        if errors.max() > TOLERANCE_PX:
            row = int(np.flatnonzero(inside)[errors.argmax()])
            raise FailedError(
                f"{name}: image {frame.number}, row {rows.row[row]}: the line is at {known[row]} px, measured"
                f" {rows.column_px[row]:.3f}"
            )
        all_errors.append(errors)
    return np.concatenate(all_errors)
