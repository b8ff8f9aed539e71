"""The motor: speed measurement, course, loop, watch and sector as one program, and PWM."""

from collections.abc import Mapping

from amaranth.hdl import Module, Mux, ShapeLike, Signal, signed
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import MotorMode, register

from ..layouts import NowSettings
from .assembly import Program
from .loop import SpeedLoop
from .profile import Profile
from .pwm import Pwm
from .sector import Sector
from .sequencer import Sequencer, Variable
from .speed import SpeedMeter
from .watch import CHATTER, FAULTS, Faults, MotorWatch

INPUTS: Mapping[str, ShapeLike] = {
    **{"count": signed(32), "age": 32, "time": 32, "zero_count": signed(32), "pass_count": signed(32)},
    **{"difference": signed(32), "illegals": 8, "clock_hz": 32},
}
FLAGS = (
    *("tick", "backward", "seen", "closed", "speed_mode", "sweep_mode", "active", "driven", "alive"),
    *("watch_stall", "watch_runaway", "watch_encoder", "watch_index", "watch_lease"),
    *("passed", "wrong", "right", "chattered", "opened", "rested"),
)
OUTPUTS = ("speed", "band", "target", "found", "duty", "still", "cause", "inside")

SETTINGS = (
    *("motor_duty", "motor_speed", "motor_acceleration", "motor_kp", "motor_ki", "motor_kff", "motor_friction"),
    *("motor_duty_max", "sweep_low", "sweep_high", "motor_search", "motor_stall_ms", "motor_runaway"),
    *("motor_speed_max", "encoder_tolerance", "index_tolerance", "speed_low", "speed_high", "counts_per_turn"),
    *("sector_low", "sector_high"),
)
"""Registers that are variables of the program, at the low bits of their addresses."""

INTOLERABLE = 1 << 30
"""Counts by which a turn was off, more than any tolerance."""

SETTINGS_BASE = 0x0300
"""Where the registers of motion begin; their place in it is the variable's address."""


class MotorState(data.Struct):
    """Register ``motor_state``."""

    stopped: 1
    found: 1
    in_band: 1
    in_sector: 1


def motor_program() -> Program:
    """What a millisecond and an edge of the encoder bring about."""
    p = Program(tuple(INPUTS), FLAGS, OUTPUTS)
    for name in SETTINGS:
        p.variable(name, address=register(name).address - SETTINGS_BASE)
    p.variable("position", "band")
    p.jump("start")

    p.label("wait")
    p.wait()
    p.load("count")
    p.subtract("zero_count")
    p.wrap()
    p.store("position")
    with p.when("tick"):
        SpeedMeter.program(p)
        _band(p)
        Profile.program(p)
        p.load("target")
        p.output("target")
        with p.when("active"):
            SpeedLoop.program(p)
        MotorWatch.program(p)
    Sector.program(p)
    p.jump("wait")

    p.label("start")
    values = {name: register(name).init if name in SETTINGS else 0 for name in p.variables}
    for value in sorted(set(values.values())):
        p.put(value, *(name for name in values if values[name] == value))
    p.jump("wait")
    return p


def _band(p: Program) -> None:
    """Output ``band``: negative while ``speed_low <= abs(speed) <= speed_high``."""
    p.put(0, "band")
    p.load_magnitude("speed")
    p.store("scratch")
    p.subtract("speed_low")
    with p.unless("negative"):
        p.load("speed_high")
        p.subtract("scratch")
        with p.unless("negative"):
            p.put(-1, "band")
    p.load("band")
    p.output("band")


