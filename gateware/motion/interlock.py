"""Laser enable: on only while every condition holds."""

from dataclasses import dataclass, replace

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

from magtrak.protocol import LASER_KEY, LaserCause

SYNCHRONISER_STAGES = 2


class LaserState(data.Struct):
    """Register ``laser_state``: the laser emits, is armed, its interlock is closed, its lease alive, no fault has
    stopped the motor, and the conditions on speed and angle hold.
    """

    emitting: 1
    armed: 1
    closed: 1
    alive: 1
    sound: 1
    permitted: 1


@dataclass(frozen=True)
class Arming:
    """What :meth:`Interlock.reference` remembers from clock to clock."""

    armed: bool = False
    emitting: bool = False
    cause: LaserCause = LaserCause.NEVER_ARMED
    heard: bool = False
    alive: bool = False
    permitted: bool = False
    silent_ms: int = 0
    waited_ms: int = 0


class Interlock(wiring.Component):
    """Enables the laser while it is armed, the interlock closed, the host alive and the motor sound.

    Off after reset. Writing the key arms it, if the interlock is closed and the lease alive then; any other value
    disarms. Armed, the lamp is on, and emission follows after ``delay_ms`` to ``delay_ms + 1`` ms. Arming what is
    armed changes nothing. Every intact command renews the lease. The laser is disarmed ``lease_ms - 1`` to
    ``lease_ms`` ms after the last one, and when the interlock opens. Whatever it was, only the key arms it again.

    A fault that stops the motor disarms it as well. ``permitted`` is no more than a shutter: without it the light goes
    out in the next clock, and comes back with it; the lamp stays on.

    What disarmed it last, or kept it from being armed, stays in ``cause``. Where several things happen in one
    clock, the interlock counts before the lease, that before the motor, and that before the command.

    ``laser`` is low as soon as the pin is: the pin gates the output directly, and needs no clock for it. It stays
    low where the pin is sampled open once; an opening shorter than a clock may interrupt the light only for
    as long. A command takes a clock, the lease three.

    This is no substitute for an interlock in series with the laser's supply.

    Members
    -------
    interlock : pin, asynchronous, 1 is closed
    tick : strobe, a millisecond has passed
    arm, key : strobe, a value is written to ``laser_arm``
    renew : strobe, an intact command has come
    lease_ms, delay_ms : settings
    sound : no fault has stopped the motor
    permitted : speed and angle are where they have to be, and the image is not a background
    laser : pin, enables the laser
    lamp : pin, emission indicator: on from arming to disarming
    state : see :class:`LaserState`
    cause : a :class:`magtrak.protocol.LaserCause`
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
    laser: Out(1)
    lamp: Out(1)
    state: Out(LaserState)
    cause: Out(8)

    def __init__(self) -> None:
        super().__init__()
        # Milliseconds, inverted: they count down, and what is compared with them is just added. One bit more than the
        # settings: they stop where no setting reaches.
        self._silent, self._waited = Signal(17, init=-1), Signal(17, init=-1)
        self._heard, self._emitting = Signal(), Signal()

    @staticmethod
    def reference(
        now: Arming,
        *,
        closed: bool,
        tick: bool,
        key: int | None,
        renew: bool,
        lease_ms: int,
        delay_ms: int,
        sound: bool = True,
        permitted: bool = True,
    ) -> Arming:
        """The definition: what a clock makes of ``now``. ``key`` is None where nothing is written.

        ``closed`` is the pin two clocks ago. The lamp is ``armed``; the laser is ``emitting`` while ``permitted`` and
        the pin is closed, and was so in the two clocks before.
        """
        alive = renew or now.alive
        emitting = now.emitting or now.waited_ms > delay_ms
        now = replace(
            now,
            permitted=permitted,
            heard=now.heard or renew,
            alive=renew or (now.heard and now.silent_ms < lease_ms),
            silent_ms=0 if renew else min(now.silent_ms + tick, 65536),
        )
        if not now.armed and key != LASER_KEY:
            return now
        for missing, cause in (
            (not closed, LaserCause.INTERLOCK),
            (not alive, LaserCause.LEASE),
            (not sound, LaserCause.MOTOR),
            (key not in (None, LASER_KEY), LaserCause.COMMAND),
        ):
            if missing:
                return replace(now, armed=False, emitting=False, cause=cause)
        if not now.armed:
            return replace(now, armed=True, waited_ms=0)
        return replace(now, emitting=emitting, waited_ms=min(now.waited_ms + tick, 65536))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        closed = Signal()
        m.submodules.synchroniser = FFSynchronizer(self.interlock, closed, stages=SYNCHRONISER_STAGES)
        # Spans the clocks until the synchroniser knows. It only gates the output: it may be metastable.
        sampled = Signal()
        m.d.sync += sampled.eq(self.interlock)

        # The counters are compared a clock later.
        heard = self._heard
        alive = Signal()
        silent, waited = self._silent, self._waited
        m.d.sync += [
            heard.eq(heard | self.renew),
            alive.eq(self.renew | (heard & (silent + self.lease_ms)[-1])),
        ]
        with m.If(self.tick & silent[-1]):
            m.d.sync += silent.eq(silent - 1)
        with m.If(self.renew):
            m.d.sync += silent.eq(-1)

        armed = Signal()
        emitting = self._emitting
        ripe = Signal()
        permitted = Signal()
        m.d.sync += permitted.eq(self.permitted)
        m.d.comb += ripe.eq(~(Cat(1, waited) + Cat(1, self.delay_ms))[-1])
        with m.If(self.tick & waited[-1]):
            m.d.sync += waited.eq(waited - 1)
        with m.If(~armed):
            m.d.sync += waited.eq(-1)

        keyed = Signal()
        m.d.comb += keyed.eq(self.key == LASER_KEY)
        with m.If(armed | (self.arm & keyed)):
            with m.If(~closed):
                m.d.sync += [armed.eq(0), emitting.eq(0), self.cause.eq(LaserCause.INTERLOCK)]
            with m.Elif(~(alive | self.renew)):
                m.d.sync += [armed.eq(0), emitting.eq(0), self.cause.eq(LaserCause.LEASE)]
            with m.Elif(~self.sound):
                m.d.sync += [armed.eq(0), emitting.eq(0), self.cause.eq(LaserCause.MOTOR)]
            with m.Elif(self.arm & ~keyed):
                m.d.sync += [armed.eq(0), emitting.eq(0), self.cause.eq(LaserCause.COMMAND)]
            with m.Elif(armed):
                m.d.sync += emitting.eq(emitting | ripe)
            with m.Else():
                m.d.sync += armed.eq(1)

        m.d.comb += [
            self.laser.eq(emitting & permitted & self.interlock & sampled & closed),
            self.lamp.eq(armed),
            self.state.emitting.eq(emitting & permitted & closed),
            self.state.armed.eq(armed),
            self.state.closed.eq(closed),
            self.state.alive.eq(alive),
            self.state.sound.eq(self.sound),
            self.state.permitted.eq(permitted),
        ]
        return m
