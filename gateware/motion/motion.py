"""Everything that turns, and the light that turns with it."""

from amaranth.hdl import Cat, Module, Signal, Value, signed
from amaranth.lib import data, stream, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out

from magtrak.protocol import MAX_EDGES

from ..features import EVERYTHING, Features
from ..layouts import Edge, EncoderErrors, NowSettings, SettingWrite
from .angle import AngleLatch, AngleStamp, EdgeLog
from .filter import LENGTH_BITS, Align
from .index import Index
from .interlock import Interlock, LaserState
from .milliseconds import Milliseconds
from .motor import SETTINGS_BASE, MotorControl, MotorState
from .open_loop import OpenLoop
from .quadrature import SYNCHRONISER_STAGES, Quadrature

SAFETY = ("laser_state", "laser_cause", "motor_state", "motor_cause")
"""Registers that ``safety`` shows in one."""


class Motion(wiring.Component):
    """Encoder, index, angle of the image, motor and laser.

    One time rules all stamps: clocks since reset. An edge has the time at which its pin changed, a latch that
    of its strobe; synchroniser and glitch filter delay strobes and pins alike, so they are made up for exactly. What a
    strobe at time t latches comes :meth:`latency` clocks later, and includes the edges up to and including t.

    ``take`` cuts the edge log likewise: ``taken`` follows :meth:`latency` clocks later, and from then on until the next
    ``taken`` the log can be read. ``first``, ``last`` and ``encoder_fault`` at ``taken`` are those of all strobes
    and edges up to ``take``; ``first`` and ``last`` change with the next image.

    Settings act at once. A new ``encoder_filter`` moves the times of the edges and strobes under way by as much as
    it differs, and may repeat such a strobe or leave it out: write it when no image is measured.

    Parameters
    ----------
    features : ``speed_loop``, ``edge_log`` and ``close_images`` count; without the last one ``first`` stays 0. Without
        speed loop the motor is an
        :class:`~gateware.motion.open_loop.OpenLoop`, no program is built, speed, state and cause of the motor stay 0,
        and ``laser_conditions`` may not ask for them

    Members
    -------
    encoder_a, encoder_b, index, interlock : pins, asynchronous
    pwm, direction, brake, laser, lamp : pins
    clock_hz : frequency of the clock, constant
    settings : registers in force, those that have to act at once
    write : stream of :class:`~gateware.layouts.SettingWrite`: the others, as they are written
    row_first, frame_first : strobes, column 0 of a row arrives; the row is the first of its image
    arm, arm_key : strobe, value written to ``laser_arm``
    renew : strobe, an intact command has come
    shutter : the laser may shine, if all else permits it too
    take, taken : strobes, the edge log of an image is wanted; is ready to be read
    first, last : latches of the first and the last row
    first_is_last : strobe: ``last`` is that of the first row, see :class:`~gateware.motion.angle.AngleLatch`
    encoder_fault : an illegal transition, or a wrong turn, between the last two ``take``
    edges, edge_shift : entries of the edge log, and which edges they are; 0 without a log
    edge_index, edge : entry to read; the entry, a clock later
    count : now, :meth:`latency` clocks late
    index_time, pass_count, index_passes, index_seen, index_difference : last pass of the index
    index_count : the zero of the angle, as the policy has it
    encoder_errors : since reset
    speed : signed Q23.8, counts a second
    motor_state, motor_cause, laser_state, laser_cause, safety : registers
    laser_on_whole_frame, speed_in_band_whole_frame : it has been so since ``frame_first``
    """

    encoder_a: In(1)
    encoder_b: In(1)
    index: In(1)
    interlock: In(1)
    pwm: Out(1)
    direction: Out(1)
    brake: Out(1)
    laser: Out(1)
    lamp: Out(1)

    clock_hz: In(32)
    settings: In(NowSettings)
    write: In(stream.Signature(SettingWrite))
    row_first: In(1)
    frame_first: In(1)
    arm: In(1)
    arm_key: In(16)
    renew: In(1)
    shutter: In(1, init=1)

    take: In(1)
    taken: Out(1)
    first: Out(AngleStamp)
    last: Out(AngleStamp)
    first_is_last: Out(1)
    encoder_fault: Out(1)
    edges: Out(range(MAX_EDGES + 1))
    edge_shift: Out(8)
    edge_index: In(range(MAX_EDGES))
    edge: Out(Edge)

    count: Out(signed(32))
    index_time: Out(48)
    index_count: Out(signed(32))
    pass_count: Out(signed(32))
    index_difference: Out(signed(32))
    index_passes: Out(16)
    index_seen: Out(1)
    encoder_errors: Out(EncoderErrors)
    speed: Out(signed(32))
    motor_state: Out(MotorState)
    motor_cause: Out(8)
    safety: Out(32)
    laser_state: Out(LaserState)
    laser_cause: Out(8)
    laser_on_whole_frame: Out(1)
    speed_in_band_whole_frame: Out(1)

    @staticmethod
    def latency(length: int) -> int:
        """Clocks from a strobe to what it latches, with the glitch filter at ``length``."""
        return Quadrature.latency(length) + 1

    def __init__(self, features: Features = EVERYTHING) -> None:
        self.features = features
        super().__init__()

    def elaborate(self, platform: object) -> Module:
        m = Module()
        settings = self.settings
        length = Signal(LENGTH_BITS)
        m.d.comb += length.eq(settings.encoder_filter | (settings.encoder_filter == 0))

        m.submodules.encoder = encoder = Quadrature()
        m.d.comb += [
            encoder.a.eq(self.encoder_a),
            encoder.b.eq(self.encoder_b),
            encoder.length.eq(length),
            encoder.swap.eq(settings.encoder_swap),
            self.count.eq(encoder.count),
        ]

        # Index and strobes, as late as the encoder: everything from `then` on is seen at one and the same pin time.
        level = Signal()
        m.submodules.synchroniser = FFSynchronizer(self.index, level, stages=SYNCHRONISER_STAGES)
        strobes = Cat(self.row_first, self.frame_first, self.take)
        for stage in range(SYNCHRONISER_STAGES):
            delayed = Signal(len(strobes), name=f"strobes_{stage}")
            m.d.sync += delayed.eq(strobes)
            strobes = delayed
        m.submodules.align = align = Align(len(strobes) + 1)
        m.d.comb += [align.i.eq(Cat(strobes, level)), align.length.eq(length)]
        row_first, frame_first, take, barrier = align.o

        # The time at which the pins were what is seen now: less than the time by the latency, which may change.
        late = Signal(LENGTH_BITS, init=1)
        late_before = Signal(LENGTH_BITS, init=1)
        jump = Signal(signed(LENGTH_BITS + 1))
        then = Signal(48, init=-Quadrature.latency(1) & (1 << 48) - 1)
        m.d.sync += [
            late.eq(length),
            late_before.eq(late),
            jump.eq(late_before - late),
            then.eq((Cat(1, then) + Cat(1, jump).as_signed())[1:]),
        ]

        m.submodules.barrier = index = Index()
        m.d.comb += [
            index.level.eq(barrier),
            index.valid.eq(align.valid),
            index.time.eq(then),
            index.count.eq(encoder.count),
            index.edge.eq(encoder.edge),
            index.backward.eq(encoder.backward),
            index.debounce.eq(length),
            index.invert.eq(settings.index_invert),
            index.counts_per_turn.eq(settings.counts_per_turn),
            self.index_time.eq(index.pass_time),
            index.policy.eq(settings.index_policy),
            self.index_count.eq(index.zero_count),
            self.pass_count.eq(index.pass_count),
            self.index_difference.eq(index.difference),
            self.index_passes.eq(index.passes),
            self.index_seen.eq(index.seen),
            self.encoder_errors.illegal.eq(encoder.illegals),
            self.encoder_errors.turns.eq(index.turns),
        ]

        m.submodules.latch = latch = AngleLatch(keep_first=self.features.close_images)
        m.d.comb += [
            latch.row_first.eq(row_first),
            latch.frame_first.eq(frame_first),
            latch.now.time.eq(then),
            latch.now.count.eq(encoder.count),
            latch.now.age.eq(encoder.age),
            latch.now.period.eq(encoder.period),
            self.first.eq(latch.first),
            self.last.eq(latch.last),
            self.first_is_last.eq(latch.first_is_last),
        ]

        if self.features.edge_log:
            m.submodules.log = log = EdgeLog()
            m.d.comb += [
                log.edge.eq(encoder.edge),
                log.backward.eq(encoder.backward),
                log.count.eq(encoder.count),
                log.time.eq(then),
                log.take.eq(take),
                log.index.eq(self.edge_index),
                self.edges.eq(log.entries),
                self.edge_shift.eq(log.shift),
                self.edge.eq(log.entry),
            ]

        fault = Signal()
        fault_now = Signal()
        m.d.comb += fault_now.eq(fault | encoder.illegal | index.wrong)
        m.d.sync += [self.taken.eq(take), fault.eq(fault_now & ~take)]
        with m.If(take):
            m.d.sync += self.encoder_fault.eq(fault_now)

        m.submodules.milliseconds = milliseconds = Milliseconds()
        m.submodules.enable = enable = Interlock()
        if self.features.speed_loop:
            self._closed_loop(m, encoder, index, milliseconds.tick, then, enable.state.alive)
        else:
            self._open_loop(m)

        # Light needs what is asked for of speed and angle, and an image that is to be lit.
        asked = settings.laser_conditions
        state = self.motor_state
        permitted = Signal()
        m.d.comb += permitted.eq(self.shutter & (~asked[0] | state.in_band) & (~asked[1] | state.in_sector))
        whole = Signal()
        steady = Signal()
        safety = Signal(data.StructLayout(dict.fromkeys(SAFETY, 8)))
        m.d.comb += [
            milliseconds.clock_hz.eq(self.clock_hz),
            enable.interlock.eq(self.interlock),
            enable.tick.eq(milliseconds.tick),
            enable.arm.eq(self.arm),
            enable.key.eq(self.arm_key),
            enable.renew.eq(self.renew),
            enable.lease_ms.eq(settings.laser_lease_ms),
            enable.delay_ms.eq(settings.laser_delay_ms),
            enable.sound.eq(~state.stopped),
            enable.permitted.eq(permitted),
            self.laser.eq(enable.laser),
            self.lamp.eq(enable.lamp),
            self.laser_state.eq(enable.state),
            self.laser_cause.eq(enable.cause),
            self.laser_on_whole_frame.eq(whole & enable.state.emitting),
            self.speed_in_band_whole_frame.eq(steady & state.in_band),
            safety.laser_state.eq(enable.state.as_value()),
            safety.laser_cause.eq(enable.cause),
            safety.motor_state.eq(state.as_value()),
            safety.motor_cause.eq(self.motor_cause),
            self.safety.eq(safety),
        ]
        m.d.sync += [
            whole.eq((whole | self.frame_first) & enable.state.emitting),
            steady.eq((steady | self.frame_first) & state.in_band),
        ]
        return m

    def _open_loop(self, m: Module) -> None:
        """The motor without its program: state, cause and speed stay 0."""
        m.submodules.motor = motor = OpenLoop(pwm_period=self.features.pwm_period)
        m.d.comb += [
            motor.settings.eq(self.settings),
            self.pwm.eq(motor.pwm),
            self.direction.eq(motor.direction),
            self.brake.eq(motor.brake),
            self.write.ready.eq(1),
        ]

    def _closed_loop(
        self, m: Module, encoder: Quadrature, index: Index, tick: Value, then: Value, alive: Value
    ) -> None:
        """The motor with its program."""
        m.submodules.motor = motor = MotorControl()
        m.d.comb += [
            motor.settings.eq(self.settings),
            motor.clock_hz.eq(self.clock_hz),
            motor.tick.eq(tick),
            motor.time.eq(then),
            motor.alive.eq(alive),
            self.pwm.eq(motor.pwm),
            self.direction.eq(motor.direction),
            self.brake.eq(motor.brake),
            self.speed.eq(motor.speed),
            self.motor_state.eq(motor.state),
            self.motor_cause.eq(motor.cause),
        ]
        for name in ("count", "edge", "backward", "illegal", "age"):
            m.d.comb += getattr(motor, name).eq(getattr(encoder, name))
        for name in ("passed", "pass_count", "zero_count", "seen", "wrong", "difference"):
            m.d.comb += getattr(motor, name).eq(getattr(index, name))

        # Registers of the motor are variables of its program, at the low bits of their addresses.
        ours = Signal()
        bits = len(motor.write.payload.address)
        m.d.comb += [
            ours.eq(self.write.payload.address[bits:] == SETTINGS_BASE >> bits),
            motor.write.valid.eq(self.write.valid & ours),
            motor.write.payload.address.eq(self.write.payload.address),
            motor.write.payload.value.eq(self.write.payload.value),
            self.write.ready.eq(motor.write.ready | ~ours),
        ]
