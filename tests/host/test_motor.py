"""Motor and laser settings to registers, and what the card says to a sentence."""

import pytest

from magtrak.errors import SettingsError
from magtrak.motor import Motor
from magtrak.protocol import Bridge, LaserCause, MotorCause, MotorMode
from magtrak.safety import Safety
from magtrak.settings import LaserSwitch
from magtrak.settings_file import parse_settings

CLOCK_HZ = 50e6
COUNTS = 3600  # ten counts a degree


def test_units_by_hand() -> None:
    motor = Motor(
        mode="sweep",
        speed_deg_s=-20,
        acceleration_deg_s2=100,
        sweep_deg=(-10, 30),
        kp=0.1,
        ki=0.5,
        feed_forward=0.01,
        friction=0.25,
        search_deg=15,
        speed_band=0.1,
        bridge="locked-antiphase",
    )
    registers = motor.registers(CLOCK_HZ, COUNTS)
    # 20 deg/s need 2 deg to stand: it begins to turn round so much before.
    assert (registers["sweep_low"], registers["sweep_high"]) == (-80, 280)
    assert registers["motor_speed"] == -200 * 256
    assert registers["motor_acceleration"] == 256  # 1000 counts/s2 are one count/s in a ms
    # 0.1 of full duty per deg/s is a tenth of that per count/s.
    assert registers["motor_kp"] == round(0.01 * 32767 * 65536)
    assert registers["motor_ki"] == round(0.05 * 32767 * 65536 / 1000)
    assert registers["motor_kff"] == round(0.001 * 32767 * 65536)
    assert (registers["motor_friction"], registers["motor_search"]) == (8192, 150)
    assert (registers["speed_low"], registers["speed_high"]) == (180 * 256, 220 * 256)
    assert registers["motor_speed_max"] == (2 * 200 + 100) * 256
    assert (registers["motor_watch"], registers["motor_bridge"]) == (31, Bridge.LOCKED_ANTIPHASE)
    # Nothing moves by this.
    assert (registers["motor_mode"], registers["motor_duty"]) == (MotorMode.OFF, 0)
    assert motor.mode_word() == MotorMode.SWEEP


def test_an_open_loop_is_watched_only_where_asked() -> None:
    assert Motor().registers(CLOCK_HZ, 0)["motor_watch"] == 0
    assert Motor(watch=("stall", "lease")).registers(CLOCK_HZ, 0)["motor_watch"] == 0b10001


def test_sector() -> None:
    assert LaserSwitch().registers(COUNTS)["laser_conditions"] == 0
    registers = LaserSwitch(needs_speed=True, sector_deg=(-10, 20)).registers(COUNTS)
    assert (registers["laser_conditions"], registers["sector_low"], registers["sector_high"]) == (3, -100, 200)


@pytest.mark.parametrize(
    ("motor", "counts", "message"),
    [
        (Motor(mode="speed"), 0, "motor.mode is 'speed', which needs encoder.counts_per_turn"),
        (Motor(mode="speed", speed_deg_s=0), COUNTS, "needs motor.speed_deg_s"),
        (Motor(mode="sweep", sweep_deg=(0, 1), speed_deg_s=20), COUNTS, "too narrow to turn round at 20 deg/s"),
    ],
)
def test_what_cannot_be_is_refused(motor: Motor, counts: int, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        motor.registers(CLOCK_HZ, counts)


@pytest.mark.parametrize(
    ("section", "values", "message"),
    [
        ("motor", {"mode": "fast"}, r"motor\.mode is 'fast'; it must be 'off' or 'duty'"),
        ("motor", {"sweep_deg": [3, 3]}, r"motor\.sweep_deg is \[3, 3\]; it must be two angles, the smaller first"),
        ("motor", {"watch": ["stall", "thieves"]}, r"motor\.watch is .*; it must be a list of some of 'stall'"),
        ("laser", {"sector_deg": [5, 1]}, r"laser\.sector_deg is \[5, 1\]; it must be two angles"),
        ("encoder", {"index_policy": "never"}, r"encoder\.index_policy is 'never'"),
    ],
)
def test_mistakes_in_files_are_named(section: str, values: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        parse_settings({section: values})


def test_every_cause_has_its_sentence() -> None:
    sentences = {Safety(2, 0, 1, cause).fault(armed=True) for cause in MotorCause if cause}
    sentences |= {Safety(0, cause, 0, 0).fault(armed=True) for cause in (LaserCause.INTERLOCK, LaserCause.LEASE)}
    assert len(sentences) == len(MotorCause) - 1 + 2 and all(sentences)
    assert not any("cause" in (sentence or "") for sentence in sentences)
    # All is well: armed, or off because nobody wanted light.
    assert Safety.of(0x0000_0032).fault(armed=True) is None
    assert Safety(0, LaserCause.INTERLOCK, 0, 0).fault(armed=False) is None
