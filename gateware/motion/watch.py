"""Watches the motor: stall, run-away, a broken encoder, an index that is missing or comes twice."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import MotorCause

CHATTER = 8
"""Edges to and fro in a row, of a driven motor, that no shaft makes: one channel of the encoder is dead or noisy."""

OVERSPEED_MS = 8
"""Measurements in a row above the greatest speed that are a run-away: a stray edge makes one or two."""

SLOWEST = 16 << 8
"""Wanted speeds below 16 counts a second, Q23.8, are standstill for the watch: turning round goes through them."""


class Faults(data.Struct):
    """Register ``motor_watch``: the faults that stop the motor."""

    stall: 1
    runaway: 1
    encoder: 1
    index: 1
    lease: 1


class MotorWatch(wiring.Component):
    """Stops the motor at the first fault, and remembers which.

    It watches while ``driven``, the faults of ``enable``. One clock after a fault is seen ``stopped`` is high and
    ``cause`` tells the first one; both stay until ``driven`` ends, ``cause`` until it begins anew.

    - ``STALL``: less than two counts of way in ``stall_ms`` (up to a millisecond more).
    - ``RUNAWAY``: ``runaway`` edges in a row against the wanted direction (A and B swapped, a motor with wrong
      polarity), or a speed above ``speed_max`` for :data:`OVERSPEED_MS` ms (a bridge that is stuck).
    - ``ENCODER``: :data:`CHATTER` edges to and fro, or more than ``encoder_tolerance`` illegal transitions, of which
      one is forgotten every 128 ms.
    - ``TURN``: a turn that is off by more than ``index_tolerance``: a second index, or lost counts.
    - ``INDEX_MISSING``: a turn and a quarter without index; only with ``counts_per_turn``.
    - ``SEARCH``: looked for the index in vain.
    - ``LEASE``: the host is gone.

    Latency: one to five clocks from what makes it a fault.

    Members
    -------
    driven : the motor shall move or be held
    moving : it shall move, faster than :data:`SLOWEST`
    backward_wanted : in this direction
    loop : the speed is controlled; without that no direction is wrong
    enable : a :class:`Faults`, those watched
    tick : strobe, a millisecond
    count, edge, backward, illegal : outputs of the decoder
    passed, pass_count, wrong, difference : outputs of the index
    speed : signed Q23.8
    search_failed, alive : from profile and interlock
    stall_ms, runaway, speed_max, encoder_tolerance, index_tolerance, counts_per_turn : settings
    stopped : the motor has to stand
    cause : a :class:`magtrak.protocol.MotorCause`
    """

    driven: In(1)
    moving: In(1)
    backward_wanted: In(1)
    loop: In(1)
    enable: In(Faults)
    tick: In(1)
    count: In(signed(32))
    edge: In(1)
    backward: In(1)
    illegal: In(1)
    passed: In(1)
    pass_count: In(signed(32))
    wrong: In(1)
    difference: In(signed(32))
    speed: In(signed(32))
    search_failed: In(1)
    alive: In(1)
    stall_ms: In(16)
    runaway: In(16)
    speed_max: In(31)
    encoder_tolerance: In(8)
    index_tolerance: In(8)
    counts_per_turn: In(24)
    stopped: Out(1)
    cause: Out(8)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        driven = Signal()
        m.d.sync += driven.eq(self.driven)

        # Stall. The anchor is where it last had made two counts of way.
        anchor, way = Signal(signed(32)), Signal(signed(33))
        idle_ms = Signal(17)
        far = Signal()
        m.d.sync += [way.eq(self.count - anchor), far.eq((way > 1) | (way < -1))]
        with m.If(far | ~self.moving):
            m.d.sync += [anchor.eq(self.count), way.eq(0), far.eq(0), idle_ms.eq(0)]
        with m.Elif(self.tick & ~idle_ms[-1]):
            m.d.sync += idle_ms.eq(idle_ms + 1)
        stall = Signal()
        m.d.sync += stall.eq(idle_ms > self.stall_ms)

        # Run-away.
        astray = Signal(17)
        fast, fast_ms = Signal(), Signal(range(OVERSPEED_MS + 1))
        with m.If(~self.moving | ~self.loop):
            m.d.sync += astray.eq(0)
        with m.Elif(self.edge):
            m.d.sync += astray.eq(Mux(self.backward == self.backward_wanted, 0, astray + ~astray[-1]))
        magnitude = Signal(32)
        m.d.sync += [
            magnitude.eq(Mux(self.speed < 0, -self.speed, self.speed)),
            fast.eq(magnitude > self.speed_max),
        ]
        with m.If(~fast):
            m.d.sync += fast_ms.eq(0)
        with m.Elif(self.tick & (fast_ms != OVERSPEED_MS)):
            m.d.sync += fast_ms.eq(fast_ms + 1)
        runaway = Signal()
        m.d.sync += runaway.eq((fast_ms == OVERSPEED_MS) | (astray > self.runaway))

        # Encoder.
        before, chatter = Signal(), Signal(range(CHATTER + 1))
        illegals, forget = Signal(9), Signal(7)
        with m.If(~self.moving):
            m.d.sync += chatter.eq(0)
        with m.Elif(self.edge):
            m.d.sync += chatter.eq(Mux(self.backward == before, 0, chatter + (chatter != CHATTER)))
        with m.If(self.edge):
            m.d.sync += before.eq(self.backward)
        m.d.sync += forget.eq(forget + self.tick)
        with m.If(~self.driven):
            m.d.sync += illegals.eq(0)
        with m.Elif(self.illegal & ~illegals[-1]):
            m.d.sync += illegals.eq(illegals + 1)
        with m.Elif(self.tick & forget.all() & illegals.any()):
            m.d.sync += illegals.eq(illegals - 1)
        encoder = Signal()
        m.d.sync += encoder.eq((chatter == CHATTER) | (illegals > self.encoder_tolerance))

        # Index. The turn is counted from the last pass, or from the start where there was none.
        start, seen = Signal(signed(32)), Signal()
        turned, size, longest = Signal(signed(33)), Signal(33), Signal(25)
        off, off_by = Signal(), Signal(32)
        with m.If(~driven):
            m.d.sync += start.eq(self.count)
        m.d.sync += seen.eq(self.driven & (seen | self.passed))
        m.d.sync += [
            turned.eq(self.count - Mux(seen, self.pass_count, start)),
            size.eq(Mux(turned < 0, -turned, turned)),
            longest.eq(self.counts_per_turn + (self.counts_per_turn >> 2)),
            off.eq(self.wrong),
            off_by.eq(Mux(self.difference < 0, -self.difference, self.difference)),
        ]
        missing, turn = Signal(), Signal()
        m.d.sync += missing.eq((size > longest) & (self.counts_per_turn != 0) & driven & self.driven)
        m.d.sync += turn.eq(off & (off_by > self.index_tolerance))

        seen_faults = (
            (self.enable.lease & ~self.alive, MotorCause.LEASE),
            (self.enable.encoder & encoder, MotorCause.ENCODER),
            (self.enable.runaway & runaway, MotorCause.RUNAWAY),
            (self.enable.index & turn, MotorCause.TURN),
            (self.enable.index & missing, MotorCause.INDEX_MISSING),
            (self.enable.index & self.search_failed, MotorCause.SEARCH),
            (self.enable.stall & stall, MotorCause.STALL),
        )
        with m.If(~self.driven):
            m.d.sync += self.stopped.eq(0)
        with m.Else():
            with m.If(~driven):
                m.d.sync += self.cause.eq(MotorCause.NONE)
            with m.Elif(~self.stopped):
                for number, (fault, cause) in enumerate(seen_faults):
                    with m.If(fault) if number == 0 else m.Elif(fault):
                        m.d.sync += [self.stopped.eq(1), self.cause.eq(cause)]
        return m
