"""A reader of binary PLY clouds, independent of the writer that it judges."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import SimError

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "<i2", "int16": "<i2", "ushort": "<u2", "uint16": "<u2",
    "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4",
    "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip


def read(path: Path, needed: tuple[str, ...]) -> npt.NDArray[Any]:
    """The vertices of a little-endian binary PLY file as a structured array.

    Raises
    ------
    SimError : it can't be read, is of another kind, cut short, or has not the ``needed`` properties
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SimError(f"the cloud {path} can't be read: {error.strerror}") from error
    head, mark, body = data.partition(b"end_header\n")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    if not mark or lines[0] != ["ply"] or ["format", "binary_little_endian", "1.0"] not in lines:
        raise SimError(f"the cloud {path} is not a binary little-endian PLY file")
    elements = [line for line in lines if line[:1] == ["element"]]
    if not elements or elements[0][1] != "vertex" or len(elements[0]) != 3 or not elements[0][2].isdigit():
        raise SimError(f"the cloud {path} does not begin with vertices")
    fields: list[tuple[str, str]] = []
    inside = False
    for line in lines:
        if line[:1] == ["element"]:
            inside = line is elements[0]
        elif inside and line[:1] == ["property"]:
            if len(line) != 3 or line[1] not in _TYPES:
                raise SimError(f"the cloud {path} has a property that is not a plain number: {' '.join(line)}")
            fields.append((line[2], _TYPES[line[1]]))
    missing = [name for name in needed if name not in dict(fields)]
    if missing:
        raise SimError(f"the cloud {path} has no property {missing[0]}")
    dtype, count = np.dtype(fields), int(elements[0][2])
    if len(body) < count * dtype.itemsize:
        raise SimError(f"the cloud {path} is cut short: {len(body)} of {count * dtype.itemsize} bytes are there")
    return np.frombuffer(body, dtype, count)
