"""Index barrier: the one place of the turn that is known."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import IndexPolicy

from .filter import LENGTH_BITS, GlitchFilter
from .quadrature import Move


@dataclass(frozen=True)
class Pass:
    """A pass of the index: time and count of its edge, direction, and by how much the count is
    not what the pass before lets expect (None for the first one).
    """

    time: int
    count: int
    backward: bool
    difference: int | None


class Index(wiring.Component):
    """Latches the count at the leading edge of the index barrier.

    The leading edge is where the input rises on the way forward, and falls on the way backward: one physical
    edge, in the middle of one count. ``invert`` makes it the other way round. The trailing edge is ignored.

    The latch has count and time of the first change of the input; debouncing only decides, ``debounce``
    stable clocks later, whether it was one. A change that goes back within that was none.

    The direction of a pass is exact, in reversals too: a count is entered with an edge of the encoder,
    whose direction the first crossing shares; each further crossing within that count goes the other way. This
    needs a barrier of at least two counts. Before the first edge of the encoder no direction is known, and
    nothing passes.

    ``zero_count`` is the count from which angles count. ``policy`` says what a pass does to it: makes it the pass's
    (``RESET``), nothing (``LATCH``), or makes it the pass's only the first time since the policy was set
    (``FIRST``). The count itself is never reset: the edges of an image would lie on two scales.

    With ``counts_per_turn`` every pass is checked against the one before: one turn lies between two passes in the
    same direction, and nothing between two in opposite ones.

    All inputs but the settings are seen at the same pin time, see :class:`gateware.motion.filter.Align`.
    Latency: ``passed`` and the latches follow the confirmation by two clocks, ``turns`` and ``difference`` by four.
    At most one pass in four clocks.

    Members
    -------
    level, valid : barrier; its level where ``valid`` first becomes 1 is taken as it is
    time, count, edge, backward : time, and outputs of the decoder at that time
    debounce : clocks, 0 acts as 1
    invert : the barrier is active low
    counts_per_turn : 0 for no check
    policy : a :class:`magtrak.protocol.IndexPolicy`
    passed : strobe, the latches are new
    pass_time, pass_count, pass_backward : latched at the last pass
    passes : passes since reset, modulo 65536
    seen : there has been a pass
    zero_count : see above; changes with the latches
    difference : counts by which the last pass was off
    turns : passes that were off, saturating
    wrong : strobe, ``turns`` has been counted
    """

    level: In(1)
    valid: In(1)
    time: In(48)
    count: In(signed(32))
    edge: In(1)
    backward: In(1)
    debounce: In(LENGTH_BITS)
    invert: In(1)
    counts_per_turn: In(24)
    policy: In(2)
    passed: Out(1)
    pass_time: Out(48)
    pass_count: Out(signed(32))
    pass_backward: Out(1)
    passes: Out(16)
    seen: Out(1)
    zero_count: Out(signed(32))
    difference: Out(signed(32))
    turns: Out(16)
    wrong: Out(1)

    @staticmethod
    def reference(
        levels: Sequence[int], moves: Sequence[Move], debounce: int, invert: bool = False, counts_per_turn: int = 0
    ) -> Iterator[Pass]:
        """The definition, for one level a clock from reset on and the moves of the encoder."""
        stable = GlitchFilter.reference(levels, debounce)
        edges = [move for move in moves if not move.illegal]
        crossings: list[int] = []
        before = None
        for settled in range(1, len(levels)):
            old, new = stable[settled - 1 : settled + 1]
            if old == new:
                continue
            # The disturbance begins where the input was last stable at the old level, or at the start.
            quiet = 0
            for time in range(settled - 1, -1, -1):
                quiet = quiet + 1 if levels[time] == old else 0
                if quiet >= debounce or levels[: time + 1] == [old] * (time + 1):
                    break
            start = next(t for t in range(time, settled + 1) if levels[t] != old)
            entered = max((edge for edge in edges if edge.time <= start), key=lambda edge: edge.time, default=None)
            if entered is not None:
                here = sum(entered.time <= crossing for crossing in crossings)
                backward = entered.backward != bool(here % 2)
                if (new != invert) != backward:
                    difference = None
                    if before is not None and counts_per_turn:
                        turn = 0 if before.backward != backward else -counts_per_turn if backward else counts_per_turn
                        difference = entered.count - before.count - turn
                    before = Pass(start, entered.count, backward, difference)
                    yield before
            crossings.append(start)

    def elaborate(self, platform: object) -> Module:
        m = Module()

        # Whether the level has lasted as long as it must: known a clock ahead, for the case that it stays.
        last = Signal()
        # Two clocks ahead.
        clocks = Signal(LENGTH_BITS + 1, init=3)
        same = Signal()
        settled = Signal()
        at_once = Signal()
        by_staying = Signal()
        m.d.comb += [
            same.eq(self.level == last),
            settled.eq(Mux(same, by_staying, at_once)),
        ]
        m.d.sync += [last.eq(self.level), at_once.eq(self.debounce <= 1)]
        with m.If(same):
            m.d.sync += by_staying.eq(clocks >= self.debounce)
            with m.If(~clocks[-1]):
                m.d.sync += clocks.eq(clocks + 1)
        with m.Else():
            m.d.sync += [by_staying.eq(self.debounce <= 2), clocks.eq(3)]

        # The direction in which the barrier would be crossed now.
        known = Signal()
        crossed = Signal()
        known_now = Signal()
        crossed_now = Signal()
        backward_now = Signal()
        m.d.comb += [
            known_now.eq(known | self.edge),
            crossed_now.eq(crossed & ~self.edge),
            backward_now.eq(self.backward ^ crossed_now),
        ]
        m.d.sync += [known.eq(known_now), crossed.eq(crossed_now)]

        # The first change, kept until it is confirmed or turns out to be none.
        started = Signal()
        stable = Signal()
        pending = Signal()
        changed = Signal()
        first = Signal()
        confirmed = Signal()
        kept_time = Signal(48)
        kept_count = Signal(signed(32))
        kept_backward = Signal()
        kept_known = Signal()
        kept_here = Signal()
        m.d.comb += [
            changed.eq(started & (self.level != stable)),
            first.eq(changed & ~pending),
            confirmed.eq(changed & settled),
        ]
        m.d.sync += kept_here.eq((kept_here & ~self.edge) | first)
        with m.If(first):
            m.d.sync += [
                kept_time.eq(self.time),
                kept_count.eq(self.count),
                kept_backward.eq(backward_now),
                kept_known.eq(known_now),
            ]
        with m.If(settled):
            m.d.sync += pending.eq(0)
        with m.Elif(first):
            m.d.sync += pending.eq(1)
        with m.If(self.valid & ~started):
            m.d.sync += [started.eq(1), stable.eq(self.level)]
        with m.Elif(confirmed):
            m.d.sync += [
                stable.eq(self.level),
                crossed.eq(crossed_now ^ (first | (kept_here & ~self.edge))),
            ]

        backward = Signal()
        passing = Signal()
        m.d.comb += [
            backward.eq(Mux(first, backward_now, kept_backward)),
            passing.eq(confirmed & Mux(first, known_now, kept_known) & (self.level ^ self.invert ^ backward)),
        ]
        # A clock later what is kept is that of the pass, also where it was confirmed at once.
        latching = Signal()
        latching_backward = Signal()
        m.d.sync += [latching.eq(passing), latching_backward.eq(backward), self.passed.eq(latching)]
        taken = Signal()  # the first pass of the policy is over
        with m.If(self.policy != IndexPolicy.FIRST):
            m.d.sync += taken.eq(0)
        moved = Signal(signed(32))
        turn = Signal(signed(25))
        forward = Signal()
        with m.If(latching):
            with m.If((self.policy == IndexPolicy.RESET) | ((self.policy == IndexPolicy.FIRST) & ~taken)):
                m.d.sync += self.zero_count.eq(kept_count)
            with m.If(self.policy == IndexPolicy.FIRST):
                m.d.sync += taken.eq(1)
            m.d.sync += [
                self.pass_time.eq(kept_time),
                self.pass_count.eq(kept_count),
                self.pass_backward.eq(latching_backward),
                self.passes.eq(self.passes + 1),
                self.seen.eq(1),
                moved.eq(kept_count - self.pass_count),
                forward.eq(~latching_backward),
                turn.eq(Cat(self.counts_per_turn, 0) ^ (~latching_backward).replicate(25)),
            ]
            with m.If(latching_backward != self.pass_backward):
                m.d.sync += [forward.eq(0), turn.eq(0)]

        # The check has one addition a clock: counts since the pass before, less the turn, compared with zero.
        compare = Signal()
        check = Signal()
        m.d.sync += [compare.eq(latching & self.seen & (self.counts_per_turn != 0)), check.eq(compare)]
        with m.If(compare):
            m.d.sync += self.difference.eq((Cat(1, moved) + Cat(forward, turn).as_signed())[1:])
        m.d.sync += self.wrong.eq(check & self.difference.any())
        with m.If(check & self.difference.any() & ~self.turns.all()):
            m.d.sync += self.turns.eq(self.turns + 1)
        return m
