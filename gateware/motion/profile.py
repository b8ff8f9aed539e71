"""What speed is wanted: turning, sweeping between two angles, looking for the index; and the ramp between speeds."""

from dataclasses import dataclass, replace

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import MotorMode


@dataclass(frozen=True)
class Course:
    """What :meth:`Profile.reference` remembers from step to step."""

    target: int = 0
    backward: bool = False
    begun: bool = False
    found: bool = False
    failed: bool = False
    start: int = 0
    turned: bool = False


class Profile(wiring.Component):
    """The speed that the loop has to keep, a step a millisecond.

    ``SPEED`` goes to ``speed``. ``SWEEP`` goes forward until the position is at ``high``, back until it is at ``low``,
    and so on; it starts in the direction of ``speed``, whose magnitude counts. While the index has not been passed it
    looks for it first, as ``SEARCH`` does: in the direction of ``speed`` for up to ``search`` counts, then the other
    way up to ``search`` counts beyond the start; if nothing came, it has failed. ``SEARCH`` ends with the first pass,
    at speed 0.

    ``target`` moves by at most ``acceleration`` a step, so a reversal is a parabola. Outside these modes it follows the
    measured speed: closing the loop makes no jump.

    Latency :attr:`latency` clocks from ``step`` to ``done``; a step on the way is left out.

    Members
    -------
    step : strobe
    mode : a :class:`magtrak.protocol.MotorMode`; everything but the three is no course
    speed, measured : signed Q23.8, counts a second; wanted, and as it is
    acceleration : Q16.8 counts a second, per step
    count : of the decoder
    passed, seen : strobe: the index is passed; it has been since reset
    position : counts from the zero of the index
    low, high : where sweeps turn round
    search : counts; 0: no end
    target : signed Q23.8, counts a second
    found, failed : of ``SEARCH`` and its like
    done : strobe: ``target`` is new
    """

    step: In(1)
    mode: In(3)
    speed: In(signed(32))
    measured: In(signed(32))
    acceleration: In(24)
    count: In(signed(32))
    passed: In(1)
    seen: In(1)
    position: In(signed(32))
    low: In(signed(32))
    high: In(signed(32))
    search: In(24)
    target: Out(signed(32))
    found: Out(1)
    failed: Out(1)
    done: Out(1)

    latency = 6

    @staticmethod
    def reference(
        now: Course,
        *,
        mode: MotorMode,
        speed: int,
        measured: int,
        acceleration: int,
        count: int,
        passed: bool,
        seen: bool,
        position: int,
        low: int,
        high: int,
        search: int,
    ) -> Course:
        """The definition: what a step makes of ``now``; ``passed``: the index was, since the step before."""
        if mode not in (MotorMode.SPEED, MotorMode.SWEEP, MotorMode.SEARCH):
            return Course(target=measured)
        if not now.begun:
            now = replace(now, begun=True, backward=speed < 0, start=count)
        found = now.found or passed
        looking = not found if mode is MotorMode.SEARCH else mode is MotorMode.SWEEP and not seen
        moved = count - now.start
        wanted = -abs(speed) if now.backward else abs(speed)
        if mode is MotorMode.SPEED:
            wanted = speed
        elif looking:
            if search and abs(moved) > search and (moved < 0) == now.backward:
                now = replace(now, backward=not now.backward, turned=True, failed=now.failed or now.turned)
        elif mode is MotorMode.SEARCH:
            wanted = 0
        elif position >= high:
            now = replace(now, backward=True)
        elif position <= low:
            now = replace(now, backward=False)
        change = min(max(wanted - now.target, -acceleration), acceleration)
        return replace(now, found=found, target=now.target + change)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        begun, backward, turned, passed = Signal(), Signal(), Signal(), Signal()
        start, moved = Signal(signed(32)), Signal(signed(33))
        wanted, change = Signal(signed(32)), Signal(signed(33))
        distance, clipped = Signal(33), Signal(signed(26))
        far, high, low, looking, running = Signal(), Signal(), Signal(), Signal(), Signal()
        m.d.comb += running.eq(
            (self.mode == MotorMode.SPEED) | (self.mode == MotorMode.SWEEP) | (self.mode == MotorMode.SEARCH)
        )
        with m.If(self.passed):
            m.d.sync += passed.eq(1)
        m.d.sync += self.done.eq(0)
        with m.FSM():
            with m.State("Wait"):
                m.d.sync += moved.eq(self.count - start)
                with m.If(self.step & ~running):
                    m.d.sync += [
                        self.target.eq(self.measured),
                        self.found.eq(0),
                        self.failed.eq(0),
                        begun.eq(0),
                        turned.eq(0),
                        backward.eq(0),
                        passed.eq(self.passed),
                        self.done.eq(1),
                    ]
                with m.Elif(self.step):
                    m.d.sync += [begun.eq(1), passed.eq(self.passed), self.found.eq(self.found | passed)]
                    with m.If(~begun):
                        m.d.sync += [backward.eq(self.speed < 0), start.eq(self.count), moved.eq(0)]
                    m.next = "Distance"

            with m.State("Distance"):
                m.d.sync += distance.eq(Mux(moved < 0, -moved, moved))
                m.next = "Compare"

            with m.State("Compare"):
                magnitude = Mux(self.speed < 0, -self.speed, self.speed)
                m.d.sync += [
                    far.eq((self.search != 0) & (distance > self.search) & ((moved < 0) == backward)),
                    high.eq(self.position >= self.high),
                    low.eq(self.position <= self.low),
                    looking.eq(Mux(self.mode == MotorMode.SEARCH, ~self.found, ~self.seen)),
                    wanted.eq(Mux(backward, -magnitude, magnitude)),
                ]
                with m.If(self.mode == MotorMode.SPEED):
                    m.d.sync += wanted.eq(self.speed)
                with m.If((self.mode == MotorMode.SEARCH) & self.found):
                    m.d.sync += wanted.eq(0)
                m.next = "Turn"

            with m.State("Turn"):
                m.d.sync += change.eq(wanted - self.target)
                with m.If(self.mode != MotorMode.SPEED):
                    with m.If(looking):
                        with m.If(far):
                            m.d.sync += [backward.eq(~backward), turned.eq(1), self.failed.eq(self.failed | turned)]
                    with m.Elif(self.mode == MotorMode.SWEEP):
                        with m.If(high):
                            m.d.sync += backward.eq(1)
                        with m.Elif(low):
                            m.d.sync += backward.eq(0)
                m.next = "Limit"

            with m.State("Limit"):
                limit = self.acceleration
                m.d.sync += clipped.eq(Mux(change > limit, limit, Mux(change < -limit, -limit, change)))
                m.next = "Ramp"

            with m.State("Ramp"):
                m.d.sync += [self.target.eq(self.target + clipped), self.done.eq(1)]
                m.next = "Wait"
        return m
