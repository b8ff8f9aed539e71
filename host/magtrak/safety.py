"""What the card says of laser and motor, and what that means."""

from dataclasses import dataclass

from .protocol import LaserCause, MotorCause

_LASER = {
    LaserCause.INTERLOCK: "the interlock was opened, so the laser is off: close it, then start again",
    LaserCause.LEASE: "the card heard nothing from this computer for laser.lease_s, so the laser is off: start again",
}

_MOTOR = {
    MotorCause.STALL: "the motor does not move (stall): free the rotor, check its supply and motor.friction",
    MotorCause.RUNAWAY: "the motor turned the wrong way or too fast (run-away): check its polarity, and A and B of the"
    " encoder for a swap",
    MotorCause.ENCODER: "the encoder gives transitions that no shaft makes: check A and B for a broken wire or noise",
    MotorCause.TURN: "a turn had another number of counts than encoder.counts_per_turn: check the index for double"
    " pulses, and the encoder for noise",
    MotorCause.INDEX_MISSING: "the index did not come for more than a turn: check the index barrier",
    MotorCause.SEARCH: "the index was not found within motor.search_deg: check the index barrier, or search further",
    MotorCause.LEASE: "the card heard nothing from this computer for laser.lease_s, so motor and laser are off:"
    " start again",
}


@dataclass(frozen=True)
class Safety:
    """Register ``safety``, read at one moment."""

    laser_state: int
    laser_cause: int
    motor_state: int
    motor_cause: int

    @classmethod
    def of(cls, word: int) -> "Safety":
        return cls(*(word >> shift & 0xFF for shift in (0, 8, 16, 24)))

    @property
    def armed(self) -> bool:
        return bool(self.laser_state & 2)

    @property
    def stopped(self) -> bool:
        """A fault has stopped the motor."""
        return bool(self.motor_state & 1)

    def fault(self, armed: bool) -> str | None:
        """What went wrong, in one sentence; ``armed``: the laser should be so."""
        if self.stopped:
            return _text(_MOTOR, self.motor_cause, "the card stopped the motor")
        if armed and not self.armed and self.laser_cause not in (LaserCause.NEVER_ARMED, LaserCause.COMMAND):
            return _text(_LASER, self.laser_cause, "the card disarmed the laser")
        return None


def _text(texts: dict[LaserCause, str] | dict[MotorCause, str], cause: int, default: str) -> str:
    known = {int(key): text for key, text in texts.items()}
    return known.get(cause, f"{default} (cause {cause})")
