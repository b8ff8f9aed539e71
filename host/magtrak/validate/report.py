"""Figures beside each other: what was measured, what it should be, what the paper has."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """One figure.

    Attributes
    ----------
    what : was measured
    value, unit : ours
    nominal : what it should be, in the same unit; None where it is an error itself
    paper : what the paper has to set against it, in words; empty for nothing
    other : the same figure by the paper's method on the same data, where there is one
    """

    what: str
    value: float
    unit: str = "mm"
    nominal: float | None = None
    paper: str = ""
    other: float | None = None

    @property
    def error(self) -> float | None:
        """Measured less nominal."""
        return None if self.nominal is None else self.value - self.nominal


def table(lines: Sequence[Line], title: str = "") -> str:
    """Lines as text, in columns; those that no line needs are left out."""
    heads = ["", "measured", "nominal", "error", "the paper's way", "", "the paper"]
    cells = [
        [
            line.what,
            _number(line.value),
            _number(line.nominal),
            _number(line.error, sign=True),
            _number(line.other),
            line.unit,
            line.paper,
        ]
        for line in lines
    ]
    used = [at for at in range(len(heads)) if any(row[at] for row in cells)]
    rows = [[heads[at] for at in used]] + [[row[at] for at in used] for row in cells]
    widths = [max(len(row[at]) for row in rows) for at in range(len(used))]
    left = {0, used.index(5) if 5 in used else -1, used.index(6) if 6 in used else -1}
    text = [
        "  ".join(
            cell.ljust(width) if at in left else cell.rjust(width)
            for at, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    return "\n".join(([title] if title else []) + text)


def _number(value: float | None, sign: bool = False) -> str:
    if value is None:
        return ""
    return f"{value:+.3f}" if sign else f"{value:.3f}"
