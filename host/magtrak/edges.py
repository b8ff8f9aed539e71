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

    Attributes
    ----------
    time : clocks since reset, unwrapped
    position : counts, unwrapped: an edge lies at a whole count
    count : count after the edge: until the next edge the encoder is within [count, count + 1)
    before : count before the edge
    unlogged : at most so many edges came between the one before and this one, and are not here; -1: nobody knows
    """

    time: Integers
    position: Integers
    count: Integers
    before: Integers
    unlogged: Integers

    @classmethod
    def none(cls) -> "Edges":
        return cls(*(np.zeros(0, np.int64) for _ in range(5)))

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, part: slice | Numbers) -> "Edges":
        return Edges(self.time[part], self.position[part], self.count[part], self.before[part], self.unlogged[part])

    def __add__(self, later: "Edges") -> "Edges":
        """These and the later ones; what does not come after these is left out."""
        if len(self):
            later = later[later.time > self.time[-1]]
        return Edges(
            np.concatenate([self.time, later.time]),
            np.concatenate([self.position, later.position]),
            np.concatenate([self.count, later.count]),
            np.concatenate([self.before, later.before]),
            np.concatenate([self.unlogged, later.unlogged]),
        )


def wrapped_difference(a: int, b: int, bits: int = 32) -> int:
    """a - b modulo 2^bits, as a signed number."""
    half = 1 << (bits - 1)
    return ((a - b + half) & ((1 << bits) - 1)) - half


def edges_of_frame(frame: Frame, last_count: int, *, follows: bool, shift_before: int) -> Edges:
    """The edges that a frame tells of.

    Parameters
    ----------
    frame : the frame
    last_count : its ``last_count``, unwrapped over the stream
    follows : the frame before was received, so that the log goes on where its log ended
    shift_before : ``edge_shift`` of the frame before
    """
    header = frame.header
    last_time = header["last_time"]
    low = frame.edges["time"]
    time = last_time + _AFTER_CLOCKS - ((last_time + _AFTER_CLOCKS - low) & 0xFFFF_FFFF)
    count = last_count + ((frame.edges["count"] - header["last_count"] + 2**30) & (2**31 - 1)) - 2**30
    backward = frame.edges["backward"]
    unlogged = np.full(len(time), (1 << header["edge_shift"]) - 1, np.int64)
    if len(time):
        # Between two logs each may have left out its share.
        unlogged[0] = unlogged[0] + (1 << shift_before) - 1 if follows else -1
    edges = Edges(time, count + backward, count, count - 1 + 2 * backward, unlogged)
    edges = edges[_plausible(edges, header)]
    return edges if follows else _with_first_latch(edges, frame, last_count)


def _plausible(edges: Edges, header: Mapping[str, int]) -> Numbers:
    """Edges whose time is not off by a whole turn of its 32 bits.

    A log is in order, and no edge lies between the latched last edge and the last row. Both hold unless an edge is
    older than the 32 bits tell apart.
    """
    latest = header["last_time"] - header["last_age"] + SAME_EDGE_CLOCKS
    wrong = (edges.time > latest) & (edges.time <= header["last_time"])
    rises = np.diff(edges.time, prepend=edges.time[:1]) >= 0
    # What comes before a fall in time, or a wrong edge, is older still.
    bad = np.flatnonzero(wrong | ~rises)
    keep = np.ones(len(edges), bool)
    if len(bad):
        first_good = bad[-1] + 1 if wrong[bad[-1]] else bad[-1]
        keep[:first_good] = False
    return keep


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
    latch = Edges(*(np.array([value], np.int64) for value in (time, count + down, count, count - 1 + 2 * down, -1)))
    return edges[:at] + latch + edges[at:]
