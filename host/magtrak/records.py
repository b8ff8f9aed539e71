"""Records of bit fields to arrays, the whole packet at once; the vectorised ``Layout.unpack``."""

from collections.abc import Iterator, Mapping

import numpy as np

from .arrays import Booleans, Integers, Numbers
from .protocol import Field, Layout


class FieldArrays(Mapping[str, Integers]):
    """Fields of records, an array each, unpacked when first asked for.

    Fields are at most 63 bits wide when unsigned, 64 when signed, as int64 holds them.

    Parameters
    ----------
    layout : of a record; records of 4 bytes have no signed fields
    data : ``count`` records
    count : how many
    """

    def __init__(self, layout: Layout, data: bytes | memoryview, count: int) -> None:
        self._layout = layout
        self._known: dict[str, Integers] = {}
        self._words: Numbers
        if layout.size in (4, 8):
            self._words = np.frombuffer(data, f"<u{layout.size}", count)
        else:
            padded = np.zeros((count, -(-layout.size // 8) * 8), np.uint8)
            padded[:, : layout.size] = np.frombuffer(data, np.uint8, count * layout.size).reshape(count, layout.size)
            self._words = padded.view("<u8")

    def __getitem__(self, name: str) -> Integers:
        known = self._known.get(name)
        if known is None:
            offset, field = self._layout.place(name)
            known = self._known[name] = self._unpack(offset, field)
        return known

    def span(self, first: str, last: str) -> Integers:
        """The fields from ``first`` to ``last`` as one number, unsigned; of records of 4 bytes."""
        assert self._layout.size == 4
        (low, _), (high, field) = self._layout.place(first), self._layout.place(last)
        return self._unpack(low, Field(f"{first} to {last}", high + field.bits - low))

    def flags(self, name: str) -> Booleans:
        """A field of one bit."""
        if self._words.ndim > 1:
            return self[name].astype(bool)
        offset, _ = self._layout.place(name)
        return np.asarray(self._words & (1 << offset) != 0)

    def __iter__(self) -> Iterator[str]:
        return (field.name for field in self._layout.fields if not field.reserved)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _unpack(self, offset: int, field: Field) -> Integers:
        words = self._words
        if words.ndim == 1:
            return _of_words(words, offset, field)
        at, shift = divmod(offset, 64)
        value = words[:, at] >> np.uint64(shift)
        if shift + field.bits > 64:
            value |= words[:, at + 1] << np.uint64(64 - shift)
        # To the top and back: the second shift is arithmetic where the field is signed.
        spare = 64 - field.bits
        value = value << np.uint64(spare)
        number = value.view(np.int64) >> spare if field.signed else (value >> np.uint64(spare)).astype(np.int64)
        return np.asarray(number, dtype=np.int64)


def _of_words(words: Numbers, offset: int, field: Field) -> Integers:
    """A field of records of one word."""
    top = 8 * words.itemsize - offset - field.bits
    if field.signed:
        assert words.itemsize == 8
        return np.asarray(words.view(np.int64) << top >> 64 - field.bits)
    shifted = words >> offset if offset else words
    value = shifted & ((1 << field.bits) - 1) if top else shifted
    return value if words.itemsize == 4 else value.view(np.int64)
