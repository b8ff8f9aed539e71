"""Quadrature decoder of an incremental encoder."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

from .filter import LENGTH_BITS, GlitchFilter

SYNCHRONISER_STAGES = 2
UNKNOWN = (1 << 32) - 1
"""Age and period before the edges that they need, and the value at which they saturate."""


@dataclass(frozen=True)
class Move:
    """A transition: when the pins changed, the count after it, and its kind."""

    time: int
    count: int
    backward: bool
    illegal: bool


class Quadrature(wiring.Component):
    """Counts every edge of A and B (x4), forward where A leads B.

    Forward is A, B = 00, 10, 11, 01, 00. Both pins pass a synchroniser and a :class:`GlitchFilter`. When both
    change in the same clock, the direction is unknown: the transition is counted as illegal and moves nothing.
    The level of the pins after reset is taken as it is, without a count.

    Latency from pin to outputs is the constant :meth:`latency` for clean edges. An edge with
    glitches counts from its last glitch on. All outputs belong together: seen at clock c, they are the state at
    pin time ``c - latency``, edges of that very clock included. No edge is lost up to one a clock, as
    long as each pin is stable for ``length`` clocks between its own edges. ``swap`` turns the direction of the edges
    to come and moves nothing itself. ``count`` wraps at 32 bits.

    Members
    -------
    a, b : pins, asynchronous
    length : length of the glitch filter in clocks, 0 acts as 1
    swap : A and B are swapped
    count : counts, signed
    edge : strobe, ``count`` has just moved
    backward : direction of the last edge
    illegal : strobe, both pins changed
    illegals : illegal transitions since reset, saturating
    age : clocks since the last edge, 0 in the clock of ``edge``; saturates, :data:`UNKNOWN` before the first edge,
        but for the clock after reset
    period : clocks between the last two edges; saturates, :data:`UNKNOWN` before the second edge
    """

    a: In(1)
    b: In(1)
    length: In(LENGTH_BITS)
    swap: In(1)
    count: Out(signed(32))
    edge: Out(1)
    backward: Out(1)
    illegal: Out(1)
    illegals: Out(16)
    age: Out(32)
    period: Out(32, init=UNKNOWN)

    @staticmethod
    def latency(length: int) -> int:
        """Clocks from a pin's change to the outputs."""
        return SYNCHRONISER_STAGES + max(length, 1) + 3

    @staticmethod
    def reference(a: Sequence[int], b: Sequence[int], length: int, swap: bool = False) -> Iterator[Move]:
        """The definition: what the levels of the pins, one for each clock from reset on, mean."""
        phases = [  # position within a cycle of four edges
            {(0, 0): 0, (1, 0): 1, (1, 1): 2, (0, 1): 3}[levels]
            for levels in zip(GlitchFilter.reference(a, length), GlitchFilter.reference(b, length), strict=True)
        ]
        count, backward = 0, False
        for time in range(1, len(phases)):
            step = (phases[time] - phases[time - 1]) % 4
            if step in (1, 3):
                backward = (step == 3) != swap
                count += -1 if backward else 1
            if step:
                yield Move(time, count, backward, step == 2)

    def elaborate(self, platform: object) -> Module:
        m = Module()

        # After reset the filters take the level of the pins once it has come through the synchronisers;
        # the clock after that, `before` holds it too, and transitions mean something.
        warm_up = Signal(range(SYNCHRONISER_STAGES + 2))
        adopted = Signal()
        started = Signal()
        m.d.comb += adopted.eq(warm_up == SYNCHRONISER_STAGES + 1)
        m.d.sync += started.eq(adopted)
        with m.If(~adopted):
            m.d.sync += warm_up.eq(warm_up + 1)

        levels = []
        for name, pin in (("a", self.a), ("b", self.b)):
            steady = Signal(name=f"{name}_steady")
            m.submodules[f"synchroniser_{name}"] = FFSynchronizer(pin, steady, stages=SYNCHRONISER_STAGES)
            m.submodules[f"filter_{name}"] = level = GlitchFilter()
            m.d.comb += [level.i.eq(steady), level.length.eq(self.length), level.adopt.eq(~adopted)]
            levels.append(level.o)
        a, b = levels
        # Gray code: on a step forward the new A differs from the old B, whichever moves; on a step back they are equal.
        before = Signal(2)
        moved = Signal(2)
        equal = Signal()
        m.d.sync += [before.eq(Cat(a, b)), equal.eq(a == before[1])]
        with m.If(started):
            m.d.sync += moved.eq(Cat(a, b) ^ before)
        edge = Signal()
        backward = Signal()
        illegal = Signal()
        m.d.sync += [edge.eq(moved.xor()), illegal.eq(moved.all()), backward.eq(equal ^ self.swap)]

        # An edge resets the age, and so does the reset: what it is before the first edge is added to it.
        next_age = Signal(32)
        saturated = Signal(init=1)  # the age is at its end, known a clock ahead
        begun = Signal()
        m.d.comb += next_age.eq(self.age + Cat(~begun | ~saturated, (~begun).replicate(31)))
        m.d.sync += saturated.eq(~edge & (saturated | (self.age == UNKNOWN - 1)))
        m.d.sync += [begun.eq(1), self.edge.eq(edge), self.illegal.eq(illegal), self.age.eq(next_age)]
        with m.If(edge):
            m.d.sync += [
                self.count.eq(self.count + Mux(backward, -1, 1)),
                self.backward.eq(backward),
                self.age.eq(0),
                self.period.eq(next_age),
            ]
        with m.If(illegal & ~self.illegals.all()):
            m.d.sync += self.illegals.eq(self.illegals + 1)
        return m
