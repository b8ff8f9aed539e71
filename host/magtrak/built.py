"""What a card is built with, and settings that need more than that."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .errors import SettingsError
from .protocol import FEATURES, Detector, MotorMode, RowForm, register

_NEEDS = {
    # register: what it needs, the greatest value without, what people call the setting, what to do
    "isolate": ("isolate", 0, "runs.neighbours", "set it to 0"),
    "centroid_window": ("window", 0, "peak.window", "set it to 0, the whole run"),
    "motor_mode": ("speed_loop", int(MotorMode.DUTY), "motor.mode", "use duty"),
    "motor_watch": ("speed_loop", 0, "motor.watch", "leave it out"),
    "laser_conditions": ("speed_loop", 0, "laser.needs_speed or laser.sector_deg", "leave it out"),
    "snapshot": ("snapshot", 0, "a snapshot", "use another bitstream"),
    "ambient_mode": ("background", 0, "ambient.mode", "set it to off"),
    "detector": ("runs", int(Detector.BINARY), "peak.detector", "set it to binary, as the settings 'paper' have it"),
}
_NAMES = {
    "isolate": "filter of isolated pixels",
    "window": "windowed centroid",
    "speed_loop": "speed loop",
    "snapshot": "snapshots",
    "background": "subtraction of ambient light",
    "runs": "measurement of grey values",
    "edge_log": "log of encoder edges",
    "full_rows": "full form of rows",
    "turn_check": "check of every turn",
    "pwm_period": "setting of the PWM's period",
    "notes": "exposure and time offset in frames",
}
assert set(FEATURES) < set(_NAMES)

_FIXED = {
    # register: what it needs, its value without, what people call the setting
    "floor": ("runs", 255, "weight.floor"),  # no mix exceeds it
    "form": ("full_rows", int(RowForm.COMPACT), "form"),
    "counts_per_turn": ("turn_check", 0, "encoder.counts_per_turn"),
    "motor_period": ("pwm_period", register("motor_period").init, "motor.pwm_hz"),
    "exposure_us": ("notes", 0, "camera.exposure_s"),
    "time_offset_ns": ("notes", 0, "camera.time_offset_s"),
}


@dataclass(frozen=True)
class Built:
    """What a card has of the parts that it may be built without.

    Parameters
    ----------
    features : the register of that name
    background_cells : blocks of pixels that the background may have
    """

    features: int
    background_cells: int

    def has(self, feature: str) -> bool:
        """Whether the card is built with a feature of the protocol, or with "background"."""
        return (
            self.background_cells > 0 if feature == "background" else bool(self.features >> FEATURES.index(feature) & 1)
        )

    def __str__(self) -> str:
        """The parts that it has, and those that it has not."""
        has = [name for feature, name in _NAMES.items() if self.has(feature)]
        lacks = [name for feature, name in _NAMES.items() if not self.has(feature)]
        parts = [", ".join(has)] if has else []
        return "; ".join([*parts, *(["without " + ", ".join(lacks)] if lacks else [])])

    def check(self, values: Sequence[tuple[str, Sequence[int]]]) -> None:
        """:exc:`SettingsError` where one of the registers and words needs what is not built."""
        for name, words in values:
            if name in _NEEDS:
                feature, greatest, setting, instead = _NEEDS[name]
                if words[0] > greatest and not self.has(feature):
                    raise SettingsError(
                        f"{setting} needs the {_NAMES[feature]}, which this card is built without: {instead}"
                    )
            if name in _FIXED:
                feature, value, setting = _FIXED[name]
                if words[0] != value and not self.has(feature):
                    raise SettingsError(
                        f"{setting} needs the {_NAMES[feature]}, which this card is built without: leave it out"
                    )

    def fitted(self, values: Mapping[str, int]) -> dict[str, int]:
        """The registers, without what changes no position and is not built: the window of another detector, the floor
        where no grey values are measured, the check of every turn, the PWM's period, the exposure that frames tell.
        """
        fitted = dict(values)
        if not self.has("window") and values["detector"] != Detector.CENTROID:
            fitted["centroid_window"] = 0
        for name, (feature, value, _) in _FIXED.items():
            if name in fitted and name != "time_offset_ns" and not self.has(feature):
                fitted[name] = value
        return fitted
