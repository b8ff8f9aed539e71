"""The gate's tables: each lets the line's colours pass, or not, as it says."""

from collections.abc import Sequence

import numpy as np

from ..gate import pack_table
from ..protocol import Detector, RowForm, Window
from ..reference.hls import hls
from .bench import CLOSED, OPEN, TABLES, Bench, FailedError, NotTriedError
from .pattern import clear, known_picture

MIDDLE = (63, 255, 63)
"""R, G, B of the middle of the test picture's line."""


def effect(bench: Bench) -> str:
    """Gated pixels of a row with a table that has only the colour of the line's middle, all but that, none, and all;
    for each of the three tables.
    """
    known_picture(bench)
    if not bench.card.identity.built.has("full_rows"):
        raise NotTriedError("this card has no full rows, which tell the gated pixels")
    colour = (int(value) for value in hls(np.array(MIDDLE, np.uint8)))
    found = []
    for table, entry in zip(TABLES, colour, strict=True):
        only = pack_table([entry])
        others = [word ^ mask for word, mask in zip(OPEN, only, strict=True)]
        some, rest, none, every = (_gated(bench, table, words) for words in (only, others, CLOSED, OPEN))
        if none:
            raise FailedError(f"{table} is closed, and {none} pixels of a row pass")
        if not some:
            raise FailedError(f"{table} has the colour of the line's middle, and no pixel passes")
        if some + rest != every:
            raise FailedError(f"{table}: {some} pixels of a row pass by one entry and {rest} by all others, of {every}")
        found.append(f"{table.removeprefix('lut_')} {some} + {rest}")
    return f"gated pixels of a row by the line's colour and by all others: {', '.join(found)}"


def _gated(bench: Bench, table: str, words: Sequence[int]) -> int:
    """Gated pixels of the run in each row that is clear of the border: the same in all. Those of the row where a card
    has no runs.
    """
    bench.card.write("form", RowForm.FULL)
    detector = Detector.CENTROID if bench.card.identity.built.has("runs") else Detector.BINARY
    frame = bench.measure(
        {"detector": detector, "centroid_window": Window.RUN, "run_reach": 0, "floor": 0}, {table: words}
    )[0]
    amounts = set((frame.rows.raw["gated"] * frame.rows.valid)[clear(frame)].tolist())
    if len(amounts) != 1:
        raise FailedError(f"{table}: rows of the same picture have {sorted(amounts)} gated pixels")
    return int(amounts.pop())
