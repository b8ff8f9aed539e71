"""Frame packets to arrays. The bit fields come from :mod:`magtrak.protocol`, which defines them once."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from . import protocol
from .arrays import Floats, Integers
from .protocol import FieldParity, RowForm
from .records import FieldArrays
from .rows import LAYOUTS, Rows


class DamagedFrameError(ValueError):
    """The payload is no frame: intact on the wire, but not what the protocol allows."""


@dataclass(frozen=True)
class Frame:
    """A decoded frame packet.

    Attributes
    ----------
    header : fields of ``protocol.FRAME``
    flags : fields of ``protocol.FRAME_FLAGS``
    edges : fields of ``protocol.EDGE``, an entry per edge, oldest first
    rows : the rows
    """

    header: Mapping[str, int]
    flags: Mapping[str, int]
    edges: Mapping[str, Integers]
    rows: Rows

    @property
    def number(self) -> int:
        """Number of the image since reset."""
        return self.header["frame"]

    @cached_property
    def encoder_errors(self) -> int:
        """Illegal transitions and wrong turns since reset."""
        errors = protocol.ENCODER_ERRORS.unpack(
            self.header["encoder_errors"].to_bytes(protocol.ENCODER_ERRORS.size, "little")
        )
        return sum(errors.values())

    @cached_property
    def row_times(self) -> Floats:
        """Arrival of column 0 of each row, whole clocks after ``first_time``."""
        count = len(self.rows)
        span = self.header["last_time"] - self.header["first_time"]
        times = np.arange(count, dtype=np.float64)
        times *= span / max(count - 1, 1)
        return np.rint(times, out=times)


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
        FieldArrays(protocol.EDGE, view[size:rows_at], edges),
        Rows(form, _row_numbers(header["first_row"], header["row_step"], rows), view[rows_at:]),
    )


@lru_cache(16)
def _row_numbers(first: int, step: int, count: int) -> Integers:
    """The same for frame after frame."""
    rows = first + step * np.arange(count)
    rows.setflags(write=False)
    return rows
