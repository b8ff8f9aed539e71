"""Speed of the encoder from the times of its edges: right at a hundred counts a second and at a million."""

from dataclasses import dataclass

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..arithmetic import SerialDivider
from .quadrature import UNKNOWN

FRACTION_BITS = 8
"""Speeds are signed Q23.8 in counts a second."""

GREATEST = (1 << 31) - 1
"""Speed at which the measurement saturates, in both directions: 8.4 million counts a second."""

MOVED_BITS = 16
CLOCKS = 6 + MOVED_BITS + 33
"""Of a measurement: 16 steps of a product, 32 of a quotient."""


@dataclass(frozen=True)
class Measured:
    """What :meth:`SpeedMeter.reference` remembers from tick to tick: ``since`` is the age of the edge that counts
    as the last one seen, None before the first.
    """

    position: int = 0
    edge_time: int | None = None
    speed: int = 0


class SpeedMeter(wiring.Component):
    """Counts by time, between the newest edge and the newest one of the tick before.

    A window of fixed length counts whole edges, and at 150 counts a second and 1 ms there are none in most. So the
    window ends at edges: ``moved * clock_hz / interval`` is exact at constant speed whatever its size. While no edge
    comes the speed is at most one count in the time since the last one, so it tends to 0 as the encoder stands. An
    edge that is passed twice lies in one place: turning round measures 0.

    Latency: :data:`CLOCKS` from ``tick`` to ``done``; ticks that come earlier are left out. Up to 65535 edges
    between two ticks; beyond that, and beyond :data:`GREATEST`, it saturates.

    Members
    -------
    tick : strobe: measure
    count, backward, age : outputs of the decoder, together
    clock_hz : frequency of the clock, constant
    speed : signed Q23.8, counts a second
    done : strobe: ``speed`` is new
    """

    tick: In(1)
    count: In(signed(32))
    backward: In(1)
    age: In(32)
    clock_hz: In(32)
    speed: Out(signed(32))
    done: Out(1)

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

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.divider = divider = SerialDivider(32, 32)

        known = Signal()
        since = Signal(32)  # clocks since the edge of the tick before
        position, last = Signal(signed(33)), Signal(signed(33))
        with m.If(since != UNKNOWN):
            m.d.sync += since.eq(since + 1)

        moved, span = Signal(signed(34)), Signal(34)
        fresh, backward = Signal(), Signal()
        interval = Signal(32)
        factor = Signal(MOVED_BITS)
        # The product enters at the top and moves down a bit a step: 2**16 * 2**32 = 2**48, and an adder of 33 bits.
        high, low = Signal(32), Signal(MOVED_BITS)
        total = Signal(33)
        steps = Signal(range(MOVED_BITS + 1))
        magnitude, result = Signal(31), Signal(31)
        over = Signal()
        m.d.comb += [
            total.eq(high + Mux(factor[0], self.clock_hz, 0)),
            divider.dividend.eq(Cat(low, high) << FRACTION_BITS),
            divider.divisor.eq(interval),
        ]
        m.d.sync += self.done.eq(0)
        with m.FSM():
            with m.State("Wait"):
                m.d.sync += [
                    position.eq(self.count + self.backward),
                    fresh.eq(self.age != since),
                    interval.eq(Mux(self.age != since, since - self.age, self.age)),
                    steps.eq(MOVED_BITS),
                ]
                with m.If(self.tick):
                    with m.If(self.age == UNKNOWN):
                        m.d.sync += self.done.eq(1)
                    with m.Else():
                        m.d.sync += since.eq(self.age + 1)
                        m.next = "Compare"

            with m.State("Compare"):
                m.d.sync += [moved.eq(position - last), last.eq(position), known.eq(1)]
                m.next = "Prepare"
                with m.If(~known):
                    m.d.sync += self.done.eq(1)
                    m.next = "Wait"

            with m.State("Prepare"):
                m.d.sync += span.eq(Mux(moved < 0, -moved, moved))
                m.next = "Saturate"

            with m.State("Saturate"):
                m.d.sync += [
                    factor.eq(Mux(fresh, Mux(span[MOVED_BITS:].any(), (1 << MOVED_BITS) - 1, span), 1)),
                    high.eq(0),
                    backward.eq(Mux(fresh, moved < 0, self.speed < 0)),
                    magnitude.eq(Mux(self.speed < 0, -self.speed, self.speed)),
                ]
                m.next = "Multiply"

            with m.State("Multiply"):
                m.d.sync += [Cat(low, high).eq(Cat(low[1:], total)), factor.eq(factor >> 1), steps.eq(steps - 1)]
                with m.If(steps == 1):
                    m.next = "Start"

            with m.State("Start"):
                m.d.comb += divider.start.eq(1)
                m.d.sync += over.eq(high[FRACTION_BITS:] >= interval)
                m.next = "Divide"

            with m.State("Divide"):
                m.d.sync += result.eq(Mux(over | divider.quotient[-1], GREATEST, divider.quotient))
                with m.If(divider.done):
                    m.next = "Take"

            with m.State("Take"):
                m.d.sync += self.done.eq(1)
                # Without an edge, the speed can only be less than what it was.
                with m.If(fresh | (result < magnitude)):
                    m.d.sync += self.speed.eq(Mux(backward, -result, result))
                m.next = "Wait"
        return m
