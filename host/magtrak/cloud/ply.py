"""Binary PLY files of points.

``intensity`` is what CloudCompare reads, ``quality`` what MeshLab does; the names with ``scalar_`` become scalar fields
in CloudCompare.

Source: G. Turk, "The PLY Polygon File Format", Stanford 1994.
"""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .. import __version__
from ..arrays import Records
from ..errors import MagtrakError, OutputError

_NAME_OF = {"<f4": "float", "<f8": "double", "<i4": "int", "<u4": "uint", "<i2": "short", "<u2": "ushort"}
_NAME_OF |= {"|u1": "uchar", "|i1": "char"}
_TYPE_OF = {name: code for code, name in _NAME_OF.items()}
# The longer names that many programs write.
_TYPE_OF |= {"float32": "<f4", "float64": "<f8", "int32": "<i4", "uint32": "<u4", "int16": "<i2", "uint16": "<u2"}
_TYPE_OF |= {"uint8": "|u1", "int8": "|i1"}

_END = b"end_header\n"


def write_ply(path: Path, chunks: Sequence[Records], comments: Sequence[str] = ()) -> None:
    """Write structured arrays of one type, one behind the other, as the vertices of a little-endian PLY file.

    The file appears under its name only when it is whole.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    count = sum(len(chunk) for chunk in chunks)
    lines = ["ply", "format binary_little_endian 1.0", f"comment magtrak {__version__}"]
    lines += [f"comment {comment}" for comment in comments]
    lines.append(f"element vertex {count}")
    dtype = chunks[0].dtype
    lines += [f"property {_NAME_OF[dtype[name].str]} {name}" for name in dtype.names or ()]
    partial = path.with_name(path.name + ".part")
    try:
        with partial.open("wb") as file:
            file.write("\n".join(lines).encode("ascii", "replace") + b"\n" + _END)
            for chunk in chunks:
                file.write(np.ascontiguousarray(chunk).tobytes())
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from None


def read_ply(path: Path) -> Records:
    """The vertices of a little-endian PLY file whose only element they are, as a structured array.

    Raises
    ------
    MagtrakError
        There is no such file, or it is another kind of PLY, or cut short.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MagtrakError(f"{path} cannot be read: {error.strerror}") from None
    end = data.find(_END)
    head = data[: max(end, 0)].decode("ascii", "replace").splitlines()
    if end < 0 or head[:2] != ["ply", "format binary_little_endian 1.0"]:
        raise MagtrakError(f"{path} is no binary little-endian PLY file")
    count, fields = -1, []
    for line in head[2:]:
        match line.split():
            case ["comment", *_] | ["obj_info", *_]:
                pass
            case ["element", "vertex", number] if count < 0 and number.isdigit():
                count = int(number)
            case ["property", kind, name] if count >= 0 and kind in _TYPE_OF:
                fields.append((name, _TYPE_OF[kind]))
            case _:
                raise MagtrakError(f"{path} has {line!r} in its header: only vertices with plain numbers can be read")
    dtype = np.dtype(fields)
    body = memoryview(data)[end + len(_END) :]
    if count < 0 or len(body) != count * dtype.itemsize:
        raise MagtrakError(f"{path} holds {len(body)} bytes of points, not the {count * dtype.itemsize} of its header")
    return np.frombuffer(body, dtype, count).copy()
