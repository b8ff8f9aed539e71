"""What turns the laser: one interface, and the motor that the card's PWM drives.

A :class:`Drive` moves in steps, because the future of a motor depends on the PWM that the card has not
made yet; its past stays known for the exposure windows of the rows.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import ceil, copysign, exp, log, pi, sin

import numpy.typing as npt

from .encoder import Encoder, Event, Flaws, IndexBarrier, Signal
from .trajectory import Floats, Segment, Trajectory

HISTORY_S = 1.0
"""How far back :meth:`Drive.angle` remembers; exposure and read-out delay have to be shorter."""

INDEX_WIDTH_COUNTS = 16
"""Counts for which the index barrier is high."""


class Drive(ABC):
    """Angle, encoder and index of the laser's axis.

    Parameters
    ----------
    angle_rad : where it stands at time 0
    counts_per_turn : of the encoder, after x4 decoding
    index_width_counts : how long the index barrier is high
    flaws : of the encoder
    """

    def __init__(
        self,
        angle_rad: float,
        counts_per_turn: int,
        index_width_counts: int = INDEX_WIDTH_COUNTS,
        flaws: Flaws | None = None,
    ) -> None:
        self.encoder = Encoder(counts_per_turn, angle_rad, flaws)
        self.index = IndexBarrier(counts_per_turn, index_width_counts, angle_rad)
        self.trajectory = Trajectory(0.0, angle_rad, HISTORY_S)

    @property
    def time_s(self) -> float:
        """Time up to which it has moved."""
        return self.trajectory.end_s

    def levels(self) -> dict[Signal, int]:
        """Levels of A, B and index at :attr:`time_s`."""
        return self.encoder.levels() | self.index.levels()

    def advance(self, until_s: float, duty: float = 0.0) -> list[Event]:
        """Move on to ``until_s`` with a PWM of mean ``duty`` (-1 to 1); the events on the way, in order of time.

        A time that is not later than :attr:`time_s` moves nothing.
        """
        if until_s <= self.time_s:
            return []
        segments = self._move(until_s, duty)
        events = self.encoder.follow(segments) + self.index.follow(segments)
        self.trajectory.extend(segments)
        return sorted(events)

    def angle(self, times_s: npt.ArrayLike) -> Floats:
        """Angles in radians, unwrapped, 0 at the index mark, at times up to :attr:`time_s`."""
        return self.trajectory.at(times_s)

    @abstractmethod
    def _move(self, until_s: float, duty: float) -> list[Segment]:
        """Segments from :attr:`time_s` to ``until_s``."""


@dataclass(frozen=True)
class MotorParameters:
    """A permanent-magnet motor with its gear, all seen from the laser's axis.

    ``inertia * acceleration = torque_constant * current - viscous * speed - friction * sign(speed)``, with
    ``current = (duty * supply - torque_constant * speed) / resistance``: the winding's inductance is
    left out, as its time constant is short beside the rotor's. It sets off from standstill when the drive exceeds the
    stiction. The supply is ``supply_v * (1 + ripple * sin(2 pi ripple_hz t))``.

    Parameters
    ----------
    supply_v : voltage of the bridge
    resistance_ohm : of winding and bridge
    torque_constant_nm_a : torque per current, equal to back-EMF per speed (V s/rad)
    inertia_kg_m2 : of rotor, gear and laser
    viscous_nm_s : friction that grows with speed
    friction_nm : friction that does not
    stiction_nm : friction at standstill; not less than ``friction_nm`` counts
    supply_ripple, ripple_hz : amplitude, as a part of the supply, and frequency
    load_nm : torque of the load, against positive angles
    """

    supply_v: float
    resistance_ohm: float
    torque_constant_nm_a: float
    inertia_kg_m2: float
    viscous_nm_s: float
    friction_nm: float
    stiction_nm: float = 0.0
    supply_ripple: float = 0.0
    ripple_hz: float = 100.0
    load_nm: float = 0.0

    def drive_nm(self, duty: float) -> float:
        """Torque at standstill."""
        return self.torque_constant_nm_a * duty * self.supply_v / self.resistance_ohm

    @property
    def damping_nm_s(self) -> float:
        """Torque lost per speed: back-EMF and viscous friction."""
        return self.torque_constant_nm_a**2 / self.resistance_ohm + self.viscous_nm_s

    @property
    def time_constant_s(self) -> float:
        """Of the speed."""
        return self.inertia_kg_m2 / self.damping_nm_s

    def duty(self, speed_rad_s: float) -> float:
        """The duty that keeps a speed."""
        friction = copysign(self.friction_nm, speed_rad_s) if speed_rad_s else 0.0
        return (self.damping_nm_s * speed_rad_s + friction) / self.drive_nm(1.0)


class Motor(Drive):
    """The motor, driven by the card's PWM.

    ``parameters`` may be exchanged between two movements, for a load that changes.

    Between steps of at most ``STEP_S`` the speed follows its exact exponential; the angle in between is
    the cubic through exact angles and speeds, which is off by less than 1e-9 of the movement.
    """

    STEP_S = 0.5e-3

    def __init__(
        self,
        parameters: MotorParameters,
        angle_rad: float,
        counts_per_turn: int,
        index_width_counts: int = INDEX_WIDTH_COUNTS,
        flaws: Flaws | None = None,
    ) -> None:
        super().__init__(angle_rad, counts_per_turn, index_width_counts, flaws)
        self.parameters = parameters
        self.speed_rad_s = 0.0

    def _move(self, until_s: float, duty: float) -> list[Segment]:
        begin, angle = self.time_s, self.trajectory.angle_rad
        steps = ceil((until_s - begin) / self.STEP_S)
        step = (until_s - begin) / steps
        segments = []
        for number in range(steps):
            start, end = begin + number * step, until_s if number == steps - 1 else begin + (number + 1) * step
            ripple = 1 + self.parameters.supply_ripple * sin(pi * self.parameters.ripple_hz * (start + end))
            new_angle, new_speed = self._step(angle, self.speed_rad_s, duty * ripple, step)
            segments.append(Segment.hermite(start, end, angle, new_angle, self.speed_rad_s, new_speed))
            angle, self.speed_rad_s = new_angle, new_speed
        return segments

    def _step(self, angle: float, speed: float, duty: float, length_s: float) -> tuple[float, float]:
        """Angle and speed after a step of constant duty."""
        p = self.parameters
        drive = p.drive_nm(duty) - p.load_nm
        if speed == 0.0 and abs(drive) <= max(p.stiction_nm, p.friction_nm):
            return angle, 0.0
        direction = speed if speed != 0.0 else drive
        final = (drive - (p.friction_nm if direction > 0 else -p.friction_nm)) / p.damping_nm_s
        tau = p.time_constant_s
        decay = exp(-length_s / tau)
        new = final + (speed - final) * decay
        if speed * new < 0:
            # It comes to rest within the step; whether it sets off again, the next step decides.
            return angle + self._coast(speed, final, tau), 0.0
        return angle + final * length_s + (speed - final) * tau * (1 - decay), new

    @staticmethod
    def _coast(speed: float, final: float, tau: float) -> float:
        """Way until a speed that tends to ``final`` on the other side of 0 has become 0."""
        decay = final / (final - speed)
        return final * -tau * log(decay) + (speed - final) * tau * (1 - decay)
