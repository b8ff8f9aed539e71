"""Settings: what the card is told, as people write it (TOML) and as registers have it.

A file has the tables and names of the classes below; what it leaves out keeps its default. Ready-made files lie in
``presets``.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from .checked import Checked
from .errors import SettingsError
from .gate import hue_table, range_table
from .protocol import Choice, Detector, register

DETECTORS = ("binary", "centroid", "fir", "maximum")
CHOICES = ("strongest", "first", "last", "widest", "nearest")
PRESETS = ("green", "red", "green-daylight", "red-daylight", "paper")

Values = list[tuple[str, Sequence[int]]]


@dataclass(frozen=True)
class Gate:
    """Colours that can be the laser's: hue in degrees, from the first to the second, through 360 if need be;
    luminance and saturation 0 to 1.
    """

    hue: tuple[float, float] = (90.0, 160.0)
    luminance: tuple[float, float] = (0.08, 1.0)
    saturation: tuple[float, float] = (0.25, 1.0)


@dataclass(frozen=True)
class Weight:
    """The grey value that is measured: a signed mix of R, G and B, less a floor in grey levels."""

    mix: tuple[float, float, float] = (85 / 256, 86 / 256, 85 / 256)
    floor: int = 20


@dataclass(frozen=True)
class Runs:
    """Which stretches of a row can be the line: gated pixels needed, how far off they may lie, widths, gaps; in px."""

    min_gated: int = 1
    reach: int = 8
    min_width: int = 1
    max_width: int = 4095
    bridge: int = 0


@dataclass(frozen=True)
class Region:
    """Region of interest: first and last column and row, px."""

    first_column: int = 0
    last_column: int = 4095
    first_row: int = 0
    last_row: int = 4095


@dataclass(frozen=True)
class Camera:
    """Exposure and time offset, in s. The offset is added to the calibration's."""

    exposure_s: float = 0.0
    time_offset_s: float = 0.0


@dataclass(frozen=True)
class Peak:
    """How a run is measured, which run of a row counts, and from which part of its sum on a runner-up makes the row
    ambiguous.
    """

    detector: str = "fir"
    choice: str = "strongest"
    ambiguous_ratio: float = 0.5


@dataclass(frozen=True)
class Motor:
    """PWM duty with sign, -1 to 1, and frequency of the PWM in Hz."""

    duty: float = 0.25
    pwm_hz: float = 25_000.0

    def duty_word(self) -> int:
        """Value of ``motor_duty``."""
        return round(self.duty * 32767)


@dataclass(frozen=True)
class LaserSwitch:
    """Whether to arm the laser, how long it stays on without a word from the host, delay before emission, in s."""

    arm: bool = True
    lease_s: float = 1.0
    delay_s: float = 0.1


@dataclass(frozen=True)
class Encoder:
    """Counts of a turn (0: as the calibration has it), filter in clocks of the card, wiring."""

    counts_per_turn: int = 0
    filter_clocks: int = 3
    swap: bool = False
    index_invert: bool = False


