"""Encoder edges of a stream of frames: where the encoder certainly was, and when."""

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

from .frames import Frame

SATURATED_AGE = 2**32 - 1

# An edge may be logged until shortly after the last row of its frame; of the 2^32 clocks (29 s at 148.5 MHz) that its
# time tells apart this part is taken as after the last row, the rest as before.
_AFTER_CLOCKS = 2**28

# The latch and the log may see the same edge some clocks apart.
SAME_EDGE_CLOCKS = 16


class Edge(NamedTuple):
    """An edge of the encoder's signals.

    Attributes
    ----------
    time : clocks since reset, unwrapped
    position : counts, unwrapped: an edge lies at a whole count
    shown : count after the edge: until the next edge the encoder is within [shown, shown + 1)
    before : count before the edge
    unlogged : at most so many edges came between the one before and this one, and are not here; -1: nobody knows
    """

    time: int
    position: int
    shown: int
    before: int
    unlogged: int


def wrapped_difference(a: int, b: int, bits: int = 32) -> int:
    """a - b modulo 2^bits, as a signed number."""
    half = 1 << (bits - 1)
    return ((a - b + half) & ((1 << bits) - 1)) - half


def edges_of_frame(
    frame: Frame, last_count: int, *, follows: bool, shift_before: int, count_before: int | None = None
) -> list[Edge]:
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
    if not frame.edges:
        return _of_latches(header, last_count, count_before)
    latest = header["last_time"] + _AFTER_CLOCKS
    left_out = (1 << header["edge_shift"]) - 1
    # Between two logs each may have left out its share.
    unlogged = left_out + (1 << shift_before) - 1 if follows else -1
    edges = []
    for low, shown, down in frame.edges:
        time = latest - ((latest - low) & 0xFFFF_FFFF)
        count = last_count + wrapped_difference(shown, header["last_count"], 31)
        edges.append(_edge(time, count, down, unlogged))
        unlogged = left_out
    edges = _plausible(edges, header)
    return edges if follows else _with_first_latch(edges, frame, last_count)


def _edge(time: int, count: int, down: int, unlogged: int) -> Edge:
    """``count`` is that after it; ``down`` is 1 where the encoder went backward."""
    return Edge(time, count + down, count, count - 1 + 2 * down, unlogged)


def _of_latches(header: Mapping[str, int], last_count: int, count_before: int | None) -> list[Edge]:
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
            time = header[f"{row}_time"] - header[f"{row}_age"]
            found.append(_edge(time, count, int(count < before), -1))
    return sorted(found)


def _plausible(edges: list[Edge], header: Mapping[str, int]) -> list[Edge]:
    """Those edges whose time is not off by a whole turn of its 32 bits.

    A log is in order, and no edge lies between the latched last edge and the last row. Both hold unless an edge is
    older than the 32 bits tell apart.
    """
    latest = header["last_time"] - header["last_age"] + SAME_EDGE_CLOCKS
    # What comes before a fall in time, or a wrong edge, is older still.
    start, before = 0, edges[0].time
    for number, edge in enumerate(edges):
        if latest < edge.time <= header["last_time"]:
            start = number + 1
        elif edge.time < before:
            start = number
        before = edge.time
    return edges[start:]


def _with_first_latch(edges: list[Edge], frame: Frame, last_count: int) -> list[Edge]:
    """Add the edge latched at the first row, where its direction can be told.

    At the start of a stream, or after a lost frame, the log alone does not reach back to the first row.
    """
    header = frame.header
    if header["first_age"] == SATURATED_AGE or not edges:
        return edges
    time = header["first_time"] - header["first_age"]
    count = last_count + wrapped_difference(header["first_count"], header["last_count"])
    if any(abs(edge.time - time) <= SAME_EDGE_CLOCKS for edge in edges):
        return edges
    at = sum(edge.time < time for edge in edges)
    before, after = edges[:at], edges[at:]
    neighbours = before[-1:] + after[:1]
    if len({edge.before > edge.shown for edge in neighbours}) > 1:
        return edges
    down = int(neighbours[0].before > neighbours[0].shown)
    # Where the counts do not fit between the neighbours, the encoder turned round in between.
    counts = [*(edge.shown for edge in before[-1:]), count, *(edge.shown for edge in after[:1])]
    if any((right - left) * (1 - 2 * down) <= 0 for left, right in pairwise(counts)):
        return edges
    return [*before, _edge(time, count, down, -1), *after]