class MotorControl(wiring.Component):
    """Drives the motor as its mode says, and stops it when something is wrong.

    A :class:`Sequencer` works out, every millisecond, the speed from the edges (:class:`SpeedMeter`), the speed wanted
    (:class:`Profile`), the duty (:class:`SpeedLoop`) and whether something is wrong (:class:`MotorWatch`); and at each
    edge, whether the angle is in the sector (:class:`Sector`). All see the state in one clock, that of ``sampled``. A
    millisecond takes less than 1900 clocks, an edge less than 130; ticks and edges that come meanwhile are seen
    together, after it. A fault takes two clocks from when it is found to stop the PWM: the bridge brakes until the mode
    is written ``OFF``.

    The speed is in its band while ``speed_low <= abs(speed) <= speed_high``, measured once a millisecond.

    Members
    -------
    settings : registers in force, those that logic needs at once
    write : stream of :class:`Variable`: the other registers, :data:`SETTINGS`, as they are written
    clock_hz : frequency of the clock, constant
    tick : strobe, a millisecond
    time : of the clock
    count, edge, backward, illegal, age : outputs of the decoder
    passed, pass_count, zero_count, seen, wrong, difference : outputs of the index
    alive : the host's lease
    pwm, direction, brake : pins
    speed : signed Q23.8, counts a second
    state, cause : registers
    sampled : strobe: what is seen in this clock is what the next results are made of
    """

    settings: In(NowSettings)
    write: In(stream.Signature(Variable))
    clock_hz: In(32)
    tick: In(1)
    time: In(32)
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
    sampled: Out(1)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        settings, mode = self.settings, self.settings.motor_mode
        m.submodules.sequencer = sequencer = Sequencer(motor_program(), INPUTS)
        m.submodules.driver = driver = Pwm()
        wiring.connect(m, wiring.flipped(self.write), sequencer.write)
        value, output = sequencer.value, sequencer.output

        closed = Signal()  # the speed is controlled
        driven = Signal()  # the motor moves
        active = Signal()  # it may
        stopped = self.state.stopped
        m.d.comb += [
            closed.eq((mode == MotorMode.SPEED) | (mode == MotorMode.SWEEP) | (mode == MotorMode.SEARCH)),
            driven.eq(closed | (mode == MotorMode.DUTY)),
            active.eq(closed & ~stopped),
        ]

        # What has been since the last tick that was seen.
        ticked = Signal()
        moved = Signal()
        backward_wanted = Signal()
        moving = Signal()
        before = Signal()
        chatter = Signal(range(CHATTER + 1))
        with m.If(~moving):
            m.d.sync += chatter.eq(0)
        with m.Elif(self.edge):
            m.d.sync += chatter.eq(Mux(self.backward == before, 0, chatter + (chatter != CHATTER)))
        with m.If(self.edge):
            m.d.sync += before.eq(self.backward)
        events = {
            "passed": self.passed,
            "wrong": self.wrong,
            "right": self.edge & (self.backward == backward_wanted),
            "chattered": chatter == CHATTER,
            "opened": ~active,
            "rested": ~driven,
        }
        been = {name: Signal(name=f"been_{name}", init=name in ("opened", "rested")) for name in events}
        illegals = Signal(8)
        m.d.comb += [
            self.sampled.eq(sequencer.resumed),
            sequencer.event.eq(ticked | moved),
        ]
        m.d.sync += [ticked.eq((ticked & ~self.sampled) | self.tick), moved.eq((moved & ~self.sampled) | self.edge)]
        with m.If(self.sampled & ticked):
            m.d.sync += [*(been[name].eq(event) for name, event in events.items()), illegals.eq(self.illegal)]
        with m.Else():
            m.d.sync += [been[name].eq(been[name] | event) for name, event in events.items()]
            with m.If(self.illegal & ~illegals.all()):
                m.d.sync += illegals.eq(illegals + 1)

        # Two wrong turns in a millisecond are one that no tolerance allows; each may be followed by a right one.
        difference = Signal(signed(32), reset_less=True)
        again = Signal()
        m.d.comb += again.eq(self.wrong & been["wrong"] & ~(self.sampled & ticked))
        with m.If(self.wrong):
            m.d.sync += difference.eq(self.difference)
        with m.If(again):
            m.d.sync += difference.eq(INTOLERABLE)

        sample = Signal.like(sequencer.inputs, reset_less=True)
        flags = Signal.like(sequencer.flags, reset_less=True)
        m.d.comb += [
            sequencer.inputs.eq(sample),
            sequencer.inputs.clock_hz.eq(self.clock_hz),
            sequencer.flags.eq(flags),
        ]
        with m.If(self.sampled):
            for name in ("count", "age", "time", "zero_count", "pass_count"):
                m.d.sync += sample[name].eq(getattr(self, name))
            m.d.sync += [
                sample.illegals.eq(illegals),
                sample.difference.eq(difference),
                flags.tick.eq(ticked),
                flags.closed.eq(closed),
                flags.speed_mode.eq(mode == MotorMode.SPEED),
                flags.sweep_mode.eq(mode == MotorMode.SWEEP),
                flags.active.eq(active),
                flags.driven.eq(driven),
                *(flags[name].eq(getattr(self, name)) for name in ("backward", "seen", "alive")),
                *(flags[f"watch_{name}"].eq(Faults(settings.motor_watch)[name]) for name in FAULTS),
                *(flags[name].eq(been[name]) for name in events),
            ]

        # Results. What the mode has overtaken is void.
        duty = Signal(signed(16))
        with m.If(output.speed):
            m.d.sync += self.speed.eq(value)
        with m.If(output.band):
            m.d.sync += self.state.in_band.eq(value < 0)
        with m.If(output.target):
            m.d.sync += backward_wanted.eq(value < 0)
        with m.If(output.found):
            m.d.sync += self.state.found.eq(value < 0)
        with m.If(output.still):
            m.d.sync += moving.eq(value >= 0)
        with m.If(output.inside):
            m.d.sync += self.state.in_sector.eq(value < 0)
        with m.If(~active):
            m.d.sync += duty.eq(0)
        with m.Elif(output.duty & ~been["opened"]):
            m.d.sync += duty.eq(value)
        was_driven = Signal()
        starts = Signal()
        fails = Signal()
        m.d.sync += was_driven.eq(driven)
        m.d.comb += [
            starts.eq(driven & ~was_driven),
            fails.eq(driven & was_driven & output.cause & ~stopped & ~been["rested"]),
        ]
        with m.If(fails):
            m.d.sync += [stopped.eq(1), self.cause.eq(value)]
        with m.If(starts):
            m.d.sync += self.cause.eq(0)
        with m.If(~driven):
            m.d.sync += stopped.eq(0)

        m.d.comb += [
            driver.period.eq(settings.motor_period),
            driver.duty.eq(
                (duty & closed.replicate(16)) | (settings.motor_duty & (mode == MotorMode.DUTY).replicate(16))
            ),
            driver.brake.eq(settings.motor_brake | stopped),
            driver.enable.eq(mode != MotorMode.OFF),
            driver.antiphase.eq(settings.motor_bridge),
            self.pwm.eq(driver.pwm),
            self.direction.eq(driver.direction),
            self.brake.eq(driver.braking),
        ]
        return m
