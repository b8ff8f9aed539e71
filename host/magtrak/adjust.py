"""Single values for a card that runs: registers by name, and settings by the names of settings files."""

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from .errors import SettingsError
from .protocol import REGISTERS, Access, register
from .settings import Encoder, Settings, Values
from .settings_file import CHOICES, DETECTORS, parse_settings

# Where a setting has its default, what it moves shows only when it is given another value: one of these will do.
_PROBES: tuple[Any, ...] = (
    *(0, 1, 2, 0.5, True, False, [10.0, 20.0], [0.1, 0.9], [1.0, 0.0, 0.0], [-1.5, 1.5, 0.7]),
    *DETECTORS,
    *CHOICES,
)
_SECTIONS = ("gate", "weight", "runs", "region", "camera", "peak", "encoder")


def parse_assignment(text: str, clock_hz: float, counts_per_turn: int) -> Values:
    """Registers and words that ``NAME=VALUE`` means.

    NAME is a register, or a setting as ``weight.floor``; VALUE is a whole number for the one, as in a settings file for
    the other. What a setting needs of others is taken from the defaults and ``counts_per_turn``.

    Raises
    ------
    SettingsError
        There is no such name, or the value will not do.
    """
    name, equals, value = text.partition("=")
    name, value = name.strip(), value.strip()
    if not equals or not name or not value:
        raise SettingsError(f"{text!r} is no NAME=VALUE")
    if "." in name:
        return _setting(name, value, clock_hz, counts_per_turn)
    entry = next((one for one in REGISTERS if one.name == name), None)
    if entry is None:
        raise SettingsError(
            f"no register is called {name!r}; `magtrak get` lists them, settings are written section.name"
        )
    if entry.access is Access.READ:
        raise SettingsError(f"register {name} can only be read")
    if entry.words > 1:
        raise SettingsError(f"register {name} is a table: use the setting gate.{name.removeprefix('lut_')}")
    try:
        number = int(value, 0)
        entry.encode(number)
    except ValueError:
        low, high = entry.range
        raise SettingsError(f"{name} is {value!r}; it must be a whole number from {low} to {high}") from None
    return [(name, [number])]


def _setting(name: str, value: str, clock_hz: float, counts_per_turn: int) -> Values:
    section, _, key = name.partition(".")
    if section not in _SECTIONS:
        raise SettingsError(
            f"{name} cannot be set alone: sections {', '.join(_SECTIONS)} can; for others use a settings file"
        )
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value  # a word without quotes
    wanted = _values(section, key, parsed, clock_hz, counts_per_turn)
    default = _registers({}, section, clock_hz, counts_per_turn)
    moved = {register_name for register_name, words in default.items() if wanted[register_name] != words}
    for probe in _PROBES:
        try:
            other = _values(section, key, probe, clock_hz, counts_per_turn)
        except SettingsError:
            continue
        moved |= {register_name for register_name, words in other.items() if wanted[register_name] != words}
    if not moved:
        raise SettingsError(f"{name} is nothing that a card is told")
    return [(register_name, wanted[register_name]) for register_name in wanted if register_name in moved]


def _values(section: str, key: str, value: Any, clock_hz: float, counts_per_turn: int) -> dict[str, Sequence[int]]:
    return _registers({section: {key: value}}, section, clock_hz, counts_per_turn)


def _registers(values: Any, section: str, clock_hz: float, counts_per_turn: int) -> dict[str, Sequence[int]]:
    settings: Settings = parse_settings(values, "magtrak set")
    if section != "encoder":
        settings = replace(settings, encoder=Encoder(counts_per_turn=counts_per_turn))
    return dict([*settings.register_values(clock_hz), *settings.tables()])


def needs_commit(values: Values) -> bool:
    """Whether some of these registers are settings of the measurement, which wait for a commit."""
    return any(register(name).scope.value == "frame" for name, _ in values)
