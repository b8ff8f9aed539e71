"""When it was: the card's clock mapped to the computer's.

A packet cannot come before what it reports has happened, and some packets come with hardly a delay. So the line below
all (card time, arrival less card time), as near to them as can be, is the offset and drift of the two clocks, up to the
least delay of the link; one that was held up does not move it. The line that minimises the sum of the distances lies on
the edge of the lower convex hull above which the mean card time is.

Sources: S. B. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from network delay measurements",
INFOCOM 1999 (the linear programme); L. Zhang, Z. Liu, C. H. Xia, "Clock synchronization algorithms for network
measurements", INFOCOM 2002 (its solution by the convex hull).
"""

import time
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise

MAX_DRIFT = 500e-6
"""Crystals differ by 100 ppm at most: an edge steeper than this is from too short a time, and no drift is told."""


NOT_REAL_TIME = 0.02
"""A card whose clock is off by more than this for more than a second is a virtual one that does not keep pace."""


@dataclass(frozen=True)
class Mapping:
    """Host time = ``offset_s`` + (1 + ``drift``) * card time.

    Attributes
    ----------
    offset_s : host time, s since 1970 UTC, of the card's time 0
    drift : of the host's clock against the card's; 0 until it can be told
    """

    offset_s: float
    drift: float

    def host_s(self, card_s: float) -> float:
        """Seconds since 1970 UTC."""
        return self.offset_s + (1 + self.drift) * card_s

    def text(self, card_s: float) -> str:
        """The moment as ISO 8601, UTC, to the microsecond."""
        return datetime.fromtimestamp(self.host_s(card_s), UTC).isoformat(timespec="microseconds")


class CardClock:
    """Estimates a :class:`Mapping` from arrivals. Each takes constant time on average.

    The host's clock is its monotonic one, tied to the calendar once: a step of the calendar does not tear a scan.

    Parameters
    ----------
    epoch_s : time 0 of the arrivals, s since 1970; by default they are of the monotonic clock
    """

    def __init__(self, epoch_s: float | None = None) -> None:
        self._epoch_s = time.time() - time.monotonic() if epoch_s is None else epoch_s
        self.reset()

    def reset(self) -> None:
        """The card was reset: its time began anew."""
        self._hull: list[tuple[float, float]] = []
        self._sum_s = 0.0
        self._count = 0

    def add(self, card_s: float, arrival_s: float) -> None:
        """What happened at ``card_s`` was told by a packet that came at ``arrival_s``."""
        point = (card_s, arrival_s - card_s)
        self._sum_s += card_s
        self._count += 1
        hull = self._hull
        if hull and card_s <= hull[-1][0]:
            return  # the order of times is the hull's; one that is no later tells nothing new
        while len(hull) > 1 and _turn(hull[-2], hull[-1], point) <= 0:
            hull.pop()
        hull.append(point)

    @property
    def mapping(self) -> Mapping | None:
        """The best so far; None before the first packet, and for a card that does not keep pace with the wall clock."""
        hull = self._hull
        if not hull:
            return None
        mean = self._sum_s / self._count
        for left, right in pairwise(hull):
            if left[0] <= mean <= right[0]:
                drift = (right[1] - left[1]) / (right[0] - left[0])
                if abs(drift) <= MAX_DRIFT:
                    return Mapping(self._epoch_s + left[1] - drift * left[0], drift)
                if abs(drift) > NOT_REAL_TIME and hull[-1][0] - hull[0][0] > 1.0:
                    return None
        return Mapping(self._epoch_s + min(offset for _, offset in hull), 0.0)

    def delay_s(self, card_s: float, arrival_s: float) -> float | None:
        """How much later than the quickest packets one came."""
        mapping = self.mapping
        return None if mapping is None else self._epoch_s + arrival_s - mapping.host_s(card_s)


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Positive where the way from a over b to c turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
