"""The motor's settings, and the registers they make."""

from dataclasses import dataclass
from math import sqrt

from .errors import SettingsError
from .protocol import Bridge, IndexPolicy, MotorMode

MODES = ("off", "duty", "speed", "sweep", "search")
BRIDGES = ("sign-magnitude", "locked-antiphase")
FAULTS = ("stall", "runaway", "encoder", "index", "lease")
POLICIES = ("reset", "latch", "first")

FULL_DUTY = 32767
_SPEED_UNITS = 256  # registers hold speeds in 1/256 counts/s
_GAIN_UNITS = 65536
_STEP_S = 1e-3


@dataclass(frozen=True)
class Motor:
    """What the motor does. Angles are the motor's own: in the direction of the counts, 0 at the index.

    Parameters
    ----------
    mode : one of ``MODES``: "duty" is open loop; "speed" turns; "sweep" goes to and fro; "search" ends at the index
    duty : PWM duty with sign, -1 to 1, of "duty"
    pwm_hz : frequency of the PWM
    bridge : one of ``BRIDGES``
    speed_deg_s : speed with sign; of a sweep the magnitude, and the direction in which the index is looked for
    acceleration_deg_s2 : of starts and reversals
    sweep_deg : between which angles; there it stands still for a moment
    search_deg : how far the index is looked for in each direction; 0 for no end
    kp, ki : gains of the speed loop: duty per deg/s, and per deg
    feed_forward, friction : duty per deg/s wanted, and duty in the direction wanted
    duty_max : greatest duty of the loop
    speed_band : part of the speed by which it may be off and still be in band
    watch : those of ``FAULTS`` that stop the motor and the laser; None: none of an open loop, all of a closed one
    stall_s : time without movement that is a stall
    runaway_deg : way in the wrong direction that is a run-away
    speed_max_deg_s : a greater speed is a run-away; 0 for twice the speed and 10 deg/s
    """

    mode: str = "duty"
    duty: float = 0.25
    pwm_hz: float = 25_000.0
    bridge: str = "sign-magnitude"
    speed_deg_s: float = 7.5
    acceleration_deg_s2: float = 100.0
    sweep_deg: tuple[float, float] = (0.0, 45.0)
    search_deg: float = 0.0
    kp: float = 0.02
    ki: float = 0.2
    feed_forward: float = 0.0
    friction: float = 0.0
    duty_max: float = 1.0
    speed_band: float = 0.1
    watch: tuple[str, ...] | None = None
    stall_s: float = 0.3
    runaway_deg: float = 3.0
    speed_max_deg_s: float = 0.0

    def duty_word(self) -> int:
        """Value of ``motor_duty``."""
        return round(self.duty * FULL_DUTY)

    def mode_word(self) -> MotorMode:
        """Value of ``motor_mode``."""
        return MotorMode[self.mode.upper()]

    @property
    def closed_loop(self) -> bool:
        return self.mode in ("speed", "sweep", "search")

    def turning_way_deg(self) -> float:
        """Way from where a sweep begins to turn round to where it stands."""
        return self.speed_deg_s**2 / (2 * self.acceleration_deg_s2)

    def registers(self, clock_hz: float, counts_per_turn: int) -> dict[str, int]:
        """Values of the motor's registers, but for those that start it.

        Raises
        ------
        SettingsError
            The counts of a turn are not known, or a sweep is too narrow for its speed.
        """
        watched = self.watch if self.watch is not None else FAULTS if self.closed_loop else ()
        values = {
            "motor_mode": int(MotorMode.OFF),
            "motor_duty": 0,
            "motor_brake": 0,
            "motor_period": round(clock_hz / self.pwm_hz),
            "motor_bridge": int(Bridge[self.bridge.upper().replace("-", "_")]),
            "motor_watch": sum(1 << bit for bit, name in enumerate(FAULTS) if name in watched),
            "motor_stall_ms": round(self.stall_s / _STEP_S),
            "motor_friction": round(self.friction * FULL_DUTY),
            "motor_duty_max": round(self.duty_max * FULL_DUTY),
        }
        if not self.closed_loop:
            return values
        if not counts_per_turn:
            raise SettingsError(f"motor.mode is {self.mode!r}, which needs encoder.counts_per_turn: give it")
        if self.speed_deg_s == 0:
            raise SettingsError(f"motor.mode is {self.mode!r}, which needs motor.speed_deg_s: give it")
        counts = counts_per_turn / 360
        speed = abs(self.speed_deg_s) * counts
        per_count = FULL_DUTY / counts * _GAIN_UNITS
        values |= {
            "motor_speed": round(self.speed_deg_s * counts * _SPEED_UNITS),
            "motor_acceleration": max(round(self.acceleration_deg_s2 * counts * _STEP_S * _SPEED_UNITS), 1),
            "motor_kp": round(self.kp * per_count),
            "motor_ki": round(self.ki * _STEP_S * per_count),
            "motor_kff": round(self.feed_forward * per_count),
            "motor_search": round(self.search_deg * counts),
            "motor_runaway": max(round(self.runaway_deg * counts), 4),
            "motor_speed_max": round((self.speed_max_deg_s * counts or 2 * speed + 10 * counts) * _SPEED_UNITS),
            "speed_low": round(speed * (1 - self.speed_band) * _SPEED_UNITS),
            "speed_high": round(speed * (1 + self.speed_band) * _SPEED_UNITS),
        }
        if self.mode == "sweep":
            way = self.turning_way_deg()
            low, high = self.sweep_deg[0] + way, self.sweep_deg[1] - way
            if high <= low:
                fastest = sqrt((self.sweep_deg[1] - self.sweep_deg[0]) * self.acceleration_deg_s2)
                raise SettingsError(
                    f"motor.sweep_deg is {list(self.sweep_deg)}, too narrow to turn round at {self.speed_deg_s:g} deg/s"
                    f" with {self.acceleration_deg_s2:g} deg/s2: stay below {fastest:.3g} deg/s, or accelerate more"
                )
            values |= {"sweep_low": round(low * counts), "sweep_high": round(high * counts)}
        return values


def policy_word(policy: str) -> int:
    """Value of ``index_policy``."""
    return int(IndexPolicy[policy.upper()])
