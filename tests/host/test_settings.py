"""Settings to registers and gate tables."""

import colorsys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magtrak import protocol
from magtrak.errors import SettingsError
from magtrak.gate import hue_table, range_table
from magtrak.settings import Settings
from magtrak.settings_file import PRESETS, load_settings, parse_settings


def entries(words) -> list[int]:
    return [word * 32 + bit for word in range(8) for bit in range(32) if words[word] >> bit & 1]


def test_hue_tables_by_hand() -> None:
    assert entries(hue_table(90, 180)) == list(range(64, 129))
    assert entries(hue_table(350, 10)) == [*range(8), *range(249, 256)]
    assert entries(hue_table(0, 360)) == list(range(256))
    assert entries(hue_table(120, 120)) == [85]
    assert entries(hue_table(0.5, 0)) == list(range(256))
    assert hue_table(0, 0) == [1, 0, 0, 0, 0, 0, 0, 0]


def test_range_tables_by_hand() -> None:
    assert entries(range_table(0, 1)) == list(range(256))
    assert entries(range_table(0.2, 0.4)) == list(range(51, 103))
    assert range_table(1, 1) == [0] * 7 + [1 << 31]


@given(st.floats(0, 360), st.floats(0, 360), st.floats(0, 1, exclude_max=True))
def test_a_hue_within_passes_and_one_well_outside_does_not(first: float, last: float, hue: float) -> None:
    """Whatever the rounding: the middle of a hue byte may be off by half a byte, 0.7 degrees."""
    passes = round(256 * hue) % 256 in entries(hue_table(first, last))
    degrees = hue * 360
    inside = first <= degrees <= last if first <= last else degrees >= first or degrees <= last
    slack = min(abs((degrees - end + 180) % 360 - 180) for end in (first, last))
    assert passes == inside or slack < 1.5


@pytest.mark.parametrize("name", PRESETS)
def test_presets_fit_the_card_and_pass_their_laser(name: str) -> None:
    settings = load_settings(name)
    settings.register_values(50e6)
    tables = dict(settings.tables())
    assert set(tables) == {"lut_hue", "lut_luminance", "lut_saturation"}
    laser = (255, 40, 30) if name.startswith("red") else (40, 255, 30)
    other = (40, 255, 30) if name.startswith("red") else (255, 40, 30)

    def passes(rgb: tuple[int, int, int]) -> bool:
        h, lum, s = colorsys.rgb_to_hls(*(c / 255 for c in rgb))
        values = zip(("lut_hue", "lut_luminance", "lut_saturation"), (256 * h, 255 * lum, 255 * s), strict=True)
        return all(round(value) % 256 in entries(tables[table]) for table, value in values)

    assert passes(laser)
    assert not passes(other)
    assert not passes((20, 20, 20))


def test_green_is_what_the_classes_say_by_default() -> None:
    assert load_settings("green") == Settings()


def test_the_paper_uses_its_own_detector() -> None:
    values = dict(load_settings("paper").register_values(50e6))
    assert values["detector"] == [protocol.Detector.BINARY]


def test_gates_of_several_ranges() -> None:
    settings = parse_settings(
        {"gate": {"hue": [[350, 10], [90, 180]], "luminance": [[0, 0.2], [0.4, 1]], "saturation": [0.5, 1]}}
    )
    tables = {name: entries(words) for name, words in settings.tables()}
    assert tables["lut_hue"] == [*range(8), *range(64, 129), *range(249, 256)]
    assert tables["lut_luminance"] == [*range(52), *range(102, 256)]
    assert tables["lut_saturation"] == list(range(128, 256))


def test_ambient_light() -> None:
    registers = dict(parse_settings({"ambient": {"mode": "skip", "measured": 7}}).register_values(50e6))
    assert (registers["ambient_mode"], registers["ambient_measured"]) == ([protocol.AmbientMode.SKIP], [7])
    assert load_settings("red-ambient").ambient.mode == "skip"
    assert load_settings("red").ambient.mode == "off"


def test_values_in_units_of_the_card() -> None:
    values = parse_settings(
        {
            "weight": {"mix": [-0.5, 1.0, -0.5], "floor": 33},
            "camera": {"exposure_s": 0.01, "time_offset_s": -0.0055},
            "peak": {"ambiguous_ratio": 1.0},
            "motor": {"duty": -1.0, "pwm_hz": 20_000},
            "laser": {"lease_s": 0.5, "delay_s": 0.0},
        }
    )
    registers = {name: words[0] for name, words in values.register_values(50e6)}
    assert [registers[f"weight_{c}"] for c in "rgb"] == [-128, 256, -128]
    assert (registers["floor"], registers["exposure_us"], registers["time_offset_ns"]) == (33, 10_000, -5_500_000)
    assert (registers["ambiguous_ratio"], registers["motor_period"]) == (255, 2500)
    assert (registers["laser_lease_ms"], registers["laser_delay_ms"]) == (500, 0)
    assert values.motor.duty_word() == -32767
    # Nothing starts to move or shine by this.
    assert (registers["motor_duty"], registers["run"]) == (0, 0)
    assert "laser_arm" not in registers


