"""Everything that can go wrong with motor, encoder, host and interlock, through the compiled card.

Each fault ends with the laser off within a millisecond of its detection (the brake is the sign of it), the motor
stopped where it must, and one sentence for the user. ``DETECTION_S`` is what ``docs/safety.md`` states.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magtrak.card import Card
from magtrak.errors import CardError
from magtrak.link import Link
from magtrak.protocol import LASER_KEY, LaserCause, MotorCause
from magtrak.safety import Safety
from magtrak.settings import LaserSwitch, Settings
from sim.core import INTERLOCK
from sim.encoder import Signal
from tests.support.fake_card import FakeCard
from tests.support.rig import COUNTS, SLICE_S, TUNED, Rig, cut, noise, second_index, seize, swapped, without_index

TURN_S = 360 / TUNED.speed_deg_s

DETECTION_S = {
    "stalled rotor": 0.35,
    "cut A": 0.05,
    "cut B": 0.05,
    "swapped A and B": 0.25,
    "missing index": 1.3 * TURN_S,
    "double index": 1.6 * TURN_S,
    "noise on A": 0.1,
    "noise on A and B": 0.1,
}
"""Greatest time from the fault to the brake, at 300 deg/s and 1024 counts a turn; for the index, the time until the
barrier is next passed, or missed, is in it."""


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.close()


def turning(rig: Rig, seconds: float = 0.6) -> None:
    """Laser on, motor at its speed."""
    rig.start()
    rig.run(seconds)
    assert rig.samples[-1].laser and abs(rig.samples[-1].speed_deg_s - 300) < 6
    assert rig.safety().fault(armed=True) is None


def break_it(rig: Rig, what: str) -> None:
    if what == "stalled rotor":
        seize(rig)
    elif what == "missing index":
        rig.alter = without_index
    elif what == "double index":
        rig.alter = second_index(TURN_S / 2)
    elif what.startswith("cut"):
        rig.alter = cut(Signal[what[-1]])
    else:
        signals = [Signal.A, Signal.B] if what.endswith("B") else [Signal.A]
        rig.alter = noise(signals, dict(rig.motor.levels()), seed=3)


CASES = [
    ("stalled rotor", MotorCause.STALL, "does not move"),
    ("cut A", MotorCause.ENCODER, "broken wire"),
    ("cut B", MotorCause.ENCODER, "broken wire"),
    ("missing index", MotorCause.INDEX_MISSING, "check the index barrier"),
    ("double index", MotorCause.TURN, "double pulses"),
    ("noise on A", MotorCause.ENCODER, "noise"),
    ("noise on A and B", MotorCause.ENCODER, "noise"),
]


@pytest.mark.parametrize(("what", "cause", "words"), CASES)
def test_fault_of_a_turning_motor(rig: Rig, what: str, cause: MotorCause, words: str) -> None:
    # The index is needed twice before a turn can be wrong.
    turning(rig, 0.6 if what not in ("missing index", "double index") else 0.2 + 1.1 * TURN_S)
    begin = rig.time_s
    break_it(rig, what)
    ends_dark(rig, begin, what, cause, words)


def ends_dark(rig: Rig, begin: float, what: str, cause: MotorCause, words: str) -> None:
    """The fault is seen in time, laser and motor end, the user is told."""
    detected = rig.run(2 * DETECTION_S[what] + 1.0, until=lambda sample: sample.braked)
    assert detected is not None, f"{what} is not detected"
    print(f"{what}: detected after {detected - begin:.4f} s")
    assert detected - begin <= DETECTION_S[what]
    rig.run(1e-3 - SLICE_S)
    assert not rig.samples[-1].laser, "the laser is off within a millisecond"
    rig.run(0.5)
    assert not any(sample.laser for sample in rig.samples[-round(0.5 / SLICE_S) :])
    assert rig.samples[-1].duty == 0 and abs(rig.samples[-1].speed_deg_s) < 3, "the motor stands"
    safety = rig.safety()
    assert (safety.motor_cause, safety.laser_cause) == (cause, LaserCause.MOTOR)
    sentence = safety.fault(armed=True)
    assert sentence is not None and words in sentence and "\n" not in sentence
    # What has stopped stays so until it is started anew, and neither key nor mode alone is a start.
    rig.write("laser_arm", LASER_KEY)
    rig.write("motor_mode", rig.settings.motor.mode_word())
    rig.run(0.1)
    assert not rig.samples[-1].laser and rig.samples[-1].duty == 0


def test_swapped_encoder_wires() -> None:
    """A motor that seems to run the wrong way ever faster; from its start on."""
    rig = Rig(alter=swapped)
    rig.start()
    begin = rig.time_s
    ends_dark(rig, begin, "swapped A and B", MotorCause.RUNAWAY, "A and B")
    rig.close()


def test_overspeed(rig: Rig) -> None:
    turning(rig)
    rig.write("motor_speed_max", 256 * 700)  # the motor is at 853 counts/s
    begin = rig.time_s
    detected = rig.run(0.1, until=lambda sample: not sample.laser)
    assert detected is not None and detected - begin < 10e-3
    assert rig.safety().motor_cause == MotorCause.RUNAWAY


def test_lost_host(rig: Rig) -> None:
    """Laser and motor end when the lease lapses, and a host that comes back must start anew."""
    rig.settings = replace(rig.settings, laser=LaserSwitch(lease_s=0.2, delay_s=0.01))
    turning(rig)
    rig.pinging = False
    begin = rig.time_s
    off = rig.run(1.0, until=lambda sample: not sample.laser)
    assert off is not None and 0.1 < off - begin <= 0.2 + 1e-3
    rig.run(0.5)
    assert rig.samples[-1].duty == 0 and abs(rig.samples[-1].speed_deg_s) < 3
    safety = rig.safety()
    assert safety.laser_cause in (LaserCause.LEASE, LaserCause.MOTOR) and safety.motor_cause == MotorCause.LEASE
    assert "heard nothing from this computer" in (safety.fault(armed=True) or "")
    rig.pinging = True
    rig.run(0.3)
    assert not rig.samples[-1].laser and rig.samples[-1].duty == 0


def test_opened_interlock(rig: Rig) -> None:
    """Dark at once; the motor may go on. Closing it again is no arming."""
    turning(rig)
    rig.set_pin(INTERLOCK, 0)
    rig.run(SLICE_S)
    assert not rig.samples[-1].laser
    rig.set_pin(INTERLOCK, 1)
    rig.run(0.1)
    assert not any(sample.laser for sample in rig.samples[-round(0.1 / SLICE_S) :])
    assert abs(rig.samples[-1].speed_deg_s - 300) < 6
    safety = rig.safety()
    assert safety.laser_cause == LaserCause.INTERLOCK
    assert safety.fault(armed=True) == "the interlock was opened, so the laser is off: close it, then start again"


@pytest.mark.parametrize("quarter", range(4))
def test_power_up_in_any_encoder_state(quarter: int) -> None:
    """Dark, without drive, without a count or an error; and the scan then starts like any other."""
    rig = Rig(angle_rad=(quarter - 40 + 0.5) * 2 * np.pi / COUNTS)
    rig.run(0.05)
    assert not any(sample.laser or sample.duty for sample in rig.samples)
    assert (rig.read("count"), rig.read("encoder_errors")) == (0, 0)
    assert rig.read("laser_cause") == LaserCause.NEVER_ARMED
    turning(rig)
    assert rig.read("encoder_errors") == 0
    rig.close()


def test_light_only_in_the_sector_and_at_speed() -> None:
    rig = Rig(laser=LaserSwitch(delay_s=0.0, needs_speed=True, sector_deg=(90.0, 180.0)))
    rig.start()
    seen: list[tuple[float, float, bool]] = []

    def note(sample: object) -> bool:
        seen.append((float(np.degrees(rig.motor.trajectory.angle_rad)), rig.motor.speed_rad_s, rig.samples[-1].laser))
        return False

    rig.run(2.5, until=note)
    lit = [angle % 360 for angle, _, on in seen if on]
    assert lit and min(lit) > 89.5 and max(lit) < 181
    # All of the sector of the second turn, but for the measurement's milliseconds.
    second = [angle for angle, _, on in seen if on and angle > 360]
    assert max(second) - min(second) > 88
    rig.close()


def test_sweep_finds_the_index_and_stays_between_its_angles() -> None:
    motor = replace(TUNED, mode="sweep", sweep_deg=(-20.0, 40.0), speed_deg_s=100.0, acceleration_deg_s2=2000.0)
    rig = Rig(motor)
    rig.start()
    angles: list[float] = []
    rig.run(3.0, until=lambda _: bool(angles.append(float(np.degrees(rig.motor.trajectory.angle_rad)))))
    assert rig.safety().fault(armed=True) is None
    after = np.array(angles[round(0.8 / SLICE_S) :])
    assert -21.5 < after.min() < -18 and 38 < after.max() < 41.5
    turns = int((np.diff(np.sign(np.diff(after[::10]))) != 0).sum())
    assert turns >= 3
    rig.close()


@pytest.mark.parametrize(
    ("search_deg", "found"),
    [(30.0, True), (5.0, False)],
)
def test_index_search(search_deg: float, found: bool) -> None:
    rig = Rig(replace(TUNED, mode="search", speed_deg_s=60.0, search_deg=search_deg))
    rig.start()
    rig.run(1.5)
    assert abs(rig.samples[-1].speed_deg_s) < 2
    safety = rig.safety()
    assert bool(safety.motor_state & 2) == found
    assert safety.motor_cause == (MotorCause.NONE if found else MotorCause.SEARCH)
    rig.close()


def test_the_host_raises_the_sentence(tmp_path: Path) -> None:
    """The ping's answer is enough: no frame needs to come."""
    word = Safety(0b1101, LaserCause.MOTOR, 1, MotorCause.STALL)
    value = word.laser_state | word.laser_cause << 8 | word.motor_state << 16 | word.motor_cause << 24
    with FakeCard(loop_for_ever=True, identity={"safety": value}) as fake, Link(fake.port) as link:
        card = Card(link)
        settings = Settings(laser=LaserSwitch(lease_s=0.2))
        card.apply(settings)
        card.start(settings)
        with pytest.raises(CardError, match="the motor does not move"):
            for _ in card.frames():
                pass
