"""What motion must never do, proved for every sequence of inputs.

``prove``: for ever, by induction. ``bmc``: for every sequence of the stated length from reset on.
"""

import pytest
from amaranth.hdl import Assert, Assume, Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from gateware.frame.alternation import Alternation
from gateware.motion.angle import AngleLatch
from gateware.motion.assembly import LOW_BITS, WORD_BITS, Op
from gateware.motion.interlock import SYNCHRONISER_STAGES, Interlock
from gateware.motion.pwm import SHORTEST_PERIOD, Pwm
from gateware.motion.quadrature import UNKNOWN, Quadrature
from gateware.motion.sequencer import Adder, Controls, controls
from magtrak.protocol import LASER_KEY, AmbientMode, Phase
from tests.support.formal import ProofError, past, prove


class LaserNeedsEveryCondition(wiring.Component):
    """No light without all of: closed interlock, live lease, key, sound motor, permission, delay gone by.

    Every input, the settings too, may change in every clock.
    """

    interlock: In(1)
    tick: In(1)
    arm: In(1)
    key: In(16)
    renew: In(1)
    lease_ms: In(16)
    delay_ms: In(16)
    sound: In(1)
    permitted: In(1)

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = Interlock()
        for name in self.signature.members:
            m.d.comb += getattr(dut, name).eq(getattr(self, name))

        # The conditions, counted once more.
        heard, keyed, ripe = Signal(), Signal(), Signal()
        silent, waited = Signal(17), Signal(17)
        m.d.sync += heard.eq(heard | self.renew)
        with m.If(self.renew):
            m.d.sync += silent.eq(0)
        with m.Elif(self.tick & ~silent[-1]):
            m.d.sync += silent.eq(silent + 1)
        alive = Signal()
        m.d.comb += alive.eq(heard & (silent < self.lease_ms))
        closed = past(m, self.interlock, SYNCHRONISER_STAGES)
        key = self.arm & (self.key == LASER_KEY)
        missing = ~closed | ~(self.renew | past(m, alive) | past(m, self.renew)) | ~self.sound
        missing |= self.arm & (self.key != LASER_KEY)
        with m.If(missing):
            m.d.sync += [keyed.eq(0), ripe.eq(0)]
        with m.Elif(~keyed):
            m.d.sync += [keyed.eq(key), waited.eq(0), ripe.eq(0)]
        with m.Else():
            m.d.sync += [waited.eq(waited + (self.tick & ~waited[-1])), ripe.eq(ripe | (waited > self.delay_ms))]

        was_closed, sound, permitted = (past(m, pin) for pin in (self.interlock, self.sound, self.permitted))
        recently = past(m, alive, 2) | past(m, self.renew) | past(m, self.renew, 2)
        with m.If(dut.laser):
            m.d.comb += [
                Assert(self.interlock),
                Assert(was_closed),
                Assert(closed),
                Assert(sound),
                Assert(permitted),
                Assert(recently),
                Assert(keyed),
                Assert(ripe),
                Assert(dut.lamp),
            ]
        # What makes it inductive: both count alike.
        m.d.comb += [
            Assert(silent == (~dut._silent)[:17]),
            Assert(dut.lamp == keyed),
            Assert(~keyed | (waited == (~dut._waited)[:17])),
            Assert(dut.state.closed == closed),
            Assert(dut.state.alive == (past(m, alive) | past(m, self.renew))),
            Assert(dut._emitting == ripe),
            Assert(~ripe | keyed),
            Assert(heard == dut._heard),
        ]
        return m


