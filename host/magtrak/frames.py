"""Frame packets to arrays. The bit fields come from :mod:`magtrak.protocol`, which defines them once."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from . import protocol
from .arrays import Booleans, Floats, Integers
from .protocol import FieldParity, Layout, RowForm

_ROWS = {RowForm.COMPACT: protocol.COMPACT_ROW, RowForm.FULL: protocol.FULL_ROW}


class DamagedFrameError(ValueError):
    """The payload is no frame: intact on the wire, but not what the protocol allows."""


@dataclass(frozen=True)
class Rows:
    """What was measured, one entry a row, in order.

    Attributes
    ----------
    row : row of the picture: of an interlaced one, an image has every other
    column_px : column of the line, distorted picture; 0 where not valid
    valid, ambiguous, saturated, cut, overflow : flags as in the protocol
    peak : greatest weight of the run, 0 to 255 (in steps of 17 in the compact form)
    width_px : columns of the run (at most 15 in the compact form)
    raw : every field of the form as it came
    """

    row: Integers
    column_px: Floats
    valid: Booleans
    ambiguous: Booleans
    saturated: Booleans
    cut: Booleans
    overflow: Booleans
    peak: Floats
    width_px: Floats
    raw: Mapping[str, Integers]


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

    @property
    def encoder_errors(self) -> int:
        """Illegal transitions and wrong turns since reset."""
        errors = protocol.ENCODER_ERRORS.unpack(
            self.header["encoder_errors"].to_bytes(protocol.ENCODER_ERRORS.size, "little")
        )
        return sum(errors.values())

    def row_times(self) -> Floats:
        """Arrival of column 0 of each row, clocks after ``first_time``."""
        count = len(self.rows.row)
        span = self.header["last_time"] - self.header["first_time"]
        return np.arange(count, dtype=np.float64) * (span / max(count - 1, 1))


def unpack_records(layout: Layout, data: bytes | memoryview, count: int) -> dict[str, Integers]:
    """Fields of ``count`` records, an array each; the vectorised ``Layout.unpack``.

    Fields are at most 63 bits wide when unsigned, 64 when signed, as int64 holds them.
    """
    if layout.size == 4:
        return _unpack_words(layout, np.frombuffer(data, "<u4", count))
    if layout.size == 8:
        return _unpack_words(layout, np.frombuffer(data, "<i8", count))
    words = -(-layout.size // 8)
    padded = np.zeros((count, 8 * words), np.uint8)
    padded[:, : layout.size] = np.frombuffer(data, np.uint8, count * layout.size).reshape(count, layout.size)
    word = padded.view("<u8")
    fields = {}
    for offset, field in layout:
        if field.reserved:
            continue
        at, shift = divmod(offset, 64)
        value = word[:, at] >> np.uint64(shift)
        if shift + field.bits > 64:
            value |= word[:, at + 1] << np.uint64(64 - shift)
        # To the top and back: the second shift is arithmetic where the field is signed.
        spare = 64 - field.bits
        value = value << np.uint64(spare)
        number = value.view(np.int64) >> spare if field.signed else (value >> np.uint64(spare)).astype(np.int64)
        fields[field.name] = np.asarray(number, dtype=np.int64)
    return fields


def _unpack_words(layout: Layout, word: Integers) -> dict[str, Integers]:
    """As :func:`unpack_records`, for records of a word; only one of 64 bits may have signed fields."""
    fields = {}
    for offset, field in layout:
        if field.reserved:
            continue
        if field.signed:
            assert layout.bits == 64
            fields[field.name] = word << 64 - offset - field.bits >> 64 - field.bits
        else:
            fields[field.name] = (word >> offset if offset else word) & ((1 << field.bits) - 1)
    return fields


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
    if header["form"] not in _ROWS:
        raise DamagedFrameError(f"rows of form {header['form']} are not known")
    layout = _ROWS[RowForm(header["form"])]
    edges, rows = header["edges"], header["rows"]
    if edges > protocol.MAX_EDGES:
        raise DamagedFrameError(f"{edges} edges are more than a frame carries")
    rows_at = size + edges * protocol.EDGE.size
    if len(payload) != rows_at + rows * layout.size:
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
        unpack_records(protocol.EDGE, view[size:rows_at], edges),
        _decode_rows(layout, view[rows_at:], header["first_row"] + header["row_step"] * np.arange(rows)),
    )


def _decode_rows(layout: Layout, data: memoryview, row: Integers) -> Rows:
    raw = unpack_records(layout, data, len(row))
    peak_scale = 17 if layout is protocol.COMPACT_ROW else 1  # 15 * 17 == 255
    return Rows(
        row=row,
        column_px=raw["position"] / (1 << protocol.POSITION_FRACTION_BITS),
        valid=raw["valid"].astype(bool),
        ambiguous=raw["ambiguous"].astype(bool),
        saturated=raw["saturated"].astype(bool),
        cut=raw["cut"].astype(bool),
        overflow=raw["overflow"].astype(bool),
        peak=(raw["peak"] * peak_scale).astype(np.float64),
        width_px=raw["width"].astype(np.float64),
        raw=raw,
    )
