"""Settings files (TOML), and the ready-made ones in ``presets``.

A file has a table for each class of :mod:`magtrak.settings`, with the names of its fields; what it leaves out keeps its
default. Every value is checked, and a name that means nothing is an error: it is most likely mistyped.
"""

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from .checked import Checked
from .errors import SettingsError
from .gate import Spans
from .motor import BRIDGES, FAULTS, MODES, POLICIES, Motor
from .protocol import Choice, Detector
from .settings import WINDOWS, Ambient, Camera, Encoder, Gate, LaserSwitch, Peak, Region, Runs, Settings, Weight

PRESETS = ("green", "red", "green-daylight", "red-daylight", "green-ambient", "red-ambient", "paper")

DETECTORS = tuple(detector.name.lower() for detector in Detector)
CHOICES = tuple(choice.name.lower() for choice in Choice)
AMBIENT = ("off", "alternate", "skip")


def parse_settings(values: object, where: str = "settings") -> Settings:
    """From parsed TOML; :exc:`SettingsError` names file, field, value and what was expected."""
    top = Checked(where, values, SettingsError)
    top.only(_SECTIONS)
    return Settings(**{name: read(top.section(name, required=False)) for name, read in _SECTIONS.items()})


def settings_text(name: str) -> str:
    """The TOML of ready-made settings by name, or of a file, whose name ends in ``.toml``."""
    if name in PRESETS:
        return resources.files(__package__).joinpath("presets", f"{name}.toml").read_text(encoding="utf-8")
    if not name.endswith(".toml"):
        raise SettingsError(f"settings {name!r} are not known: use {', '.join(PRESETS)} or a file NAME.toml")
    try:
        return Path(name).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise SettingsError(f"settings {name} do not exist: check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"settings {name} cannot be read: {error}") from None


def load_settings(name: str) -> Settings:
    """Ready-made ones by name, or from a file."""
    return parse_settings(load_values(name), name)


def load_values(name: str) -> dict[str, Any]:
    """Likewise, as the file has them: unchecked, and without what it leaves out."""
    try:
        return tomllib.loads(settings_text(name))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise SettingsError(f"settings {name} are no TOML: {error}") from None


def _gate(table: Checked) -> Gate:
    table.only(("hue", "luminance", "saturation"))
    gate = Gate(
        _spans(table, "hue", 360, Gate.hue),
        _spans(table, "luminance", 1, Gate.luminance),
        _spans(table, "saturation", 1, Gate.saturation),
    )
    for name in ("luminance", "saturation"):
        if any(low > high for low, high in getattr(gate, name)):
            table.refuse(name, "two numbers from 0 to 1, the smaller first, or a list of such ranges")
    return gate


def _spans(table: Checked, name: str, high: float, default: Spans) -> Spans:
    """One range, or a list of them."""
    if name not in table.values:
        return default
    value = table.values[name]
    if not isinstance(value, list) or not value or not isinstance(value[0], list):
        return (table.span(name, 0, high),)
    for pair in value:
        if not isinstance(pair, list) or len(pair) != 2:
            table.refuse(name, f"two numbers from 0 to {high:g}, or a list of such ranges")
    return tuple(Checked(table.where, {name: pair}, table.error, table.path).span(name, 0, high) for pair in value)


def _weight(table: Checked) -> Weight:
    table.only(("mix", "floor"))
    mix = Weight.mix
    if "mix" in table.values:
        red, green, blue = table.array("mix", (3,)).tolist()
        # A register holds -512 to 511 of 1/256.
        if not all(-2 <= part <= 511 / 256 for part in (red, green, blue)):
            table.refuse("mix", "three numbers from -2 to 1.996, for R, G and B")
        mix = (red, green, blue)
    return Weight(mix, table.integer("floor", 0, 255, Weight.floor))


def _runs(table: Checked) -> Runs:
    limits = {"neighbours": 8, "min_gated": 4095, "reach": 15, "min_width": 4095, "max_width": 4095, "bridge": 15}
    table.only(limits)
    runs = Runs(**{name: table.integer(name, 0, limit, getattr(Runs, name)) for name, limit in limits.items()})
    if runs.max_width < runs.min_width:
        table.refuse("max_width", f"at least min_width, {runs.min_width}")
    return runs


def _region(table: Checked) -> Region:
    names = ("first_column", "last_column", "first_row", "last_row")
    table.only(names)
    region = Region(**{name: table.integer(name, 0, 4095, getattr(Region, name)) for name in names})
    if region.last_column < region.first_column:
        table.refuse("last_column", f"at least first_column, {region.first_column}")
    if region.last_row < region.first_row:
        table.refuse("last_row", f"at least first_row, {region.first_row}")
    return region


def _camera(table: Checked) -> Camera:
    table.only(("exposure_s", "time_offset_s"))
    return Camera(table.number("exposure_s", 0, 60, 0.0), table.number("time_offset_s", -1, 1, 0.0))


def _peak(table: Checked) -> Peak:
    table.only(("detector", "window", "base", "choice", "ambiguous_ratio"))
    window = table.integer("window", 0, 31, Peak.window)
    if window not in WINDOWS:
        table.refuse("window", "7, 15 or 31 columns to each side, or 0 for the run")
    return Peak(
        table.choice("detector", DETECTORS, Peak.detector),
        window,
        table.number("base", 0, 0.9375, Peak.base),
        table.choice("choice", CHOICES, Peak.choice),
        table.number("ambiguous_ratio", 0, 1, Peak.ambiguous_ratio),
    )


def _ambient(table: Checked) -> Ambient:
    table.only(("mode", "measured"))
    return Ambient(
        table.choice("mode", AMBIENT, Ambient.mode),
        table.integer("measured", 1, 255, Ambient.measured),
    )


def _motor(table: Checked) -> Motor:
    limits = {
        "duty": (-1.0, 1.0),
        "pwm_hz": (100.0, 1e6),
        "speed_deg_s": (-1e5, 1e5),
        "acceleration_deg_s2": (0.1, 1e6),
        "search_deg": (0.0, 1e5),
        "kp": (0.0, 100.0),
        "ki": (0.0, 1e4),
        "feed_forward": (0.0, 100.0),
        "friction": (0.0, 1.0),
        "duty_max": (0.0, 1.0),
        "speed_band": (0.0, 1.0),
        "stall_s": (0.01, 65.0),
        "runaway_deg": (0.0, 3600.0),
        "speed_max_deg_s": (0.0, 1e6),
    }
    table.only((*limits, "mode", "bridge", "sweep_deg", "watch"))
    values: dict[str, Any] = {
        name: table.number(name, low, high, getattr(Motor, name)) for name, (low, high) in limits.items()
    }
    values["mode"] = table.choice("mode", MODES, Motor.mode)
    values["bridge"] = table.choice("bridge", BRIDGES, Motor.bridge)
    values["sweep_deg"] = _rising(table, "sweep_deg", Motor.sweep_deg)
    if "watch" in table.values:
        watch = table.values["watch"]
        if not isinstance(watch, list) or any(name not in FAULTS for name in watch):
            table.refuse("watch", f"a list of some of {', '.join(map(repr, FAULTS))}")
        values["watch"] = tuple(watch)
    return Motor(**values)


def _rising(table: Checked, name: str, default: tuple[float, float]) -> tuple[float, float]:
    low, high = table.span(name, -1e5, 1e5, default)
    if low >= high:
        table.refuse(name, "two angles, the smaller first")
    return low, high


def _laser(table: Checked) -> LaserSwitch:
    table.only(("arm", "lease_s", "delay_s", "needs_speed", "sector_deg"))
    return LaserSwitch(
        table.boolean("arm", LaserSwitch.arm),
        table.number("lease_s", 0.01, 65.0, LaserSwitch.lease_s),
        table.number("delay_s", 0, 65.0, LaserSwitch.delay_s),
        table.boolean("needs_speed", LaserSwitch.needs_speed),
        _rising(table, "sector_deg", (0.0, 0.0)) if "sector_deg" in table.values else None,
    )


def _encoder(table: Checked) -> Encoder:
    table.only(
        ("counts_per_turn", "filter_clocks", "swap", "index_invert", "index_policy", "tolerance", "index_tolerance")
    )
    return Encoder(
        table.integer("counts_per_turn", 0, 2**24 - 1, Encoder.counts_per_turn),
        table.integer("filter_clocks", 0, 255, Encoder.filter_clocks),
        table.boolean("swap", Encoder.swap),
        table.boolean("index_invert", Encoder.index_invert),
        table.choice("index_policy", POLICIES, Encoder.index_policy),
        table.integer("tolerance", 0, 255, Encoder.tolerance),
        table.integer("index_tolerance", 0, 255, Encoder.index_tolerance),
    )


_SECTIONS: dict[str, Any] = {
    "gate": _gate,
    "weight": _weight,
    "runs": _runs,
    "region": _region,
    "camera": _camera,
    "peak": _peak,
    "ambient": _ambient,
    "motor": _motor,
    "laser": _laser,
    "encoder": _encoder,
}
