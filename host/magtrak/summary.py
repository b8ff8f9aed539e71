"""What the receiver says while it runs and at the end."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterable, Iterator

from .card import Card
from .scan import Counts
from .stream import Statistics

PROGRESS_S = 0.2


class Rates:
    """Frames and bytes a second, and the usual delay of a frame, over the last second or so.

    Parameters
    ----------
    now_s : monotonic clock
    """

    WINDOW_S = 1.0

    def __init__(self, now_s: float) -> None:
        self._marks = [(now_s, 0, 0)]

    def update(self, now_s: float, frames: int, received: int) -> tuple[float, float]:
        """Frames and bytes a second; totals are given."""
        self._marks.append((now_s, frames, received))
        while len(self._marks) > 2 and self._marks[1][0] < now_s - self.WINDOW_S:
            del self._marks[0]
        then_s, frames_then, received_then = self._marks[0]
        span_s = max(now_s - then_s, 1e-9)
        return max(frames - frames_then, 0) / span_s, max(received - received_then, 0) / span_s


def summary(counts: Counts, link: Statistics, damaged_frames: int, card: Card | None, seconds: float) -> str:
    """The last line. ``link`` is over all links of the scan, ``card`` the last one, None for a replay."""
    parts = [
        f"{counts.frames} frames",
        f"{counts.points} points",
        f"{counts.lost_frames} lost frames ({counts.dropped_frames} dropped by the card)",
        f"{link.damaged + damaged_frames} damaged packets",
        f"{counts.encoder_errors} encoder errors",
    ]
    more = {
        "packets that never came": max(link.lost - link.damaged, 0),
        "restarts of the card": counts.restarts,
        "frames before the index": counts.unreferenced_frames,
        "frames of background": counts.dark_frames,
        "frames before the first background": counts.unsubtracted_frames,
        "points at standstill": counts.standing,
        "points below the least quality": counts.poor,
        "rays parallel to the laser plane": counts.parallel,
        "rays that meet it behind the camera": counts.behind,
    }
    if card is not None and counts.frames:
        parts.append(f"{counts.frames / seconds:.1f} frames/s at {link.bytes / seconds / 1e3:.0f} kB/s")
        if card.clock.mapping is not None:
            parts.append(f"frames late by {1e3 * median(card.delays_s):.1f} ms (median)")
    if card is not None and card.round_trips_s:
        parts.append(f"answers in {1e3 * median(card.round_trips_s):.1f} ms")
    return ", ".join(parts + [f"{number} {what}" for what, number in more.items() if number])


def median(values: Iterable[float]) -> float:
    """The upper one of two; 0 of none."""
    ordered = sorted(values)
    return ordered[len(ordered) // 2] if ordered else 0.0


@contextlib.contextmanager
def progress(line: Callable[[float], str]) -> Iterator[Callable[[], None]]:
    """A function that shows ``line(seconds since the start)`` on a terminal, over and over; elsewhere nothing."""
    if not sys.stderr.isatty():
        yield lambda: None
        return
    start = time.monotonic()
    last = [start]

    def show() -> None:
        now = time.monotonic()
        if now - last[0] >= PROGRESS_S:
            last[0] = now
            print(f"\r{line(now - start)}\x1b[K", end="", file=sys.stderr, flush=True)

    try:
        yield show
    finally:
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)
