"""What can be wrong with a calibration, each with its reason and its cure: one table, ``findings.toml``, from
which messages and ``docs/calibration.md`` are rendered.

``python -m magtrak.calibrate.findings`` prints the table in Markdown.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from ..errors import CalibrationError


@dataclass(frozen=True)
class Kind:
    """A thing that can be wrong.

    Attributes
    ----------
    refused : whether no calibration can be made; else a warning
    mistake : what somebody did
    message : with fields in braces
    """

    refused: bool
    mistake: str
    message: str


@dataclass(frozen=True)
class Finding:
    """A thing that is wrong."""

    key: str
    refused: bool
    text: str

    def __str__(self) -> str:
        return self.text


def _read() -> dict[str, Kind]:
    with Path(__file__).with_suffix(".toml").open("rb") as file:
        return {key: Kind(**values) for key, values in tomllib.load(file).items()}


KINDS = _read()
"""By their keys, in the table's order."""


def finding(key: str, **fields: object) -> Finding:
    """A finding of a kind, with its fields."""
    kind = KINDS[key]
    return Finding(key, kind.refused, kind.message.format(**fields))


def refuse(key: str, **fields: object) -> CalibrationError:
    """The error for a finding that ends a calibration."""
    return CalibrationError(KINDS[key].message.format(**fields))


def table() -> str:
    """All kinds as a Markdown table."""
    lines = ["| what went wrong | what happens | message |", "|---|---|---|"]
    for kind in KINDS.values():
        lines.append(f"| {kind.mistake} | {'refused' if kind.refused else 'warning'} | {kind.message} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