class BackgroundsAreDark(wiring.Component):
    """No light in an image that is a background, nor, in ``AmbientMode.SKIP``, in the one before it.

    Shutter and interlock are joined as in :class:`~gateware.motion.Motion`. Settings are those of an image: they may
    change at its start, an image being from a clock after ``frame_end`` to the next.
    """

    run: In(1)
    frame_first: In(1)
    frame_end: In(1)
    subtracted: In(1)
    interlock: In(1)
    tick: In(1)
    arm: In(1)
    key: In(16)
    renew: In(1)
    ambient_mode: In(2)
    ambient_measured: In(8)

    def elaborate(self, platform):
        m = Module()
        m.submodules.alternation = alternation = Alternation()
        m.submodules.interlock = interlock = Interlock()
        m.d.comb += [
            alternation.run.eq(self.run),
            alternation.frame_first.eq(self.frame_first),
            alternation.frame_end.eq(self.frame_end),
            alternation.subtracted.eq(self.subtracted),
            alternation.settings.ambient_mode.eq(self.ambient_mode),
            alternation.settings.ambient_measured.eq(self.ambient_measured),
            interlock.lease_ms.eq(1000),
            interlock.sound.eq(1),
            interlock.permitted.eq(alternation.laser),
        ]
        for name in ("interlock", "tick", "arm", "key", "renew"):
            m.d.comb += getattr(interlock, name).eq(getattr(self, name))

        background = alternation.phase == Phase.BACKGROUND
        ended = past(m, self.frame_end, init=1)
        m.d.comb += [
            # The shutter is a clock after the image's end; what remains of the gap is dark.
            Assert(~interlock.laser | past(m, alternation.laser, init=1)),
            Assert(~background | ~past(m, background) | ~interlock.laser),
            Assert(background == alternation.background),
            Assert(~background | ~alternation.laser),
            # No image becomes a background half-way.
            Assert(ended | ~background | past(m, background)),
        ]
        # Light since the first clock but one of this image, and of the one before.
        lit, lit_before = Signal(), Signal()
        m.d.sync += lit.eq((lit & ~ended) | (interlock.laser & ~ended))
        with m.If(self.frame_end):
            m.d.sync += lit_before.eq((lit & ~ended) | (interlock.laser & ~ended))
        mode = Signal(2)
        with m.If(self.frame_end):
            m.d.sync += mode.eq(self.ambient_mode)
        with m.If(background & (mode == AmbientMode.SKIP)):
            m.d.comb += Assert(~lit_before)
        # What makes it inductive: in an image that darkens, or is dark, there was no light so far.
        with m.If(~alternation.laser & ~ended):
            m.d.comb += Assert(~lit)
        return m


class CountIsThePosition(wiring.Component):
    """Count, direction, age and period of a shaft that moves as it likes, and the latch of them.

    ``move`` and ``backward`` step the shaft by one count; each pin then is stable for ``length`` clocks.
    """

    move: In(1)
    backward: In(1)
    row: In(1)

    def __init__(self, length: int) -> None:
        self.length = length
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = Quadrature()
        m.submodules.latch = latch = AngleLatch()

        position, age, period = Signal(signed(32)), Signal(32, init=UNKNOWN), Signal(32, init=UNKNOWN)
        last_backward = Signal()
        older = age != UNKNOWN
        now_position, now_age, now_period = Signal(signed(32)), Signal(32), Signal(32)
        now_backward = Signal()
        m.d.comb += [
            now_position.eq(position + Mux(self.move, Mux(self.backward, -1, 1), 0)),
            now_age.eq(Mux(self.move, 0, age + older)),
            now_period.eq(Mux(self.move, age + older, period)),
            now_backward.eq(Mux(self.move, self.backward, last_backward)),
        ]
        m.d.sync += [
            position.eq(now_position),
            age.eq(now_age),
            period.eq(now_period),
            last_backward.eq(now_backward),
        ]
        # 00, 10, 11, 01.
        a, b = now_position[0] ^ now_position[1], now_position[1]
        m.d.comb += [dut.a.eq(a), dut.b.eq(b), dut.length.eq(self.length)]
        for pin in (a, b):
            before = past(m, pin)
            for clocks in range(1, self.length):
                m.d.comb += Assume((pin == before) | (before == past(m, before, clocks)))

        first = Signal(init=1)
        m.d.sync += first.eq(0)
        started = Signal(range(8))
        with m.If(started != 7):
            m.d.sync += started.eq(started + 1)
            m.d.comb += Assume(~self.move)  # the level at reset is taken as it is
        with m.If(first):
            m.d.comb += Assume(~self.row)  # the age is there in the next clock
        latency = Quadrature.latency(self.length)
        model = ((now_position, 0), (now_age, UNKNOWN), (now_period, UNKNOWN), (now_backward, 0))
        then = [past(m, value, latency, init) for value, init in model]
        m.d.comb += [
            Assert(dut.count == then[0]),
            Assert(first | (dut.age == then[1])),
            Assert(dut.period == then[2]),
            Assert(~dut.edge | (dut.backward == then[3])),
            Assert(~dut.illegal),
        ]

        # The latch holds what belonged together in the clock of the strobe.
        time, kept = Signal(48), Signal(signed(32))
        kept_time, kept_age, kept_period, taken = Signal(48), Signal(32), Signal(32), Signal()
        m.d.sync += time.eq(time + 1)
        m.d.comb += [
            latch.row_first.eq(self.row),
            latch.now.time.eq(time),
            latch.now.count.eq(dut.count),
            latch.now.age.eq(dut.age),
            latch.now.period.eq(dut.period),
        ]
        with m.If(self.row):
            m.d.sync += [kept.eq(then[0]), kept_age.eq(then[1]), kept_period.eq(then[2])]
            m.d.sync += [kept_time.eq(time), taken.eq(1)]
        with m.If(taken):
            m.d.comb += [
                Assert(latch.last.count == kept),
                Assert(latch.last.age == kept_age),
                Assert(latch.last.period == kept_period),
                Assert(latch.last.time == kept_time),
            ]
        return m


