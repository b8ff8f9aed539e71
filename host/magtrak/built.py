"""What a card is built with, and settings that need more than that."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .errors import SettingsError
from .protocol import FEATURES, Detector, MotorMode, register

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
}
assert set(FEATURES) < set(_NAMES)

FLOOR_WITHOUT_RUNS = register("floor").range[1]
"""What the floor has to be where no grey values are measured: no mix exceeds it."""


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
            if name == "floor" and words[0] != FLOOR_WITHOUT_RUNS and not self.has("runs"):
                raise SettingsError(
                    f"weight.floor needs the {_NAMES['runs']}, which this card is built without: leave it out"
                )

    def fitted(self, values: Mapping[str, int]) -> dict[str, int]:
        """The registers, without what would not be used and is not built: the window of another detector, and the floor
        where no grey values are measured.
        """
        fitted = dict(values)
        if not self.has("window") and values["detector"] != Detector.CENTROID:
            fitted["centroid_window"] = 0
        if not self.has("runs"):
            fitted["floor"] = FLOOR_WITHOUT_RUNS
        return fitted
