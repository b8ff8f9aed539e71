"""Learns where the lines of an encoder really are, from turns at constant speed.

At constant speed every edge would come a count's time after the one before; what it is early or late, the same in every
turn, is the error of its line. Source: self-calibration by time measurement, e.g. X.-D. Lu and D. L. Trumper,
"Self-calibration of on-axis rotary encoders", CIRP Annals 56 (2007).

``python -m magtrak.encoder --port PORT --calibration FILE.json --settings FILE.toml`` turns the motor as the settings
have it (``mode = "speed"``), and writes the table into the calibration, from where every scan takes it.
"""

from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from .arrays import Floats
from .calibration import Calibration
from .edges import Edge, edges_of_frame, wrapped_difference
from .errors import CalibrationError, MagtrakError
from .frames import Frame

MIN_TURNS = 2
MIN_COVERAGE = 0.9
"""Part of the lines that must have been seen; the others are interpolated."""

_DRIFT_ORDER = 5
_SETTLING_S = 1.0


class LineErrors:
    """Gathers the edges of a stream of frames while the motor turns at constant speed.

    The card logs at most 16 edges for a frame, and thins them where more came. Turn so slowly that few are left out:
    ``16 * frame rate`` counts a second.

    Parameters
    ----------
    counts_per_turn : of the encoder
    """

    def __init__(self, counts_per_turn: int) -> None:
        self.counts_per_turn = counts_per_turn
        self._edges: list[Edge] = []
        self._last: Frame | None = None
        self._count = 0
        self._index: int | None = None

    def push(self, frame: Frame) -> None:
        """Take the next frame; those before the first index are left out."""
        header, before = frame.header, self._last
        shift = 0
        if before is None:
            self._count = header["last_count"]
        else:
            self._count += wrapped_difference(header["last_count"], before.header["last_count"])
            shift = before.header["edge_shift"]
        follows = before is not None and frame.number == before.number + 1
        self._last = frame
        if frame.flags["index_seen"]:
            if self._index is None:
                self._index = self._count + wrapped_difference(header["index_count"], header["last_count"])
            self._edges += edges_of_frame(frame, self._count, follows=follows, shift_before=shift)

    @property
    def turns(self) -> float:
        """Turns gathered so far."""
        if not self._edges:
            return 0.0
        return abs(self._edges[-1].position - self._edges[0].position) / self.counts_per_turn

    def table(self) -> Floats:
        """Counts to add at each line from the index on: an ``encoder.error_table`` for the calibration.

        Its mean is 0: a constant belongs to ``zero_rad``. What turns with the motor and is no fault of the encoder, as
        a speed that is uneven in the same way in each turn, cannot be told apart.

        Raises
        ------
        CalibrationError
            Too few turns or edges, or it did not turn one way.
        """
        if self.turns < MIN_TURNS or self._index is None:
            raise CalibrationError(f"{self.turns:.1f} turns were recorded, {MIN_TURNS} are needed: turn longer")
        time = np.array([edge.time for edge in self._edges], np.float64)
        position = np.array([edge.position for edge in self._edges]) - self._index
        if not (np.diff(position) > 0).all() and not (np.diff(position) < 0).all():
            raise CalibrationError("the motor turned both ways: an error table is learned from turns in one direction")
        whole = int(self.turns) * self.counts_per_turn
        keep = np.abs(position - position[0]) < whole
        time, position = time[keep], position[keep]
        # Over whole turns the errors of the lines do not bend the fit; what is slower than a turn is the motor's.
        t = 2 * (time - time[0]) / (time[-1] - time[0]) - 1
        fit = np.polynomial.chebyshev.chebfit(t, position.astype(np.float64), _DRIFT_ORDER)
        error = np.polynomial.chebyshev.chebval(t, fit) - position
        line = np.mod(position, self.counts_per_turn)
        seen = np.bincount(line, minlength=self.counts_per_turn)
        if (seen > 0).mean() < MIN_COVERAGE:
            raise CalibrationError(
                f"{100 * (seen > 0).mean():.0f} % of the encoder's lines were seen, and {100 * MIN_COVERAGE:.0f} % are"
                " needed: turn slower, so that the card logs every edge, or longer"
            )
        total = np.bincount(line, weights=error, minlength=self.counts_per_turn)
        known = np.flatnonzero(seen)
        mean = total[known] / seen[known]
        table = np.interp(np.arange(self.counts_per_turn), known, mean, period=self.counts_per_turn)
        return np.asarray(table - table.mean(), dtype=np.float64)


@click.command()
@click.option("--port", required=True, help="Serial port of the card.")
@click.option("--calibration", required=True, type=click.Path(path_type=Path), help="JSON file, read and written.")
@click.option("--settings", required=True, help="Settings with motor.mode = 'speed'; the laser stays off.")
@click.option("--turns", type=click.IntRange(min=MIN_TURNS), default=4, show_default=True)
def main(port: str, calibration: Path, settings: str, turns: int) -> None:
    """Learn the encoder's line errors and write them into the calibration."""
    from .cli import fail

    try:
        table = _learn(port, calibration, settings, turns)
    except MagtrakError as error:
        fail(str(error))
    print(f"{turns} turns: RMS of the line errors {np.sqrt(np.mean(table**2)):.4f} counts, in {calibration}")


def _learn(port: str, path: Path, settings: str, turns: int) -> Floats:
    from .card import Card
    from .link import Link
    from .settings_file import load_settings

    calibration = Calibration.load(path)
    counts = calibration.laser.counts_per_turn
    chosen = load_settings(settings)
    chosen = replace(
        chosen, laser=replace(chosen.laser, arm=False), encoder=replace(chosen.encoder, counts_per_turn=counts)
    )
    errors = LineErrors(counts)
    with Link(port) as link:
        card = Card(link)
        generation = card.apply(chosen)
        card.start(chosen)
        try:
            begin: int | None = None
            for frame in card.frames():
                if frame is None or frame.header["generation"] != generation:
                    continue
                begin = frame.header["first_time"] if begin is None else begin
                if frame.header["first_time"] - begin > _SETTLING_S * card.identity.clock_hz:
                    errors.push(frame)
                if errors.turns > turns:
                    break
        finally:
            card.stop()
    table = errors.table()
    replace(calibration, laser=replace(calibration.laser, error_table=table)).save(path)
    return table


if __name__ == "__main__":
    main()
