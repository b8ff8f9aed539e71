"""The whole card without clocks, pins and link."""

from amaranth.hdl import Module
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from .crossing.tables import TableGuard
from .features import EVERYTHING, Features
from .frame.alternation import Alternation
from .frame.assembler import FrameAssembler
from .frame.buffer import FrameBuffer
from .frame.facts import MotionFacts
from .layouts import Bytes, CameraStatus, Video
from .link.link import Link
from .motion.motion import Motion
from .pixel_path import ClockedPixelPath, PixelPath
from .registers import RegisterFile


class Core(wiring.Component):
    """Pixels, encoder and commands in; motor, laser and packets out.

    Parameters
    ----------
    features : what the card is built with
    pixel_domain : clock domain of ``video`` and ``run``, in which pixels are measured: ``sync``, which is that of all
        else, or another (:class:`~gateware.pixel_path.ClockedPixelPath` has its limits)

    Members
    -------
    video : images; see :class:`~gateware.layouts.Video` for the source's contract
    encoder_a, encoder_b, index, interlock : pins, asynchronous
    pwm, direction, brake : motor driver
    laser, lamp : laser enable and its warning lamp; low at reset
    clock_hz : frequency of the ``sync`` domain, constant
    serial : serial number of the card, constant; 0: it has none
    link_baud : rate of its UART, constant; 0: another kind of link
    rx, tx : bytes from and to the host
    line_errors : bytes from the host that the physical link lost, saturating
    run : the host wants images; a source that can be held waits for it
    camera : what the source tells of its camera; only shown in the registers
    camera_exposure, camera_gain : what the camera is to be set to, as the registers of these names have it
    """

    def __init__(self, features: Features = EVERYTHING, pixel_domain: str = "sync") -> None:
        self.features = features
        self.pixel_domain = pixel_domain
        super().__init__(
            {
                "video": In(Video()),
                "encoder_a": In(1),
                "encoder_b": In(1),
                "index": In(1),
                "interlock": In(1),
                "pwm": Out(1),
                "direction": Out(1),
                "brake": Out(1),
                "laser": Out(1),
                "lamp": Out(1),
                "clock_hz": In(32),
                "serial": In(64),
                "link_baud": In(32),
                "rx": In(Bytes),
                "tx": Out(Bytes),
                "line_errors": In(16),
                "run": Out(1),
                "camera": In(CameraStatus),
                "camera_exposure": Out(16),
                "camera_gain": Out(10),
            }
        )

    def elaborate(self, platform):
        m = Module()
        features = self.features
        own_clock = self.pixel_domain != "sync"
        path = ClockedPixelPath(features, self.pixel_domain) if own_clock else PixelPath(features)
        m.submodules.pixels = pixels = path
        m.submodules.alternation = alternation = Alternation()
        m.submodules.motion = motion = Motion(self.features)
        m.submodules.buffer = buffer = FrameBuffer(
            features.max_rows,
            edge_log=features.edge_log,
            close_images=features.close_images,
            fast_clock=features.fast_clock,
        )
        m.submodules.assembler = assembler = FrameAssembler(features.max_rows, edge_log=features.edge_log)
        m.submodules.registers = registers = RegisterFile(features, keep=features.fast_clock or own_clock)
        m.submodules.link = link = Link()

        # Pixels to packets.
        connect(m, flipped(self.video), pixels.video)
        connect(m, pixels.rows, buffer.rows)
        connect(m, buffer.reader, assembler.i)
        connect(m, assembler.o, link.frame)
        connect(m, link.tx, flipped(self.tx))

        # Pictures for people.
        if features.snapshot:
            connect(m, pixels.snapshot, link.snapshot)
            m.d.comb += [
                pixels.now.eq(registers.now),
                pixels.number.eq(buffer.number),
                pixels.generation.eq(registers.generation),
                registers.status.snapshot_busy.eq(pixels.snapshot_busy),
            ]

        # Commands to settings, and their answers.
        connect(m, flipped(self.rx), link.rx)
        command = link.command
        if own_clock:
            m.submodules.guard = guard = TableGuard()
            connect(m, command, guard.i)
            m.d.comb += guard.busy.eq(pixels.tables_busy)
            command = guard.o
        connect(m, command, registers.command)
        connect(m, registers.answer, link.answer)
        connect(m, registers.lut, pixels.lut)
        connect(m, registers.write, motion.write)
        m.d.comb += [
            self.run.eq(pixels.source_run),
            pixels.run.eq(registers.now.run),
            registers.frame_start.eq(pixels.frame_first),
            pixels.settings.eq(registers.frame),
            motion.settings.eq(registers.now),
            motion.arm.eq(registers.arm),
            motion.arm_key.eq(registers.arm_key),
            motion.renew.eq(link.intact),
        ]

        # Encoder, motor and laser.
        for name in ("encoder_a", "encoder_b", "index", "interlock", "clock_hz"):
            m.d.comb += getattr(motion, name).eq(getattr(self, name))
        for name in ("pwm", "direction", "brake", "laser", "lamp"):
            m.d.comb += getattr(self, name).eq(getattr(motion, name))

        # Some images are taken without laser.
        m.d.comb += [
            alternation.settings.eq(registers.frame),
            alternation.run.eq(pixels.wanted),
            alternation.frame_first.eq(pixels.frame_first),
            alternation.frame_end.eq(pixels.frame_end),
            alternation.subtracted.eq(pixels.subtracted),
            pixels.background.eq(alternation.background),
            motion.shutter.eq(alternation.laser),
            buffer.image.phase.eq(alternation.phase),
        ]

        # Images are stamped with the angle.
        m.d.comb += [
            motion.frame_first.eq(pixels.frame_first),
            motion.row_first.eq(pixels.row_first),
            motion.take.eq(buffer.take),
            motion.edge_index.eq(buffer.edge_index),
            buffer.frame_first.eq(pixels.frame_first),
            buffer.frame_end.eq(pixels.frame_end),
            buffer.refused.eq(pixels.refused),
            buffer.first_is_last.eq(motion.first_is_last),
            buffer.taken.eq(motion.taken),
            buffer.edge.eq(motion.edge),
            buffer.vision.eq(pixels.vision),
            buffer.damaged_commands.eq(link.damaged),
            buffer.line_errors.eq(self.line_errors),
            buffer.moving.eq(link.tx.valid & link.tx.ready),
            buffer.image.field.eq(pixels.field),
            buffer.start.generation.eq(registers.generation),
            buffer.form.eq(registers.now.form),
            buffer.image.laser_on.eq(motion.laser_on_whole_frame),
            buffer.image.speed_in_band.eq(motion.speed_in_band_whole_frame),
            buffer.image.motor_stopped.eq(motion.motor_state.stopped),
        ]
        for name in ("detector", "exposure_us", "time_offset_ns"):
            m.d.comb += buffer.start[name].eq(registers.frame[name])
        for name, _ in data.Layout.cast(MotionFacts):
            m.d.comb += buffer.motion[name].eq(getattr(motion, name))

        # What the registers show.
        status = registers.status
        m.d.comb += [
            status.clock_hz.eq(self.clock_hz),
            status.serial_low.eq(self.serial[:32]),
            status.serial_high.eq(self.serial[32:]),
            status.link_baud.eq(self.link_baud),
            status.line_errors.eq(self.line_errors),
            status.commands.eq(link.count),
            status.frames.eq(buffer.frames),
            status.dropped.eq(buffer.dropped),
            status.damaged_commands.eq(link.damaged),
            status.camera_errors.eq(pixels.errors_ever),
        ]
        for name, _ in data.Layout.cast(CameraStatus):
            m.d.comb += status[name].eq(self.camera[name])
        for name in ("camera_exposure", "camera_gain"):
            m.d.comb += getattr(self, name).eq(registers.now[name])
        for name in (
            *("count", "index_count", "index_passes", "pass_count", "index_difference", "encoder_errors", "speed"),
            *("motor_state", "motor_cause", "laser_state", "laser_cause", "safety"),
        ):
            m.d.comb += status[name].eq(getattr(motion, name))

        return m
