"""Reads values out of parsed files, and says in one sentence what is wrong with one."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from .arrays import Floats
from .errors import MagtrakError

_MISSING: Any = object()


class Checked:
    """A table of a parsed file (JSON or TOML) whose values are checked as they are read.

    Every error names file, field, value and what was expected. A value without a default is required.

    Parameters
    ----------
    where : the file, or whatever the message shall name
    values : the table as parsed
    error : raised for whatever is wrong
    path : name of the table within the file, empty for the whole file
    """

    def __init__(self, where: str, values: object, error: type[MagtrakError], path: str = "") -> None:
        self.where = where
        self.error = error
        self.path = path
        if not isinstance(values, Mapping):
            raise error(f"{where}: {path or 'the file'} must be a table of named values, not {_short(values)}")
        self.values: Mapping[str, Any] = values

    def section(self, name: str, *, required: bool = True) -> "Checked":
        """A table within this one; an empty one where it is missing and not required."""
        if required:
            value = self._get(name, _MISSING, "a table of named values")
        else:
            value = self.values.get(name, {})
        return Checked(self.where, value, self.error, self._name(name))

    def only(self, names: Iterable[str]) -> None:
        """Refuse names that mean nothing here: they are most likely mistyped."""
        known = list(names)
        for name in self.values:
            if name not in known:
                raise self.error(f"{self.where}: {self._name(name)} is not known; known here: {', '.join(known)}")

    def number(self, name: str, low: float, high: float, default: float = _MISSING) -> float:
        expected = f"a number from {low:g} to {high:g}"
        value = self._get(name, default, expected)
        if not _is_number(value) or not low <= value <= high:
            self._refuse(name, value, expected)
        return float(value)

    def integer(self, name: str, low: int, high: int, default: int = _MISSING) -> int:
        expected = f"a whole number from {low} to {high}"
        value = self._get(name, default, expected)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            self._refuse(name, value, expected)
        return int(value)

    def boolean(self, name: str, default: bool = _MISSING) -> bool:
        value = self._get(name, default, "true or false")
        if not isinstance(value, bool):
            self._refuse(name, value, "true or false")
        return bool(value)

    def choice(self, name: str, choices: Iterable[Any], default: Any = _MISSING) -> Any:
        known = list(choices)
        expected = " or ".join(repr(choice) for choice in known)
        value = self._get(name, default, expected)
        if isinstance(value, bool) or value not in known:
            self._refuse(name, value, expected)
        return value

    def span(self, name: str, low: float, high: float, default: tuple[float, float] = _MISSING) -> tuple[float, float]:
        """Two numbers, a range whose ends may stand in either order: what an inverted one means is the caller's."""
        expected = f"two numbers from {low:g} to {high:g}"
        value = self._get(name, default, expected)
        if not isinstance(value, list | tuple) or len(value) != 2:
            self._refuse(name, value, expected)
        if not all(_is_number(end) and low <= end <= high for end in value):
            self._refuse(name, value, expected)
        return float(value[0]), float(value[1])

    def array(self, name: str, *shapes: tuple[int, ...]) -> Floats:
        """Finite numbers in lists of one of the given shapes; -1 stands for any length from 1."""
        expected = "finite numbers, " + " or ".join(_shape(shape) for shape in shapes)
        value = self._get(name, _MISSING, expected)
        if not _all_numbers(value):
            self._refuse(name, value, expected)
        try:
            array = np.array(value, dtype=np.float64)
        except ValueError:  # rows of different lengths
            self._refuse(name, value, expected)
        if array.size == 0 or not any(_fits(array.shape, shape) for shape in shapes):
            self._refuse(name, value, expected)
        return array

    def refuse(self, name: str, expected: str) -> None:
        """Raise the error for a value that is there but will not do."""
        self._refuse(name, self.values.get(name), expected)

    def _name(self, name: str) -> str:
        return f"{self.path}.{name}" if self.path else name

    def _get(self, name: str, default: Any, expected: str) -> Any:
        if name in self.values:
            return self.values[name]
        if default is _MISSING:
            raise self.error(f"{self.where}: {self._name(name)} is missing; it must be {expected}")
        return default

    def _refuse(self, name: str, value: object, expected: str) -> None:
        raise self.error(f"{self.where}: {self._name(name)} is {_short(value)}; it must be {expected}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _all_numbers(value: object) -> bool:
    if isinstance(value, list):
        return all(_all_numbers(item) for item in value)
    return _is_number(value)


def _fits(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    return len(shape) == len(wanted) and all(w in (-1, s) for s, w in zip(shape, wanted, strict=True))


def _shape(shape: tuple[int, ...]) -> str:
    if shape == (-1,):
        return "a list"
    return f"a list of {shape[0]}" if len(shape) == 1 else f"{shape[0]} rows of {shape[1]}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
