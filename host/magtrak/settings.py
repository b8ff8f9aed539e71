"""Settings: what the card is told, in people's units and as registers have it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from .errors import SettingsError
from .gate import Spans, hue_table, range_table, union
from .motor import Motor, policy_word
from .protocol import AmbientMode, Choice, Detector, register

WINDOWS = (0, 7, 15, 31)
"""Columns to each side of a centroid's window, in the order of :class:`~magtrak.protocol.Window`; 0 is the run."""

Values = list[tuple[str, Sequence[int]]]


@dataclass(frozen=True)
class Gate:
    """Colours that can be the laser's, each of the three in one of its ranges: hue in degrees, from the first to the
    second, through 360 if need be; luminance and saturation 0 to 1.
    """

    hue: Spans = ((90.0, 160.0),)
    luminance: Spans = ((0.1, 1.0),)
    saturation: Spans = ((0.25, 1.0),)


@dataclass(frozen=True)
class Weight:
    """The grey value that is measured: a signed mix of R, G and B, less a floor in grey levels."""

    mix: tuple[float, float, float] = (85 / 256, 86 / 256, 85 / 256)
    floor: int = 20


@dataclass(frozen=True)
class Runs:
    """Which stretches of a row can be the line: gated pixels needed, how far off they may lie, widths, gaps; in px.

    ``neighbours``: gated pixels that a gated pixel must have among the 8 around it, not to be left out as isolated.
    """

    neighbours: int = 0
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
    """How the line is measured, which peak of a row counts, and from which part of its strength on a runner-up makes
    the row ambiguous.

    For the centroid: columns to each side of the peak, 7, 15 or 31, or 0 for the whole run; and the part of the run's
    greatest weight by which the base lies above the background at the window's ends.
    """

    detector: str = "fir"
    window: int = 7
    base: float = 0.125
    choice: str = "strongest"
    ambiguous_ratio: float = 0.375


@dataclass(frozen=True)
class Ambient:
    """Whether images without laser are taken and subtracted from the others: "off"; "alternate", where the exposure
    lies in the gap between two images; "skip", which leaves out the images in which the laser is switched, for rolling
    shutters and exposures up to a period. So many images are measured to each background.
    """

    mode: str = "off"
    measured: int = 1


@dataclass(frozen=True)
class LaserSwitch:
    """Whether to arm the laser, how long it stays on without a word from the host, delay before emission, in s;
    where it may shine besides: only with the speed in the motor's band, only in a sector (motor angles, degrees from
    the index; None for all).
    """

    arm: bool = True
    lease_s: float = 1.0
    delay_s: float = 0.1
    needs_speed: bool = False
    sector_deg: tuple[float, float] | None = None

    def registers(self, counts_per_turn: int) -> dict[str, int]:
        """Values of the laser's registers, but for the one that arms it."""
        values = {
            "laser_lease_ms": round(1e3 * self.lease_s),
            "laser_delay_ms": round(1e3 * self.delay_s),
            "laser_conditions": int(self.needs_speed) | int(self.sector_deg is not None) << 1,
        }
        if self.sector_deg is None:
            return values
        if not counts_per_turn:
            raise SettingsError("laser.sector_deg needs encoder.counts_per_turn: give it")
        low, high = (round(angle * counts_per_turn / 360) for angle in self.sector_deg)
        return values | {"sector_low": low, "sector_high": high}


@dataclass(frozen=True)
class Encoder:
    """Counts of a turn (0: as the calibration has it), filter in clocks of the card, wiring, what a pass of the index
    does to the zero ("reset", "latch" or "first"), and what is tolerated before a watched motor is stopped: illegal
    transitions (one is forgotten every 128 ms), and counts by which a turn is off.
    """

    counts_per_turn: int = 0
    filter_clocks: int = 3
    swap: bool = False
    index_invert: bool = False
    index_policy: str = "reset"
    tolerance: int = 8
    index_tolerance: int = 4


@dataclass(frozen=True)
class Settings:
    """All of it."""

    gate: Gate = field(default_factory=Gate)
    weight: Weight = field(default_factory=Weight)
    runs: Runs = field(default_factory=Runs)
    region: Region = field(default_factory=Region)
    camera: Camera = field(default_factory=Camera)
    peak: Peak = field(default_factory=Peak)
    ambient: Ambient = field(default_factory=Ambient)
    motor: Motor = field(default_factory=Motor)
    laser: LaserSwitch = field(default_factory=LaserSwitch)
    encoder: Encoder = field(default_factory=Encoder)

    def register_values(self, clock_hz: float) -> Values:
        """Registers to write, in order, for a card with that clock; neither laser, motor, nor ``run`` are switched on.

        Raises
        ------
        SettingsError
            A register cannot hold a value.
        """
        red, green, blue = (round(256 * part) for part in self.weight.mix)
        values = {
            "run": 0,
            "weight_r": red,
            "weight_g": green,
            "weight_b": blue,
            "floor": self.weight.floor,
            "isolate": self.runs.neighbours,
            "run_gated": self.runs.min_gated,
            "run_reach": self.runs.reach,
            "run_bridge": self.runs.bridge,
            "run_width_min": self.runs.min_width,
            "run_width_max": self.runs.max_width,
            "column_first": self.region.first_column,
            "column_last": self.region.last_column,
            "row_first": self.region.first_row,
            "row_last": self.region.last_row,
            "detector": int(Detector[self.peak.detector.upper()]),
            "centroid_window": WINDOWS.index(self.peak.window),
            "centroid_base": round(16 * self.peak.base),
            "choice": int(Choice[self.peak.choice.upper()]),
            "ambiguous_ratio": min(round(256 * self.peak.ambiguous_ratio), 255),
            "ambient_mode": int(AmbientMode[self.ambient.mode.upper()]),
            "ambient_measured": self.ambient.measured,
            "exposure_us": round(1e6 * self.camera.exposure_s),
            "time_offset_ns": round(1e9 * self.camera.time_offset_s),
            "encoder_filter": self.encoder.filter_clocks,
            "encoder_swap": int(self.encoder.swap),
            "index_invert": int(self.encoder.index_invert),
            "counts_per_turn": self.encoder.counts_per_turn,
            "index_policy": policy_word(self.encoder.index_policy),
            "encoder_tolerance": self.encoder.tolerance,
            "index_tolerance": self.encoder.index_tolerance,
            **self.motor.registers(clock_hz, self.encoder.counts_per_turn),
            **self.laser.registers(self.encoder.counts_per_turn),
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
            ("lut_hue", union(hue_table, self.gate.hue)),
            ("lut_luminance", union(range_table, self.gate.luminance)),
            ("lut_saturation", union(range_table, self.gate.saturation)),
        ]
