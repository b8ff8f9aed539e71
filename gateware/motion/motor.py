"""The motor: speed measurement, course, loop, watch and PWM, in steps of a millisecond."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import MotorMode

from ..layouts import NowSettings
from .loop import SpeedLoop
from .profile import Profile
from .pwm import Pwm
from .sector import Sector
from .speed import SpeedMeter
from .watch import SLOWEST, MotorWatch


class MotorState(data.Struct):
    """Register ``motor_state``."""

    stopped: 1
    found: 1
    in_band: 1
    in_sector: 1


class MotorControl(wiring.Component):
    """Drives the motor as its mode says, and stops it when something is wrong.

    Every millisecond: speed from the edges (:class:`SpeedMeter`), then the speed wanted (:class:`Profile`), then
    the duty (:class:`SpeedLoop`), about 140 clocks in all; ticks that come faster are left out. A fault
    (:class:`MotorWatch`) takes two clocks to stop the PWM: the bridge brakes until the mode is written ``OFF``.

    The speed is in its band while ``speed_low <= abs(speed) <= speed_high``, measured once a millisecond.

    Members
    -------
    settings : registers in force
    clock_hz : frequency of the clock, constant
    tick : strobe, a millisecond
    count, edge, backward, illegal, age : outputs of the decoder
    passed, pass_count, zero_count, seen, wrong, difference : outputs of the index
    alive : the host's lease
    pwm, direction, brake : pins
    speed : signed Q23.8, counts a second
    state, cause : registers
    """

    settings: In(NowSettings)
    clock_hz: In(32)
    tick: In(1)
    count: In(signed(32))
    edge: In(1)
    backward: In(1)
    illegal: In(1)
    age: In(32)
    passed: In(1)
    pass_count: In(signed(32))
    zero_count: In(signed(32))
    seen: In(1)
    wrong: In(1)
    difference: In(signed(32))
    alive: In(1)
    pwm: Out(1)
    direction: Out(1)
    brake: Out(1)
    speed: Out(signed(32))
    state: Out(MotorState)
    cause: Out(8)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        settings, mode = self.settings, self.settings.motor_mode
        position = Signal(signed(32))
        m.d.sync += position.eq(self.count - self.zero_count)

        m.submodules.meter = meter = SpeedMeter()
        m.submodules.profile = profile = Profile()
        m.submodules.loop = loop = SpeedLoop()
        m.submodules.watch = watch = MotorWatch()
        m.submodules.sector = sector = Sector()
        m.submodules.driver = driver = Pwm()

        m.d.comb += [
            meter.tick.eq(self.tick),
            meter.count.eq(self.count),
            meter.backward.eq(self.backward),
            meter.age.eq(self.age),
            meter.clock_hz.eq(self.clock_hz),
            self.speed.eq(meter.speed),
            profile.step.eq(meter.done),
            profile.mode.eq(mode),
            profile.speed.eq(settings.motor_speed),
            profile.measured.eq(meter.speed),
            profile.acceleration.eq(settings.motor_acceleration),
            profile.count.eq(self.count),
            profile.passed.eq(self.passed),
            profile.seen.eq(self.seen),
            profile.position.eq(position),
            profile.low.eq(settings.sweep_low),
            profile.high.eq(settings.sweep_high),
            profile.search.eq(settings.motor_search),
        ]

        closed = Signal()  # the speed is controlled
        m.d.comb += [
            closed.eq((mode == MotorMode.SPEED) | (mode == MotorMode.SWEEP) | (mode == MotorMode.SEARCH)),
            loop.start.eq(profile.done),
            loop.active.eq(closed & ~watch.stopped),
            loop.target.eq(profile.target),
            loop.speed.eq(meter.speed),
            loop.kp.eq(settings.motor_kp),
            loop.ki.eq(settings.motor_ki),
            loop.kff.eq(settings.motor_kff),
            loop.friction.eq(settings.motor_friction),
            loop.limit.eq(settings.motor_duty_max),
        ]

        wanted = Signal()
        m.d.sync += wanted.eq((profile.target >= SLOWEST) | (profile.target <= -SLOWEST))
        m.d.comb += [
            watch.driven.eq(closed | (mode == MotorMode.DUTY)),
            watch.moving.eq(Mux(closed, wanted, (mode == MotorMode.DUTY) & (settings.motor_duty != 0))),
            watch.backward_wanted.eq(profile.target < 0),
            watch.loop.eq(closed),
            watch.enable.eq(settings.motor_watch),
            watch.tick.eq(self.tick),
            watch.search_failed.eq(profile.failed),
            watch.stall_ms.eq(settings.motor_stall_ms),
            watch.runaway.eq(settings.motor_runaway),
            watch.speed_max.eq(settings.motor_speed_max),
            watch.speed.eq(meter.speed),
            self.cause.eq(watch.cause),
        ]
        for name in ("encoder_tolerance", "index_tolerance", "counts_per_turn"):
            m.d.comb += getattr(watch, name).eq(settings[name])
        for name in ("count", "edge", "backward", "illegal", "passed", "pass_count", "wrong", "difference", "alive"):
            m.d.comb += getattr(watch, name).eq(getattr(self, name))

        m.d.comb += [
            sector.position.eq(position),
            sector.seen.eq(self.seen),
            sector.counts_per_turn.eq(settings.counts_per_turn),
            sector.low.eq(settings.sector_low),
            sector.high.eq(settings.sector_high),
        ]
        magnitude = Signal(32)
        m.d.sync += [
            magnitude.eq(Mux(meter.speed < 0, -meter.speed, meter.speed)),
            self.state.in_band.eq((magnitude >= settings.speed_low) & (magnitude <= settings.speed_high)),
        ]
        m.d.comb += [
            self.state.stopped.eq(watch.stopped),
            self.state.found.eq(profile.found),
            self.state.in_sector.eq(sector.inside),
        ]

        m.d.comb += [
            driver.period.eq(settings.motor_period),
            driver.duty.eq(Mux(closed, loop.duty, Mux(mode == MotorMode.DUTY, settings.motor_duty, 0))),
            driver.brake.eq(settings.motor_brake | watch.stopped),
            driver.enable.eq(mode != MotorMode.OFF),
            driver.antiphase.eq(settings.motor_bridge),
            self.pwm.eq(driver.pwm),
            self.direction.eq(driver.direction),
            self.brake.eq(driver.braking),
        ]
        return m
