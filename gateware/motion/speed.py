"""Speed of the encoder from the times of its edges: right at a hundred counts a second and at a million."""

from dataclasses import dataclass

from .assembly import Program
from .quadrature import UNKNOWN

FRACTION_BITS = 8
"""Speeds are signed Q23.8 in counts a second."""

GREATEST = (1 << 31) - 1
"""Speed at which the measurement saturates, in both directions: 8.4 million counts a second."""

MOVED_BITS = 16


@dataclass(frozen=True)
class Measured:
    """What :meth:`SpeedMeter.reference` remembers from tick to tick: ``since`` is the age of the edge that counts
    as the last one seen, None before the first.
    """

    position: int = 0
    edge_time: int | None = None
    speed: int = 0


class SpeedMeter:
    """Counts by time, between the newest edge and the newest one of the tick before.

    A window of fixed length counts whole edges, and at 150 counts a second and 1 ms there are none in most. So the
    window ends at edges: ``moved * clock_hz / interval`` is exact at constant speed whatever its size. While no edge
    comes the speed is at most one count in the time since the last one, so it tends to 0 as the encoder stands. An
    edge that is passed twice lies in one place: turning round measures 0.

    Up to 65535 edges between two ticks; beyond that, and beyond :data:`GREATEST`, it saturates.
    """

    @staticmethod
    def reference(now: Measured, *, time: int, count: int, backward: bool, age: int, clock_hz: int) -> Measured:
        """The definition: what a tick at ``time`` makes of ``now``."""
        if age == UNKNOWN:
            return now
        position, edge_time = count + backward, time - age
        if now.edge_time is None:
            return Measured(position, edge_time, 0)
        if edge_time == now.edge_time:
            limit = (clock_hz << FRACTION_BITS) // age
            speed = min(abs(now.speed), limit, GREATEST)
            return Measured(position, edge_time, -speed if now.speed < 0 else speed)
        moved = min(abs(position - now.position), (1 << MOVED_BITS) - 1)
        interval = min(time - now.edge_time, UNKNOWN) - age
        speed = min((moved * clock_hz << FRACTION_BITS) // interval, GREATEST)
        return Measured(position, edge_time, -speed if position < now.position else speed)

    @staticmethod
    def program(p: Program) -> None:
        """``speed`` from ``count``, ``age``, ``time`` and the flag ``backward``."""
        p.variable("speed", "known", "since", "before", "place", "last_place", "moved", "interval", "scratch")

        # `since`: clocks since the edge of the tick before. Times are those of a 32-bit clock.
        p.load("time")
        p.subtract("before")
        with p.when("negative"):
            p.add(1 << 32)
        p.add("since")
        p.at_most(UNKNOWN, "since")
        p.put_copy("time", "before")

        p.load("age")
        p.subtract(UNKNOWN)
        with p.when("negative"):
            p.load("count")
            with p.when("backward"):
                p.add(1)
            p.store("place")
            p.load("known")
            with p.when("negative"):
                SpeedMeter._measure(p)
            p.put(-1, "known")
            p.put_copy("place", "last_place")
            p.put_copy("age", "since")

    @staticmethod
    def _measure(p: Program) -> None:
        p.load("since")
        p.subtract("age")
        p.store("interval")
        p.subtract(1)
        with p.when("negative"):  # no new edge
            p.put_copy("age", "interval")
            p.put_copy("speed", "moved")  # for its sign
            SpeedMeter._divide(p, 1)
            p.store("since")
            p.load_magnitude("speed")
            p.at_most("since", "scratch")
            p.store("scratch")
        with p.otherwise():
            p.load("place")
            p.subtract("last_place")
            p.store("moved")
            p.load_magnitude("moved")
            p.at_most((1 << MOVED_BITS) - 1, "scratch")
            SpeedMeter._divide(p, "scratch")
            p.store("scratch")
        p.load("moved")
        with p.when("negative"):
            p.load_negative("scratch")
        with p.otherwise():
            p.load("scratch")
        p.store("speed")
        p.output("speed")

    @staticmethod
    def _divide(p: Program, counts: str | int) -> None:
        """A = counts / interval, in counts a second; 24 steps leave ``counts * clock_hz << 8`` in A and L."""
        p.load(counts)
        p.to_low()
        p.load(0)
        p.multiply("clock_hz", MOVED_BITS + FRACTION_BITS)
        p.store("scratch")
        p.subtract("interval")
        with p.when("negative"):  # or else the quotient has more than 32 bits
            p.load("scratch")
            p.divide("interval", 32)
            p.load_low()
            p.at_most(GREATEST, "scratch")
        with p.otherwise():
            p.load(GREATEST)
