"""Frame packets made from a motor's movement, as a perfect card would send them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from magtrak import protocol
from magtrak.protocol import RowForm

CLOCK_HZ = 50_000_000

Movement = Callable[[np.ndarray], np.ndarray]
"""Seconds to the encoder's position in counts."""


@dataclass
class Recorder:
    """Cuts a movement into frames.

    Parameters
    ----------
    movement : position over time
    rows, columns : of the pictures
    frame_s : period of the frames
    rows_s : from the first row to the last
    start_s : time of the first frame's first row
    """

    movement: Movement
    rows: int = 48
    columns: int = 64
    frame_s: float = 0.02
    rows_s: float = 0.016
    start_s: float = 0.1
    index_count: int = 0
    jitter_s: float = 0.0
    line_error: Callable[[np.ndarray], np.ndarray] | None = None
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def row_times(self, number: int) -> np.ndarray:
        """Seconds."""
        return self.start_s + number * self.frame_s + np.linspace(0, self.rows_s, self.rows)

    def edges(self, until_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times in s, counts after the edge, and whether backward, of all edges from time 0 on."""
        step = 2e-5
        t = np.arange(0, until_s + step, step)
        p = self.movement(t)
        # Where the lines really stand: the encoder counts lines, the movement is true.
        lines = np.arange(int(p.min()) - 2, int(p.max()) + 3)
        at = lines + (self.line_error(lines) if self.line_error else 0.0)
        count = lines[0] + np.searchsorted(at, p, side="right") - 1
        where = np.flatnonzero(np.diff(count))
        times, counts, backward = [], [], []
        for i in where:
            moves = count[i + 1] - count[i]
            for k in range(abs(moves)):
                after = count[i] + (k + 1 if moves > 0 else -k - 1)
                line = at[after + (moves < 0) - lines[0]]
                low, high = t[i], t[i + 1]
                for _ in range(40):
                    middle = (low + high) / 2
                    if (self.movement(np.array([middle]))[0] >= line) == (moves > 0):
                        high = middle
                    else:
                        low = middle
                times.append(low)
                counts.append(after)
                backward.append(int(moves < 0))
        times = np.array(times) + self.rng.normal(0, self.jitter_s, len(times))
        order = np.argsort(times)
        return times[order], np.array(counts, int)[order], np.array(backward, int)[order]

    def payloads(self, count: int, columns: Callable[[int], np.ndarray] | None = None, **header: int) -> list[bytes]:
        """Payloads of ``count`` frames; ``columns(number)`` gives a row's column in px, NaN for none."""
        times, counts, backward = self.edges(self.start_s + count * self.frame_s)
        logged = 0
        payloads = []
        for number in range(count):
            rows = self.row_times(number)
            end = int(np.searchsorted(times, rows[-1] + 1e-4))
            log = list(range(logged, end))
            logged = end
            shift = 0
            while len(log) >> shift > protocol.MAX_EDGES:
                shift += 1
            log = [i for i in log if (i + 1) % (1 << shift) == 0][-protocol.MAX_EDGES :]
            values = dict.fromkeys((f.name for f in protocol.FRAME.fields if not f.reserved), 0)
            values |= {
                "frame": number,
                "flags": 1,
                "form": RowForm.FULL,
                "detector": 1,
                "edges": len(log),
                "edge_shift": shift,
                "rows": self.rows,
                "columns": self.columns,
                "index_count": self.index_count,
                "index_passes": 1,
                "row_step": 1,
            }
            for name, time in (("first", rows[0]), ("last", rows[-1])):
                last = int(np.searchsorted(times, time, side="right")) - 1
                clocks = round(time * CLOCK_HZ)
                values[f"{name}_time"] = clocks
                shown = int(np.floor(self.movement(np.array([time]))[0]))
                values[f"{name}_count"] = counts[last] if last >= 0 else shown
                values[f"{name}_age"] = clocks - round(times[last] * CLOCK_HZ) if last >= 0 else 2**32 - 1
            values |= header
            data = protocol.FRAME.pack({name: int(value) for name, value in values.items()})
            for i in log:
                data += protocol.EDGE.pack(
                    {
                        "time": round(times[i] * CLOCK_HZ) & 0xFFFF_FFFF,
                        "count": int(counts[i]),
                        "backward": int(backward[i]),
                    }
                )
            data += full_rows(columns(number) if columns else np.full(self.rows, np.nan))
            payloads.append(data)
        return payloads


def full_rows(columns_px: Sequence[float] | np.ndarray) -> bytes:
    """Rows with a good line at these columns, NaN for none."""
    data = b""
    for column in columns_px:
        values = dict.fromkeys((f.name for f in protocol.FULL_ROW.fields if not f.reserved), 0)
        if not np.isnan(column):
            values |= {"position": round(column * 256), "valid": 1, "peak": 200, "width": 6, "sum": 800, "gated": 6}
        data += protocol.FULL_ROW.pack(values)
    return data
