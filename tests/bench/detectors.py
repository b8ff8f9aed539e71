"""Every detector of the card on synthetic rows, beside the Cramer-Rao bound and what others do in software.

The rows: :mod:`tests.bench._rows`; the peers: :mod:`tests.bench._peers`. The card is the compiled gateware: each image
has 1024 rows of 96 columns, and positions come from its frame packets. One set of settings for all rows, and another
for those over-exposed:

- the gate is that of the preset ``red``, on for every row;
- the weight is the red channel; in over-exposed rows (R + G + B) / 3;
- the floor is the background and a tenth of the amplitude of the line at 1x, both as the weight sees them: 38 and 29;
- the base of windowed centroids is 2/16 of the peak, as after reset; in over-exposed rows 1/16;
- everything else is as after reset.

Errors are RMS in px over all rows, with the bias behind; rows without a result are counted (``-n``).
``python -m tests.bench.detectors`` prints the table alone, in Markdown.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isnan

import numpy as np
from numpy.typing import NDArray

from magtrak.protocol import Detector, Window
from magtrak.reference import luts_from_words
from magtrak.settings_file import load_settings
from tests.bench import Figure
from tests.bench._peers import PEERS
from tests.bench._rows import AMPLITUDE, BACKGROUND, CONDITIONS, RESPONSE, Condition, bound, make_rows
from tests.support.measured import MeasuringCard
from tests.support.vision import default_settings

ROWS = 1024
SEED = 1
LOST_SHARE = 0.001  # a detector that loses more rows than this is no candidate for the best

RED = {"weight_r": 256, "weight_g": 0, "weight_b": 0, "centroid_base": 2}
MEAN = {"weight_r": 85, "weight_g": 86, "weight_b": 85, "centroid_base": 1}
DETECTORS = {
    "fir": {"detector": Detector.FIR},
    "centroid 7": {"detector": Detector.CENTROID, "centroid_window": Window.HALF_7},
    "centroid 15": {"detector": Detector.CENTROID, "centroid_window": Window.HALF_15},
    "centroid 31": {"detector": Detector.CENTROID, "centroid_window": Window.HALF_31},
    "centroid run": {"detector": Detector.CENTROID, "centroid_window": Window.RUN},
    "binary": {"detector": Detector.BINARY},
    "maximum": {"detector": Detector.MAXIMUM},
}


@dataclass(frozen=True)
class Error:
    """RMS and mean of the errors in px, and how many rows gave no result."""

    rms: float
    bias: float
    lost: int

    @classmethod
    def of(cls, found: NDArray[np.float64], true: NDArray[np.float64]) -> "Error":
        errors = (found - true)[~np.isnan(found)]
        if not errors.size:
            return cls(float("inf"), float("nan"), len(true))
        return cls(float(np.sqrt(np.mean(errors**2))), float(errors.mean()), len(true) - errors.size)

    @property
    def ranked(self) -> float:
        """RMS, or infinity where too many rows are lost."""
        return self.rms if self.lost <= LOST_SHARE * ROWS else float("inf")

    def __str__(self) -> str:
        return f"{self.rms:.4f} {self.bias:+.4f}" + (f" -{self.lost}" if self.lost else "")


HEAD = f"""\
  RMS error and bias in px over {ROWS} rows each, -n: rows without a result. Red laser, amplitude {AMPLITUDE:g} in R,
  {RESPONSE[1]:g} and {RESPONSE[2]:g} of it in G and B, background {BACKGROUND:g}, places uniform. Colour gate on.
  Weight R, base 2/16; over-exposed: (R + G + B) / 3, base 1/16. Floor: background and a tenth of the amplitude.
  Bound: Cramer-Rao, of R alone."""

Row = tuple[Condition, dict[str, Error], dict[str, Error]]


def settings(condition: Condition, detector: str) -> dict[str, int]:
    chosen = MEAN if condition.exposure > 1 else RED
    weight = [chosen[f"weight_{channel}"] for channel in "rgb"]
    floor = (BACKGROUND * sum(weight) + 0.1 * AMPLITUDE * float(np.dot(weight, RESPONSE))) / 256
    return default_settings(
        **chosen,
        floor=round(floor),
        **{name: int(value) for name, value in DETECTORS[detector].items()},
    )


def red_gate() -> NDArray[np.bool_]:
    return luts_from_words([words for _, words in load_settings("red").tables()])


def measure_all() -> Iterator[Row]:
    """Errors of the card's detectors and of the peers, for each condition."""
    gate = red_gate()
    with MeasuringCard() as card:
        for condition in CONDITIONS:
            pixels, true = make_rows(condition, ROWS, SEED)
            ours = {}
            for name in DETECTORS:
                card.configure(settings(condition, name), gate)
                rows = card.measure(pixels).rows
                ours[name] = Error.of(np.where(rows.valid, rows.column_px, np.nan), true)
            yield condition, ours, {name: Error.of(peer(pixels), true) for name, peer in PEERS.items()}


def table_line(row: Row) -> str:
    condition, ours, theirs = row
    limit = bound(condition)
    first = "" if isnan(limit) else f"{limit:.4f}"
    return " | ".join((f"| {condition}", first, *map(str, (ours | theirs).values()))) + " |"


def table_head() -> str:
    names = ("row", "bound", *DETECTORS, *PEERS)
    return f"| {' | '.join(names)} |\n|{'---|' * len(names)}"


def run() -> Iterator[Figure]:
    print(HEAD)
    print(table_head())
    rows = []
    for row in measure_all():
        print(table_line(row), flush=True)
        rows.append(row)
    yield from criteria(rows)


def criteria(rows: list[Row]) -> Iterator[Figure]:
    """What has to hold."""
    for condition, ours, theirs in rows:
        limit = bound(condition)
        if condition.exposure > 1:
            yield from _at_most(condition, ours, ("fir", "centroid 7"), 0.05)
        elif condition.speckle:
            continue
        elif condition.noise == 2 and condition.sigma == 1.5:
            yield from _at_most(condition, ours, ("fir", "centroid 7"), 0.035 if condition.rgb565 else 0.025)
        elif condition.noise == 5 and condition.sigma >= 1.5 and not condition.rgb565:
            for name, factor in (("fir", 1.2), ("centroid 7", 1.3)):
                value = ours[name].ranked
                goal = f"at most {factor} times"
                yield Figure(f"{name}: {condition}", value, "px", "bound", limit, goal, value <= factor * limit)
        best, value = _best(ours)
        peer, other = _best(theirs)
        yield Figure(f"{best}: {condition}", value, "px", peer, other, "at most 1.02 times", value <= 1.02 * other)


def _best(errors: dict[str, Error]) -> tuple[str, float]:
    name = min(errors, key=lambda name: errors[name].ranked)
    return name, errors[name].ranked


def _at_most(condition: Condition, ours: dict[str, Error], names: tuple[str, ...], limit: float) -> Iterator[Figure]:
    for name in names:
        value = ours[name].ranked
        yield Figure(f"{name}: {condition}", value, "px", goal=f"at most {limit}", met=value <= limit)


if __name__ == "__main__":
    print(table_head())
    for line in measure_all():
        print(table_line(line), flush=True)