def test_every_setting_of_the_measurement_is_written() -> None:
    """What is left out would stay as the program before left it."""
    written = {name for name, _ in [*Settings().register_values(50e6), *Settings().tables()]}
    frame = {r.name for r in protocol.REGISTERS if r.scope is protocol.Scope.FRAME}
    assert frame <= written


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"gait": {}}, r"gait is not known; known here: gate, weight"),
    ({"gate": {"hew": [0, 1]}}, r"gate\.hew is not known; known here: hue, luminance, saturation"),
    ({"gate": {"hue": [0, 400]}}, r"gate\.hue is \[0, 400\]; it must be two numbers from 0 to 360"),
    ({"gate": {"hue": 90}}, r"gate\.hue is 90"),
    ({"gate": {"luminance": [0.5, 0.1]}}, r"gate\.luminance is \[0\.5, 0\.1\]; .* the smaller first"),
    ({"gate": {"saturation": [0, "x"]}}, r"gate\.saturation"),
    ({"gate": 3}, r"gate must be a table"),
    ({"gate": {"hue": []}}, r"gate\.hue is \[\]; it must be two numbers"),
    ({"gate": {"hue": [[0, 9], [400, 1]]}}, r"gate\.hue is \[400, 1\]; it must be two numbers from 0 to 360"),
    ({"gate": {"hue": [[0, 9], 5]}}, r"gate\.hue is \[\[0, 9\], 5\]; .*, or a list of such ranges"),
    ({"gate": {"saturation": [[0, 1], [1, 0]]}}, r"gate\.saturation is .* the smaller first, or a list"),
    ({"ambient": {"mode": "on"}}, r"ambient\.mode is 'on'; it must be 'off' or 'alternate' or 'skip'"),
    ({"ambient": {"measured": 0}}, r"ambient\.measured is 0; it must be a whole number from 1 to 255"),
    ({"weight": {"mix": [1, 1]}}, r"weight\.mix is \[1, 1\]; it must be finite numbers, a list of 3"),
    ({"weight": {"mix": [3, 0, 0]}}, r"weight\.mix is \[3, 0, 0\]; it must be three numbers from -2"),
    ({"weight": {"floor": -1}}, r"weight\.floor is -1; it must be a whole number from 0 to 255"),
    ({"runs": {"reach": 16}}, r"runs\.reach is 16; it must be a whole number from 0 to 15"),
    ({"runs": {"min_width": 9, "max_width": 3}}, r"runs\.max_width is 3; it must be at least min_width, 9"),
    ({"region": {"first_row": 9, "last_row": 3}}, r"region\.last_row is 3"),
    ({"region": {"first_column": 9, "last_column": 3}}, r"region\.last_column is 3"),
    ({"camera": {"exposure_s": -1}}, r"camera\.exposure_s is -1"),
    ({"peak": {"detector": "canny"}}, r"peak\.detector is 'canny'; it must be 'binary' or 'fir' or"),
    ({"peak": {"choice": 1}}, r"peak\.choice is 1"),
    ({"motor": {"duty": 2}}, r"motor\.duty is 2; it must be a number from -1 to 1"),
    ({"laser": {"arm": "yes"}}, r"laser\.arm is 'yes'; it must be true or false"),
    ({"encoder": {"counts_per_turn": 2.5}}, r"encoder\.counts_per_turn is 2\.5"),
]


@pytest.mark.parametrize(("values", "message"), WRONG, ids=[str(n) for n in range(len(WRONG))])
def test_every_wrong_setting_is_named(values: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=rf"^a\.toml: {message}"):
        parse_settings(values, "a.toml")


def test_what_no_register_holds_is_said() -> None:
    with pytest.raises(SettingsError, match=r"register motor_period takes 16 to 65535, not 10"):
        parse_settings({"motor": {"pwm_hz": 1e6}}).register_values(10e6)


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[weight]\nfloor = 40\n")
    assert load_settings(str(path)).weight.floor == 40
    path.write_text("[weight\n")
    with pytest.raises(SettingsError, match=r"mine\.toml are no TOML"):
        load_settings(str(path))
    with pytest.raises(SettingsError, match=r"none\.toml do not exist: check the path"):
        load_settings(str(tmp_path / "none.toml"))
    with pytest.raises(SettingsError, match=r"'blue' are not known: use green, red, .* or a file NAME\.toml"):
        load_settings("blue")


def test_presets_on_disk_are_those_named() -> None:
    folder = Path(__file__).parents[2] / "host" / "magtrak" / "presets"
    assert {path.stem for path in folder.iterdir()} == set(PRESETS)
    for path in folder.iterdir():
        tomllib.loads(path.read_text())
