"""PNG files, with the standard library alone.

Source: ISO/IEC 15948, Portable Network Graphics.
"""

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import OutputError

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _RGB = 0, 2


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write (rows, columns) as grey, (rows, columns, 3) as R, G, B; :exc:`OutputError` where it fails."""
    rows, columns = picture.shape[:2]
    kind = _RGB if picture.ndim == 3 else _GREY
    # Each row begins with the number of its filter; 0 is none.
    lines = np.zeros((rows, 1 + picture[0].size), np.uint8)
    lines[:, 1:] = picture.reshape(rows, -1)
    head = struct.pack(">IIBBBBB", columns, rows, 8, kind, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b""))
    try:
        path.write_bytes(_SIGNATURE + b"".join(_chunk(name, data) for name, data in parts))
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}") from None


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
