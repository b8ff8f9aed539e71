"""Checked reading of TOML tables: every wrong value becomes one sentence that names file, field and value."""

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any, NoReturn

from .errors import SimError


class Table:
    """A table of a TOML file.

    Fields are taken one by one; :meth:`finish` then complains of fields that nobody took. A default makes a
    field optional.

    Parameters
    ----------
    path : the file, for messages
    name : the table, for messages; empty for the whole file
    values : what was read
    """

    def __init__(self, path: Path, name: str, values: Mapping[str, Any]) -> None:
        self._path = path
        self._name = name
        self._values = dict(values)

    def fail(self, key: str, problem: str) -> NoReturn:
        """Raise the error for a field."""
        where = f"[{self._name}] {key}" if self._name else key
        raise SimError(f"scene {self._path}: {where} {problem}")

    def _take(self, key: str, default: Any, what: str) -> Any:
        if key in self._values:
            return self._values.pop(key)
        if default is None:
            self.fail(key, f"is missing; give {what}")
        return default

    def number(
        self, key: str, default: float | None = None, *, low: float | None = None, above: float | None = None
    ) -> float:
        """A finite number, at least ``low`` or greater than ``above``."""
        what = "a number"
        if low is not None:
            what += f" of at least {low:g}"
        if above is not None:
            what += f" greater than {above:g}"
        value = self._take(key, default, what)
        good = isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
        if not good or (low is not None and value < low) or (above is not None and value <= above):
            self.fail(key, f"has to be {what}, not {value!r}")
        return float(value)

    def integer(self, key: str, default: int | None = None, *, low: int = 1, high: int = 1 << 24) -> int:
        """A whole number from ``low`` to ``high``."""
        what = f"a whole number from {low} to {high}"
        value = self._take(key, default, what)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            self.fail(key, f"has to be {what}, not {value!r}")
        return value

    def numbers(
        self,
        key: str,
        counts: tuple[int, ...],
        default: tuple[float, ...] | None = None,
        *,
        low: float | None = None,
        high: float | None = None,
    ) -> tuple[float, ...]:
        """A list of numbers of one of the given lengths, each from ``low`` to ``high``."""
        what = f"a list of {' or '.join(map(str, counts))} numbers"
        if low is not None:
            what += f" of at least {low:g}"
        if high is not None:
            what += f" up to {high:g}"
        value = self._take(key, default, what)
        good = (
            isinstance(value, (list, tuple))
            and len(value) in counts
            and all(isinstance(x, (int, float)) and not isinstance(x, bool) and isfinite(x) for x in value)
            and all((low is None or x >= low) and (high is None or x <= high) for x in value)
        )
        if not good:
            self.fail(key, f"has to be {what}, not {value!r}")
        return tuple(float(x) for x in value)

    def matrix(self, key: str, rows: int, columns: int) -> tuple[tuple[float, ...], ...]:
        """A matrix as a list of rows."""
        what = f"a matrix of {rows} rows of {columns} numbers"
        value = self._take(key, None, what)
        good = isinstance(value, list) and len(value) == rows
        if not good or not all(
            isinstance(row, list)
            and len(row) == columns
            and all(isinstance(x, (int, float)) and not isinstance(x, bool) and isfinite(x) for x in row)
            for row in value
        ):
            self.fail(key, f"has to be {what}, not {value!r}")
        return tuple(tuple(float(x) for x in row) for row in value)

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        """One of some words."""
        what = f"one of {', '.join(choices)}"
        value = self._take(key, None, what)
        if value not in choices:
            self.fail(key, f"has to be {what}, not {value!r}")
        return str(value)

    def has(self, key: str) -> bool:
        """Whether the field is there and not yet taken."""
        return key in self._values

    def word(self, key: str, default: str) -> str:
        """Any word."""
        value = self._take(key, default, "a word")
        if not isinstance(value, str):
            self.fail(key, f"has to be a word in quotes, not {value!r}")
        return value

    def boolean(self, key: str, default: bool) -> bool:
        """true or false."""
        value = self._take(key, default, "true or false")
        if not isinstance(value, bool):
            self.fail(key, f"has to be true or false, not {value!r}")
        return value

    def table(self, key: str) -> "Table":
        """A table inside this one; an empty one where it is missing."""
        value = self._values.pop(key, {})
        if not isinstance(value, dict):
            self.fail(key, f"has to be a table, not {value!r}")
        return Table(self._path, f"{self._name}.{key}" if self._name else key, value)

    def tables(self, key: str) -> list["Table"]:
        """A list of tables, at least one."""
        value = self._take(key, None, f"at least one [[{key}]] table")
        if not isinstance(value, list) or not value or not all(isinstance(item, dict) for item in value):
            self.fail(key, f"has to be given as [[{key}]] tables, not {value!r}")
        return [Table(self._path, f"{key} {number}", item) for number, item in enumerate(value)]

    def finish(self) -> None:
        """No field may be left over."""
        for key in self._values:
            self.fail(key, "is not a field of a scene; is it misspelt?")
