"""Frame packets to arrays."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magtrak import protocol
from magtrak.frames import DamagedFrameError, LoggedEdge, decode_frame
from magtrak.protocol import Field, Layout, RowForm
from magtrak.records import FieldArrays
from magtrak.rows import QUALITY_FLAGS, Rows, quality
from tests.support.frames import full_rows

HEADER = dict.fromkeys((f.name for f in protocol.FRAME.fields if not f.reserved), 0)


def payload(row_data: bytes = b"", edge_data: bytes = b"", **header: int) -> bytes:
    return protocol.FRAME.pack({**HEADER, "form": RowForm.FULL, "row_step": 1, **header}) + edge_data + row_data


@given(st.data())
def test_records_unpack_as_one_by_one(data: st.DataObject) -> None:
    straddling = Layout("straddling", (Field("a", 60), Field("b", 20, signed=True), Field("_pad", 8), Field("c", 40)))
    layout = data.draw(
        st.sampled_from([protocol.FULL_ROW, protocol.COMPACT_ROW, protocol.EDGE, protocol.ANSWER, straddling])
    )
    count = data.draw(st.integers(0, 5))
    raw = data.draw(st.binary(min_size=count * layout.size, max_size=count * layout.size))
    got = FieldArrays(layout, raw, count)
    for n in range(count):
        one = layout.unpack(raw[n * layout.size : (n + 1) * layout.size])
        assert {name: int(values[n]) for name, values in got.items()} == one


def test_full_rows() -> None:
    frame = decode_frame(payload(full_rows([12.5, np.nan, 63.25]), rows=3, first_row=7, first_time=10, last_time=30))
    assert frame.rows.row.tolist() == [7, 8, 9]
    assert frame.rows.column_px.tolist() == [12.5, 0, 63.25]
    assert frame.rows.valid.tolist() == [True, False, True]
    assert frame.rows.peak.tolist() == [200, 0, 200]
    assert frame.row_times.tolist() == [0, 10, 20]


def test_rows_of_an_interlaced_picture() -> None:
    odd = {"row_step": 2, "field": protocol.FieldParity.ODD, "first_row": 1}
    frame = decode_frame(payload(full_rows([1.0, 2.0, 3.0]), rows=3, **odd))
    assert frame.rows.row.tolist() == [1, 3, 5]
    with pytest.raises(DamagedFrameError, match="rows 1 apart are not those of field 2"):
        decode_frame(payload(full_rows([1.0]), rows=1, **odd | {"row_step": 1}))


def test_compact_rows() -> None:
    row = {"position": 2047 * 256 + 255, "valid": 1, "ambiguous": 1, "saturated": 0, "cut": 1, "overflow": 0}
    data = protocol.COMPACT_ROW.pack({**row, "peak": 15, "width": 15})
    frame = decode_frame(payload(data, rows=1, form=RowForm.COMPACT))
    rows = frame.rows
    assert rows.column_px[0] == 2047 + 255 / 256
    flags = (rows.valid, rows.ambiguous, rows.saturated, rows.cut, rows.overflow)
    assert [bool(flag[0]) for flag in flags] == [True, True, False, True, False]
    assert (rows.peak[0], rows.width_px[0]) == (255, 15)
    assert frame.row_times.tolist() == [0]


@given(st.lists(st.integers(0, 2**32 - 1), max_size=20), st.integers(0, 3))
def test_compact_rows_are_judged_as_their_fields_are(words: list[int], parts: int) -> None:
    pieces = [words] * parts + [words]
    rows = Rows.joined(
        [Rows(RowForm.COMPACT, np.arange(len(piece)), np.array(piece, "<u4").tobytes()) for piece in pieces]
    )
    one_by_one = [protocol.COMPACT_ROW.unpack(word.to_bytes(4, "little")) for word in words] * len(pieces)
    assert len(rows) == len(one_by_one)
    for n, row in enumerate(one_by_one):
        peak, width = 17.0 * row["peak"], float(row["width"])
        flags = [np.array([bool(row[name])]) for name in QUALITY_FLAGS]
        assert (rows.peak[n], rows.width_px[n], rows.valid[n]) == (peak, width, bool(row["valid"]))
        assert rows.quality[n] == quality(np.array([peak]), np.array([width]), *flags)[0]


def test_edges_and_flags() -> None:
    edges = protocol.EDGE.pack({"time": 2**32 - 1, "count": -5, "backward": 1})
    errors = protocol.ENCODER_ERRORS.pack({"illegal": 3, "turns": 4})
    frame = decode_frame(payload(b"", edges, edges=1, flags=0b100001, encoder_errors=int.from_bytes(errors, "little")))
    assert frame.edges == [LoggedEdge(time=2**32 - 1, shown=-5, backward=1)]
    assert frame.flags["index_seen"] == 1
    assert frame.flags["rows_lost"] == 1
    assert frame.flags["laser_on"] == 0
    assert frame.encoder_errors == 7
    assert len(frame.rows.row) == 0


GOOD = payload(full_rows([1.0, 2.0]), rows=2)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "too few for a frame header"),
        (GOOD[: protocol.FRAME.size - 1], "too few for a frame header"),
        (GOOD[:-1], "do not hold 0 edges and 2 rows"),
        (GOOD + b"\0", "do not hold"),
        (payload(full_rows([1.0]), rows=2), "do not hold"),
        (payload(full_rows([1.0]), rows=1, form=RowForm.COMPACT), "do not hold"),
        (payload(full_rows([1.0]), rows=1, form=2), "form 2"),
        (payload(b"", bytes(17 * protocol.EDGE.size), edges=17), "17 edges"),
        (payload(first_time=5, last_time=4), "before the first"),
    ],
)
def test_what_cannot_be_is_damaged(data: bytes, message: str) -> None:
    with pytest.raises(DamagedFrameError, match=message):
        decode_frame(data)


@given(st.binary(max_size=400))
def test_any_bytes_are_a_frame_or_damaged(data: bytes) -> None:
    with contextlib.suppress(DamagedFrameError):
        decode_frame(data)