class PulsesAreExact(wiring.Component):
    """Each period has one pulse, from its start on, as long as the definition says; the duty may change in every clock.

    Where the direction turns there is none, for half a period before and after.
    """

    duty: In(signed(16))
    antiphase: In(1)

    def __init__(self, period: int) -> None:
        self.period = period
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = Pwm()
        fixed = Signal()  # the kind of bridge does not change
        m.d.sync += fixed.eq(self.antiphase)
        first = Signal(init=1)
        m.d.sync += first.eq(0)
        m.d.comb += [
            Assume(first | (self.antiphase == fixed)),
            dut.duty.eq(self.duty),
            dut.period.eq(self.period),
            dut.enable.eq(1),
            dut.antiphase.eq(self.antiphase),
        ]
        # The first two periods after reset are of the shortest length.
        place, number = Signal(16), Signal(8)
        length = Mux(number < 2, SHORTEST_PERIOD, self.period)
        end = place == length - 1
        m.d.sync += [place.eq(Mux(end, 0, place + 1))]
        with m.If(end):
            m.d.sync += number.eq(number + 1)
        # Taken at the end of a period, in force in the one after the next.
        taken, rules = Signal(signed(16)), Signal(signed(16))
        with m.If(end):
            m.d.sync += [taken.eq(self.duty), rules.eq(taken)]
        magnitude = Mux(rules == -32768, 32767, Mux(rules < 0, -rules, rules))
        raised = Cat(rules[1:15], ~rules[15])
        high = Signal(16)
        m.d.comb += high.eq(Mux(self.antiphase, raised, magnitude) * self.period >> 15)
        steady = number >= 2
        # The output follows the place by a clock.
        before = past(m, dut.direction)
        here, was_high, was_steady = past(m, place), past(m, high), past(m, steady)
        inside = here < was_high
        turning = Signal()
        with m.If(end):
            m.d.sync += turning.eq((taken != 0) & ((taken < 0) != dut.direction))
        silent = past(m, turning)
        with m.If(was_steady):
            with m.If(self.antiphase):
                m.d.comb += [Assert(dut.pwm), Assert(dut.direction == ~inside)]
            with m.Else():
                m.d.comb += [Assert(dut.pwm == (inside & ~silent))]
                turned = dut.direction != before
                m.d.comb += Assert(~turned | (silent & (here == (self.period - 1 >> 1) + 1)))
        return m


