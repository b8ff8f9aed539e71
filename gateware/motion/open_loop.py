"""The motor of a card without the motor's program: a duty, and no more."""

from amaranth.hdl import Module, Mux
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import MotorMode

from ..layouts import NowSettings
from .fixed_pwm import FixedPwm
from .pwm import Pwm


class OpenLoop(wiring.Component):
    """Drives the motor with ``motor_duty`` in mode ``DUTY``, and lets it run out in all others.

    Nothing is measured of it and nothing watched: a motor that stalls or runs away goes on, with or without a host.
    Fit for a small motor that may stall; :class:`~gateware.motion.motor.MotorControl` is the one that stops by itself.

    Parameters
    ----------
    pwm_period : False: ``motor_period`` is taken for :data:`~gateware.motion.fixed_pwm.PERIOD`

    Members
    -------
    settings : registers in force
    pwm, direction, brake : pins
    """

    settings: In(NowSettings)
    pwm: Out(1)
    direction: Out(1)
    brake: Out(1)

    def __init__(self, *, pwm_period: bool = True) -> None:
        self.pwm_period = pwm_period
        super().__init__()

    def elaborate(self, platform: object) -> Module:
        m = Module()
        settings, mode = self.settings, self.settings.motor_mode
        driver: Pwm | FixedPwm
        if self.pwm_period:
            driver = Pwm()
            m.d.comb += driver.period.eq(settings.motor_period)
        else:
            driver = FixedPwm()
        m.submodules.driver = driver
        m.d.comb += [
            driver.duty.eq(Mux(mode == MotorMode.DUTY, settings.motor_duty, 0)),
            driver.brake.eq(settings.motor_brake),
            driver.enable.eq(mode != MotorMode.OFF),
            driver.antiphase.eq(settings.motor_bridge),
            self.pwm.eq(driver.pwm),
            self.direction.eq(driver.direction),
            self.brake.eq(driver.braking),
        ]
        return m
