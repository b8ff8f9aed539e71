"""Records of bit fields: the one description that both sides derive theirs from."""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class Field:
    """One field of a record.

    Parameters
    ----------
    name : identifier, ``_`` followed by anything for reserved bits (sent as 0, ignored)
    bits : width on the wire, 1 to 64
    doc : what it means, one sentence
    unit : unit or fixed-point format; empty for plain numbers
    signed : two's complement
    """

    name: str
    bits: int
    doc: str = ""
    unit: str = ""
    signed: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.bits <= 64:
            raise ValueError(f"field {self.name!r} has {self.bits} bits; 1 to 64 are possible")

    @property
    def reserved(self) -> bool:
        return self.name.startswith("_")

    @property
    def range(self) -> tuple[int, int]:
        """Smallest and largest value."""
        if self.signed:
            return -(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1
        return 0, (1 << self.bits) - 1


@dataclass(frozen=True)
class Layout:
    """Fields packed without gaps, the first one in the least significant bits, sent little-endian.

    ``pack`` raises :exc:`ValueError` for a value that does not fit, and
    :exc:`KeyError` for a missing one; ``unpack`` takes exactly ``size`` bytes.
    """

    name: str
    fields: tuple[Field, ...]

    def __post_init__(self) -> None:
        if self.bits % 8:
            raise ValueError(f"layout {self.name!r} has {self.bits} bits, not whole bytes")
        names = [field.name for field in self.fields]
        if len(set(names)) != len(names):
            raise ValueError(f"layout {self.name!r} names a field twice: {names}")

    @cached_property
    def bits(self) -> int:
        return sum(field.bits for field in self.fields)

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return self.bits // 8

    def __iter__(self) -> Iterator[tuple[int, Field]]:
        """Bit offset and field, in order."""
        offset = 0
        for field in self.fields:
            yield offset, field
            offset += field.bits

    def place(self, name: str) -> tuple[int, Field]:
        """Bit offset of a field, and the field."""
        return self._places[name]

    @cached_property
    def _places(self) -> dict[str, tuple[int, Field]]:
        return {field.name: (offset, field) for offset, field in self}

    def pack(self, values: Mapping[str, int]) -> bytes:
        word = 0
        for offset, field in self:
            value = 0 if field.reserved else values[field.name]
            low, high = field.range
            if not low <= value <= high:
                raise ValueError(f"{self.name}.{field.name} is {value}, outside {low} to {high}")
            word |= (value & ((1 << field.bits) - 1)) << offset
        return word.to_bytes(self.size, "little")

    def unpack(self, data: bytes | bytearray | memoryview) -> dict[str, int]:
        if len(data) != self.size:
            raise ValueError(f"{self.name} takes {self.size} bytes, got {len(data)}")
        if self._whole is not None:
            names, whole = self._whole
            return dict(zip(names, whole.unpack(data), strict=True))
        word = int.from_bytes(data, "little")
        return {name: ((word >> offset & mask) ^ sign) - sign for name, offset, mask, sign in self._parts}

    def unpack_each(self, data: bytes | memoryview) -> list[tuple[int, ...]]:
        """The fields of each of some records of 8 bytes, in order."""
        parts = [(offset, mask, sign) for _, offset, mask, sign in self._parts]
        return [
            tuple([((word >> offset & mask) ^ sign) - sign for offset, mask, sign in parts])
            for (word,) in struct.iter_unpack("<Q", data)
        ]

    @cached_property
    def _whole(self) -> tuple[list[str], struct.Struct] | None:
        """Names and format where every field is a whole number as machines have them: that is faster."""
        letters = {8: "b", 16: "h", 32: "i", 64: "q"}
        if any(field.reserved or field.bits not in letters for field in self.fields):
            return None
        codes = (letters[field.bits] if field.signed else letters[field.bits].upper() for field in self.fields)
        return [field.name for field in self.fields], struct.Struct("<" + "".join(codes))

    @cached_property
    def _parts(self) -> tuple[tuple[str, int, int, int], ...]:
        """Name, offset, mask and sign bit (0 where unsigned) of each field that is not reserved."""
        return tuple(
            (field.name, offset, (1 << field.bits) - 1, 1 << field.bits - 1 if field.signed else 0)
            for offset, field in self
            if not field.reserved
        )
