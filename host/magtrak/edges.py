"""Encoder edges of a stream of frames: where the encoder certainly was, and when."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .arrays import Integers, Numbers
from .frames import Frame

SATURATED_AGE = 2**32 - 1

# An edge may be logged until shortly after the last row of its frame; of the 2^32 clocks (29 s at 148.5 MHz) that its
# time tells apart this part is taken as after the last row, the rest as before.
_AFTER_CLOCKS = 2**28

# The latch and the log may see the same edge some clocks apart.
SAME_EDGE_CLOCKS = 16


@dataclass(frozen=True)
class Edges:
    """Edges in order of time, one entry each.

    Parameters
    ----------
    table : (5, N), a row for each attribute, in their order

    Attributes
    ----------
    time : clocks since reset, unwrapped
    position : counts, unwrapped: an edge lies at a whole count
    count : count after the edge: until the next edge the encoder is within [count, count + 1)
    before : count before the edge
    unlogged : at most so many edges came between the one before and this one, and are not here; -1: nobody knows
    """

    table: Integers

    @classmethod
    def none(cls) -> "Edges":
        return cls(np.zeros((5, 0), np.int64))

    @property
    def time(self) -> Integers:
        return self._row(0)

    @property
    def position(self) -> Integers:
        return self._row(1)

    @property
    def count(self) -> Integers:
        return self._row(2)

    @property
    def before(self) -> Integers:
        return self._row(3)

    @property
    def unlogged(self) -> Integers:
        return self._row(4)

    def _row(self, index: int) -> Integers:
        row: Integers = self.table[index]
        return row

    def __len__(self) -> int:
        return int(self.table.shape[1])

    def __getitem__(self, part: slice | Numbers) -> "Edges":
        return Edges(self.table[:, part])

    def __add__(self, later: "Edges") -> "Edges":
        """These and the later ones; what does not come after these is left out."""
        if not len(self):
            return later
        new = later.table
        if len(later) and new[0, 0] <= self.table[0, -1]:
            new = new[:, new[0] > self.table[0, -1]]
        return Edges(np.concatenate([self.table, new], axis=1))


def wrapped_difference(a: int, b: int, bits: int = 32) -> int:
    """a - b modulo 2^bits, as a signed number."""
    half = 1 << (bits - 1)
    return ((a - b + half) & ((1 << bits) - 1)) - half


def edges_of_frame(
    frame: Frame, last_count: int, *, follows: bool, shift_before: int, count_before: int | None = None
) -> Edges:
    """The edges that a frame tells of. Where the log has none, and the counts have changed all the same, the card has
    no log: then those that the latches tell of.

    Parameters
    ----------
    frame : the frame
    last_count : its ``last_count``, unwrapped over the stream
    follows : the frame before was received, so that the log goes on where its log ended
    shift_before : ``edge_shift`` of the frame before
    count_before : ``last_count`` of the frame before, unwrapped, where it is known
    """
    header = frame.header
    if not len(frame.edges["time"]):
        return _of_latches(header, last_count, count_before)
    last_time = header["last_time"]
    low = frame.edges["time"]
    time = last_time + _AFTER_CLOCKS - ((last_time + _AFTER_CLOCKS - low) & 0xFFFF_FFFF)
    count = last_count + ((frame.edges["count"] - header["last_count"] + 2**30) & (2**31 - 1)) - 2**30
    backward = frame.edges["backward"]
    unlogged = np.full(len(time), (1 << header["edge_shift"]) - 1, np.int64)
    if len(time):
        # Between two logs each may have left out its share.
        unlogged[0] = unlogged[0] + (1 << shift_before) - 1 if follows else -1
    table = np.empty((5, len(time)), np.int64)
    table[0], table[1], table[2] = time, count + backward, count
    np.add(2 * backward, count - 1, out=table[3])
    table[4] = unlogged
    edges = _plausible(Edges(table), header)
    return edges if follows else _with_first_latch(edges, frame, last_count)


def _of_latches(header: Mapping[str, int], last_count: int, count_before: int | None) -> Edges:
    """The last edge before the first row and that before the last row, at most.

    Which way an edge went is told by the counts of two latches: where the encoder turned round between them it may have
    been the other way, and the edge lies a count off.
    """
    first_count = last_count + wrapped_difference(header["first_count"], header["last_count"])
    if count_before is None:
        count_before = 2 * first_count - last_count  # as it went on
    found = []
    for row, count, before in (("first", first_count, count_before), ("last", last_count, first_count)):
        if count != before and header[f"{row}_age"] != SATURATED_AGE:
            down = int(count < before)
            found.append((header[f"{row}_time"] - header[f"{row}_age"], count + down, count, count - 1 + 2 * down, -1))
    return Edges(np.array(sorted(found), np.int64).reshape(-1, 5).T)


def _plausible(edges: Edges, header: Mapping[str, int]) -> Edges:
    """Those edges whose time is not off by a whole turn of its 32 bits.

    A log is in order, and no edge lies between the latched last edge and the last row. Both hold unless an edge is
    older than the 32 bits tell apart.
    """
    time = edges.time
    latest = header["last_time"] - header["last_age"] + SAME_EDGE_CLOCKS
    in_order = time.tolist()
    if in_order[-1] <= latest and in_order == sorted(in_order):
        return edges
    wrong = (time > latest) & (time <= header["last_time"])
    bad = wrong.copy()
    bad[1:] |= time[1:] < time[:-1]
    if not bad.any():
        return edges  # one came after the last row
    # What comes before a fall in time, or a wrong edge, is older still.
    last_bad = int(np.flatnonzero(bad)[-1])
    return edges[last_bad + 1 if wrong[last_bad] else last_bad :]


def _with_first_latch(edges: Edges, frame: Frame, last_count: int) -> Edges:
    """Add the edge latched at the first row, where its direction can be told.

    At the start of a stream, or after a lost frame, the log alone does not reach back to the first row.
    """
    header = frame.header
    if header["first_age"] == SATURATED_AGE or not len(edges):
        return edges
    time = header["first_time"] - header["first_age"]
    count = last_count + wrapped_difference(header["first_count"], header["last_count"])
    if np.any(np.abs(edges.time - time) <= SAME_EDGE_CLOCKS):
        return edges
    at = int(np.searchsorted(edges.time, time))
    neighbours = edges[max(at - 1, 0) : at + 1]
    backward = neighbours.before > neighbours.count
    if backward.any() != backward.all():
        return edges
    down = int(backward[0])
    # Where the counts do not fit between the neighbours, the encoder turned round in between.
    counts = np.concatenate([edges.count[max(at - 1, 0) : at], [count], edges.count[at : at + 1]])
    if not (np.diff(counts) * (1 - 2 * down) > 0).all():
        return edges
    latch = Edges(np.array([[time], [count + down], [count], [count - 1 + 2 * down], [-1]], np.int64))
    return edges[:at] + latch + edges[at:]
