"""Single registers and settings by name."""

import pytest

from magtrak import protocol
from magtrak.adjust import needs_commit, parse_assignment
from magtrak.errors import SettingsError
from magtrak.gate import hue_table


def parsed(text: str, turn: int = 8192) -> list[tuple[str, list[int]]]:
    return [(name, list(words)) for name, words in parse_assignment(text, 50e6, turn)]


def test_registers() -> None:
    assert parsed("floor=33") == [("floor", [33])]
    assert parsed(" weight_g = -0x10 ") == [("weight_g", [-16])]
    assert parsed("laser_arm=0x1A5E") == [("laser_arm", [protocol.LASER_KEY])]
    assert needs_commit([("floor", [1])]) and not needs_commit([("run", [1])])


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("weight.floor=20", [("floor", [20])]),  # its default, too
        ("weight.floor=21", [("floor", [21])]),
        ("weight.mix=[1, 0, -0.5]", [("weight_r", [256]), ("weight_g", [0]), ("weight_b", [-128])]),
        ("peak.detector=binary", [("detector", [protocol.Detector.BINARY])]),
        ("peak.detector='fir'", [("detector", [protocol.Detector.FIR])]),
        ("region.last_row=99", [("row_last", [99])]),
        ("camera.exposure_s=0.01", [("exposure_us", [10_000])]),
        ("gate.hue=[10, 40]", [("lut_hue", list(hue_table(10, 40)))]),
        ("encoder.swap=true", [("encoder_swap", [1])]),
    ],
)
def test_settings_move_their_registers_and_no_others(text: str, values: list[tuple[str, list[int]]]) -> None:
    assert parsed(text) == values


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("floor", "'floor' is no NAME=VALUE"),
        ("=3", "is no NAME=VALUE"),
        ("floor=256", "floor is '256'; it must be a whole number from 0 to 255"),
        ("floor=x", "floor is 'x'; it must be a whole number from 0 to 255"),
        ("flor=3", "no register is called 'flor'"),
        ("frames=3", "register frames can only be read"),
        ("lut_hue=3", "is a table: use the setting gate.hue"),
        ("weight.flor=3", "weight.flor is not known; known here: mix, floor"),
        ("weight.floor=300", "weight.floor is 300; it must be a whole number from 0 to 255"),
        ("peak.detector=fair", "peak.detector is 'fair'"),
        ("motor.kp=3", "use a settings file"),
        ("runs.min_gated=[", "runs.min_gated is"),
    ],
)
def test_what_cannot_be_set(text: str, message: str) -> None:
    with pytest.raises(SettingsError) as caught:
        parsed(text)
    assert message in str(caught.value)