class ArithmeticIsExact(wiring.Component):
    """One step of each instruction, for every accumulator, L and operand.

    With A and L as one number ``A << 32 | L``, a step of a product adds the operand, if L is odd, and halves. From it
    follows the product, step by step.

    A quotient is that of a division that never restores: A is the remainder, less the operand where the last digit was
    0. A step of two clocks makes of such an A the digit, and the next such A.
    """

    controls: In(Controls)
    a: In(signed(WORD_BITS))
    b: In(signed(WORD_BITS))
    low: In(LOW_BITS)
    rest: In(LOW_BITS)
    digit: In(1)

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = Adder()
        a, b, low, result, next_low = self.a, self.b, self.low, dut.result, dut.next_low
        m.d.comb += [getattr(dut, name).eq(getattr(self, name)) for name in ("controls", "a", "b", "low")]
        both, after = Signal(signed(WORD_BITS + LOW_BITS)), Signal(signed(WORD_BITS + LOW_BITS))
        m.d.comb += [both.eq(Cat(low, a)), after.eq(Cat(next_low, result))]

        def does(op):
            return self.controls.as_value() == Controls.const(controls(op)).as_value()

        bound = 1 << WORD_BITS - 1
        added = a + b
        for op, value in (
            (Op.LOAD, b),
            (Op.LOAD_NEGATIVE, -b),
            (Op.ADD, added),
            (Op.SUBTRACT, a - b),
        ):
            with m.If(does(op) & (value < bound) & (value >= -bound)):
                if op in (Op.LOAD, Op.LOAD_NEGATIVE):
                    m.d.comb += Assume(a == 0)  # as the sequencer has it
                m.d.comb += Assert(result == value)
        with m.If(does(Op.WRAP)):
            m.d.comb += Assume(b == 0)  # likewise
            m.d.comb += Assert(result == a[:32].as_signed())
        with m.If(does(Op.TO_LOW)):
            m.d.comb += Assert(next_low == a[:32])
        with m.If(does(Op.MULTIPLY) & (added < bound) & (added >= -bound)):
            m.d.comb += Assert(after == (both + (Mux(low[0], b, 0) << LOW_BITS)) >> 1)

        m.submodules.then = then = Adder()
        m.d.comb += [
            *(then.controls.eq(dut.controls), then.second.eq(1), then.a.eq(result), then.b.eq(b), then.low.eq(low)),
        ]
        doubled = Signal(WORD_BITS)
        m.d.comb += doubled.eq(Cat(low[-1], self.rest))
        fits = doubled >= b
        left = doubled - Mux(fits, b, 0)
        with m.If(does(Op.DIVIDE) & (b > 0) & (self.rest < b) & (b < 1 << LOW_BITS)):
            m.d.comb += [
                Assume(a == Mux(self.digit, self.rest, self.rest - b)),
                Assert(then.next_low == Cat(fits, low[:-1])),
                Assert(then.result == Mux(fits, left, left - b)),
                Assert(left < b),
            ]
        return m


def test_laser_is_never_on_with_a_condition_missing():
    prove(LaserNeedsEveryCondition(), "prove", 4)


def test_backgrounds_are_dark():
    prove(BackgroundsAreDark(), "prove", 5)


@pytest.mark.parametrize("length", [1, 3])
def test_count_and_latches_are_those_of_the_shaft(length):
    prove(CountIsThePosition(length), "prove", 10 + 2 * length, timeout_s=300)


@pytest.mark.parametrize(("period", "periods"), [(16, 2), (19, 1)])
def test_pulses_are_exact_and_whole(period, periods):
    """Beyond the two periods after reset."""
    prove(PulsesAreExact(period), "bmc", 2 * SHORTEST_PERIOD + periods * period + 3, timeout_s=300)


def test_arithmetic_is_exact():
    prove(ArithmeticIsExact(), "bmc", 1)


class TrustsTheHost(LaserNeedsEveryCondition):
    """A property that does not hold: light goes out some clocks after the last command, not before."""

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = Interlock()
        for name in self.signature.members:
            m.d.comb += getattr(dut, name).eq(getattr(self, name))
        m.d.comb += Assert(~dut.lamp | self.renew)
        return m


def test_what_does_not_hold_is_found():
    with pytest.raises(ProofError, match="TrustsTheHost is not proved"):
        prove(TrustsTheHost(), "bmc", 8)