@dataclass(frozen=True)
class Settings:
    """All of it."""

    gate: Gate = field(default_factory=Gate)
    weight: Weight = field(default_factory=Weight)
    runs: Runs = field(default_factory=Runs)
    region: Region = field(default_factory=Region)
    camera: Camera = field(default_factory=Camera)
    peak: Peak = field(default_factory=Peak)
    motor: Motor = field(default_factory=Motor)
    laser: LaserSwitch = field(default_factory=LaserSwitch)
    encoder: Encoder = field(default_factory=Encoder)

    @classmethod
    def parse(cls, values: object, where: str = "settings") -> "Settings":
        """From parsed TOML; :exc:`SettingsError` names file, field, value and what was expected."""
        top = Checked(where, values, SettingsError)
        top.only(_SECTIONS)
        return cls(**{name: read(top.section(name, required=False)) for name, read in _SECTIONS.items()})

    @classmethod
    def load(cls, name: str) -> "Settings":
        """Ready-made ones by name, or from a file, whose name ends in ``.toml``."""
        if name in PRESETS:
            text = resources.files(__package__).joinpath("presets", f"{name}.toml").read_text(encoding="utf-8")
        elif not name.endswith(".toml"):
            raise SettingsError(f"settings {name!r} are not known: use {', '.join(PRESETS)} or a file NAME.toml")
        else:
            try:
                text = Path(name).read_text(encoding="utf-8")
            except FileNotFoundError:
                raise SettingsError(f"settings {name} do not exist: check the path") from None
            except (OSError, UnicodeDecodeError) as error:
                raise SettingsError(f"settings {name} cannot be read: {error}") from None
        try:
            values = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise SettingsError(f"settings {name} are no TOML: {error}") from None
        return cls.parse(values, name)

    def register_values(self, clock_hz: float) -> Values:
        """Registers to write, in order, for a card with that clock; neither laser, motor, nor ``run`` are switched on.

        Raises
        ------
        SettingsError
            The card does not have a detector or choice, or a register cannot hold a value.
        """
        red, green, blue = (round(256 * part) for part in self.weight.mix)
        values = {
            "run": 0,
            "motor_duty": 0,
            "weight_r": red,
            "weight_g": green,
            "weight_b": blue,
            "floor": self.weight.floor,
            "run_gated": self.runs.min_gated,
            "run_reach": self.runs.reach,
            "run_bridge": self.runs.bridge,
            "run_width_min": self.runs.min_width,
            "run_width_max": self.runs.max_width,
            "column_first": self.region.first_column,
            "column_last": self.region.last_column,
            "row_first": self.region.first_row,
            "row_last": self.region.last_row,
            "detector": _of_card(Detector, "peak.detector", self.peak.detector),
            "choice": _of_card(Choice, "peak.choice", self.peak.choice),
            "ambiguous_ratio": min(round(256 * self.peak.ambiguous_ratio), 255),
            "exposure_us": round(1e6 * self.camera.exposure_s),
            "time_offset_ns": round(1e9 * self.camera.time_offset_s),
            "encoder_filter": self.encoder.filter_clocks,
            "encoder_swap": int(self.encoder.swap),
            "index_invert": int(self.encoder.index_invert),
            "counts_per_turn": self.encoder.counts_per_turn,
            "motor_period": round(clock_hz / self.motor.pwm_hz),
            "laser_lease_ms": round(1e3 * self.laser.lease_s),
            "laser_delay_ms": round(1e3 * self.laser.delay_s),
        }
        for name, value in values.items():
            try:
                register(name).encode(value)
            except ValueError as error:
                raise SettingsError(f"settings do not fit this card: {error}") from None
        return [(name, [value]) for name, value in values.items()]

    def tables(self) -> Values:
        """Words of the three gate tables."""
        return [
            ("lut_hue", hue_table(*self.gate.hue)),
            ("lut_luminance", range_table(*self.gate.luminance)),
            ("lut_saturation", range_table(*self.gate.saturation)),
        ]


def _of_card(known: type[Detector] | type[Choice], name: str, value: str) -> int:
    try:
        return int(known[value.upper()])
    except KeyError:
        has = " or ".join(repr(member.name.lower()) for member in known)
        raise SettingsError(f"{name} is {value!r}, which this version of the card does not have; use {has}") from None


def _gate(table: Checked) -> Gate:
    table.only(("hue", "luminance", "saturation"))
    gate = Gate(
        table.span("hue", 0, 360, Gate.hue),
        table.span("luminance", 0, 1, Gate.luminance),
        table.span("saturation", 0, 1, Gate.saturation),
    )
    for name in ("luminance", "saturation"):
        low, high = getattr(gate, name)
        if low > high:
            table.refuse(name, "two numbers from 0 to 1, the smaller first")
    return gate


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
    limits = {"min_gated": 4095, "reach": 15, "min_width": 4095, "max_width": 4095, "bridge": 15}
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
    table.only(("detector", "choice", "ambiguous_ratio"))
    return Peak(
        table.choice("detector", DETECTORS, Peak.detector),
        table.choice("choice", CHOICES, Peak.choice),
        table.number("ambiguous_ratio", 0, 1, Peak.ambiguous_ratio),
    )


def _motor(table: Checked) -> Motor:
    table.only(("duty", "pwm_hz"))
    return Motor(table.number("duty", -1, 1, Motor.duty), table.number("pwm_hz", 100, 1e6, Motor.pwm_hz))


def _laser(table: Checked) -> LaserSwitch:
    table.only(("arm", "lease_s", "delay_s"))
    return LaserSwitch(
        table.boolean("arm", LaserSwitch.arm),
        table.number("lease_s", 0.01, 65.0, LaserSwitch.lease_s),
        table.number("delay_s", 0, 65.0, LaserSwitch.delay_s),
    )


def _encoder(table: Checked) -> Encoder:
    table.only(("counts_per_turn", "filter_clocks", "swap", "index_invert"))
    return Encoder(
        table.integer("counts_per_turn", 0, 2**24 - 1, Encoder.counts_per_turn),
        table.integer("filter_clocks", 0, 255, Encoder.filter_clocks),
        table.boolean("swap", Encoder.swap),
        table.boolean("index_invert", Encoder.index_invert),
    )


_SECTIONS: dict[str, Any] = {
    "gate": _gate,
    "weight": _weight,
    "runs": _runs,
    "region": _region,
    "camera": _camera,
    "peak": _peak,
    "motor": _motor,
    "laser": _laser,
    "encoder": _encoder,
}
