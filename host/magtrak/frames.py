"""Frame packets to arrays. The bit fields come from :mod:`magtrak.protocol`, which defines them once."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from . import protocol
from .arrays import Floats, Integers
from .protocol import FieldParity, RowForm
from .rows import LAYOUTS, Rows


class DamagedFrameError(ValueError):
    """The payload is no frame: intact on the wire, but not what the protocol allows."""


class LoggedEdge(NamedTuple):
    """The fields of ``protocol.EDGE``: its time, the count shown after it, and whether it went backward."""

    time: int
    shown: int
    backward: int


@dataclass(frozen=True)
class Frame:
    """A decoded frame packet.

    Attributes
    ----------
    header : fields of ``protocol.FRAME``
    flags : fields of ``protocol.FRAME_FLAGS``
    edges : of the log, oldest first
    rows : the rows
    """

    header: Mapping[str, int]
    flags: Mapping[str, int]
    edges: list[LoggedEdge]
    rows: Rows

    @property
    def number(self) -> int:
        """Number of the image since reset."""
        return self.header["frame"]

    @property
    def encoder_errors(self) -> int:
        """Illegal transitions and wrong turns since reset."""
        return _encoder_errors(self.header["encoder_errors"])

    @cached_property
    def row_times(self) -> Floats:
        """Arrival of column 0 of each row, whole clocks after ``first_time``."""
        count = len(self.rows)
        span = self.header["last_time"] - self.header["first_time"]
        return np.asarray(np.rint(_row_numbers(0, 1, count) * (span / max(count - 1, 1))))


def decode_frame(payload: bytes) -> Frame:
    """The frame in the payload of a ``FRAME`` packet.

    Raises
    ------
    DamagedFrameError
        Its length is not what its header says, or the header says what cannot be. Not one point of it can be trusted.
    """
    size = protocol.FRAME.size
    if len(payload) < size:
        raise DamagedFrameError(f"{len(payload)} bytes are too few for a frame header")
    header = protocol.FRAME.unpack(payload[:size])
    if header["form"] not in LAYOUTS:
        raise DamagedFrameError(f"rows of form {header['form']} are not known")
    form = RowForm(header["form"])
    edges, rows = header["edges"], header["rows"]
    if edges > protocol.MAX_EDGES:
        raise DamagedFrameError(f"{edges} edges are more than a frame carries")
    rows_at = size + edges * protocol.EDGE.size
    if len(payload) != rows_at + rows * LAYOUTS[form].size:
        raise DamagedFrameError(f"{len(payload)} bytes do not hold {edges} edges and {rows} rows")
    if header["last_time"] < header["first_time"]:
        raise DamagedFrameError("the last row came before the first")
    if header["row_step"] != (1 if header["field"] == FieldParity.PROGRESSIVE else 2):
        raise DamagedFrameError(f"rows {header['row_step']} apart are not those of field {header['field']}")
    flags = protocol.FRAME_FLAGS.unpack(header["flags"].to_bytes(protocol.FRAME_FLAGS.size, "little"))
    view = memoryview(payload)
    return Frame(
        header,
        flags,
        [LoggedEdge(*values) for values in protocol.EDGE.unpack_each(view[size:rows_at])],
        Rows(form, _row_numbers(header["first_row"], header["row_step"], rows), view[rows_at:]),
    )


# Frame after frame has the same:


@lru_cache(16)
def _row_numbers(first: int, step: int, count: int) -> Integers:
    rows = first + step * np.arange(count)
    rows.setflags(write=False)
    return rows


@lru_cache(16)
def _encoder_errors(value: int) -> int:
    return sum(protocol.ENCODER_ERRORS.unpack(value.to_bytes(protocol.ENCODER_ERRORS.size, "little")).values())
