"""The motor of a card without the motor's program: a duty, and no more."""

from amaranth.hdl import Module, Mux
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import MotorMode

from ..layouts import NowSettings
from .pwm import Pwm


class OpenLoop(wiring.Component):
    """Drives the motor with ``motor_duty`` in mode ``DUTY``, and lets it run out in all others.

    Nothing is measured of it and nothing watched: a motor that stalls or runs away goes on, with or without a host.
    Fit for a small motor that may stall; :class:`~gateware.motion.motor.MotorControl` is the one that stops by itself.

    Members
    -------
    settings : registers in force
    pwm, direction, brake : pins
    """

    settings: In(NowSettings)
    pwm: Out(1)
    direction: Out(1)
    brake: Out(1)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        settings, mode = self.settings, self.settings.motor_mode
        m.submodules.driver = driver = Pwm()
        m.d.comb += [
            driver.period.eq(settings.motor_period),
            driver.duty.eq(Mux(mode == MotorMode.DUTY, settings.motor_duty, 0)),
            driver.brake.eq(settings.motor_brake),
            driver.enable.eq(mode != MotorMode.OFF),
            driver.antiphase.eq(settings.motor_bridge),
            self.pwm.eq(driver.pwm),
            self.direction.eq(driver.direction),
            self.brake.eq(driver.braking),
        ]
        return m
