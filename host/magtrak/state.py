"""What a card is doing, in people's units."""

from dataclasses import dataclass

from .card import Card
from .protocol import ENCODER_ERRORS, Choice, Detector, LaserCause, MotorCause, MotorMode, register
from .safety import Safety
from .sensor import REGISTERS as _SENSOR_NAMES
from .sensor import SensorReport

_NAMES = (
    "run",
    "generation",
    "pending",
    "frames",
    "dropped",
    "damaged_commands",
    "line_errors",
    "camera_errors",
    "detector",
    "choice",
    "count",
    "index_count",
    "index_passes",
    "encoder_errors",
    "counts_per_turn",
    "speed",
    "motor_mode",
    "motor_state",
    "safety",
    "laser_state",
    *_SENSOR_NAMES,
)
_SPEED_UNITS = 256


@dataclass(frozen=True)
class State:
    """Registers read one after the other, in a millisecond or a few."""

    values: dict[str, int]
    clock_hz: float

    @classmethod
    def read(cls, card: Card) -> "State":
        return cls(dict(zip(_NAMES, card.read_all(_NAMES), strict=True)), card.identity.clock_hz)

    @property
    def sensor(self) -> SensorReport:
        """The camera's bus, set-up and timing."""
        return SensorReport(self.values, self.clock_hz)

    @property
    def safety(self) -> Safety:
        return Safety.of(self.values["safety"])

    @property
    def encoder_errors(self) -> int:
        """Illegal transitions and wrong turns."""
        word = self.values["encoder_errors"].to_bytes(ENCODER_ERRORS.size, "little")
        return sum(ENCODER_ERRORS.unpack(word).values())

    def angle(self) -> str:
        """The motor's angle, in degrees where the counts of a turn are known."""
        v = self.values
        counts = (v["count"] - v["index_count"] + 2**31) % 2**32 - 2**31
        if not v["motor_state"] & 2:
            return f"{v['count']} counts, index not passed"
        if not v["counts_per_turn"]:
            return f"{counts} counts from the index"
        return f"{360 * counts / v['counts_per_turn']:.3f} deg ({counts} counts)"

    def laser(self) -> str:
        """In a few words."""
        state = self.values["laser_state"]
        if state & 1:
            return "on"
        if state & 2:
            return "armed, waiting for its conditions" if not state & 32 else "armed, about to come on"
        if not state & 4:
            return "off, interlock open"
        return f"off ({_word(LaserCause, self.safety.laser_cause)})"

    def motor(self) -> str:
        """In a few words."""
        v = self.values
        speed = f"{v['speed'] / _SPEED_UNITS:.1f} counts/s"
        if v["counts_per_turn"]:
            speed = f"{360 * v['speed'] / _SPEED_UNITS / v['counts_per_turn']:.2f} deg/s"
        if self.safety.stopped:
            return f"stopped by a fault ({_word(MotorCause, self.safety.motor_cause)}), {speed}"
        band = ", in band" if v["motor_state"] & 4 and v["motor_mode"] else ""
        return f"{_word(MotorMode, v['motor_mode'])}, {speed}{band}"

    def measurement(self) -> str:
        """In a few words."""
        v = self.values
        what = f"{_word(Detector, v['detector'])}, {_word(Choice, v['choice'])} peak, settings {v['generation']}"
        waiting = ", others pending" if v["pending"] else ""
        return f"{'on' if v['run'] else 'off'} ({what}{waiting})"


def _word(kind: type[Detector | Choice | MotorMode | MotorCause | LaserCause], value: int) -> str:
    try:
        return kind(value).name.lower().replace("_", " ")
    except ValueError:
        return str(value)


assert all(register(name) for name in _NAMES)
