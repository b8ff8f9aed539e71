"""Every detector on ten real pictures of a board: see :mod:`tests.support.board`. The colour gate is the preset's."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.bench import Figure
from tests.support import board

PEAKS = {
    "fir": 'detector = "fir"',
    "centroid 7": 'detector = "centroid"\nwindow = 7',
    "centroid 15": 'detector = "centroid"\nwindow = 15',
    "centroid 31": 'detector = "centroid"\nwindow = 31',
    "centroid run": 'detector = "centroid"\nwindow = 0',
    "binary": 'detector = "binary"',
    "maximum": 'detector = "maximum"',
}
PROMISED = ("fir", "centroid 15")


def run() -> Iterator[Figure]:
    for name, peak in PEAKS.items():
        with tempfile.TemporaryDirectory() as folder:
            lines, ambiguous = board.measured_lines(Path(folder), peak)
        promised = name in PROMISED
        share = 100 * board.shares(lines).min()
        worst = max(abs(board.prediction_error_mm(lines, n)) for n in range(len(lines)))
        scatter = board.scatter_mm(lines)
        far, near = (scatter[at].max() for at in (board.DISTANCES_MM > 220, board.DISTANCES_MM <= 220))
        yield Figure(
            f"{name}: rows that gave a point, least",
            share,
            "%",
            goal="at least 90" if promised else "",
            met=share >= 90 if promised else None,
        )
        yield Figure(f"{name}: rows that are ambiguous", ambiguous, "rows")
        yield Figure(
            f"{name}: distance of a picture from the others, worst",
            worst,
            "mm",
            goal="at most 2.5" if promised else "",
            met=worst <= 2.5 if promised else None,
        )
        yield Figure(
            f"{name}: scatter of rows up to 220 mm, worst",
            near,
            "mm RMS",
            goal="at most 1.2" if promised else "",
            met=bool(near <= 1.2) if promised else None,
        )
        yield Figure(
            f"{name}: scatter of rows beyond, worst",
            far,
            "mm RMS",
            goal="at most 1.6" if promised else "",
            met=bool(far <= 1.6) if promised else None,
        )
