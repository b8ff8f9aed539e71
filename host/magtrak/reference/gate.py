"""The colour gate: three tables, all of which must pass."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .hls import U8, hls

LUTS_SHAPE = (3, 256)
"""Tables of hue, luminance and saturation."""


def gate(rgb: U8, luts: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which colours pass: ``luts[0][hue] & luts[1][luminance] & luts[2][saturation]``.

    Parameters
    ----------
    rgb : (..., 3) uint8
    luts : (3, 256) bool
    """
    if luts.shape != LUTS_SHAPE:
        raise ValueError(f"gate tables have the shape {luts.shape}; (3, 256) is needed")
    hue, luminance, saturation = hls(rgb)
    passed: NDArray[np.bool_] = luts[0][hue] & luts[1][luminance] & luts[2][saturation]
    return passed


def luts_from_words(words: Sequence[Sequence[int]]) -> NDArray[np.bool_]:
    """The tables that three times eight 32-bit register words hold: entry i is bit i % 32 of word i // 32."""
    bits = [[bool(word >> bit & 1) for word in axis for bit in range(32)] for axis in words]
    return np.array(bits, dtype=np.bool_)


def words_from_luts(luts: NDArray[np.bool_]) -> list[list[int]]:
    """The register words of the tables, the reverse of :func:`luts_from_words`."""
    if luts.shape != LUTS_SHAPE:
        raise ValueError(f"gate tables have the shape {luts.shape}; (3, 256) is needed")
    return [[sum(int(axis[32 * word + bit]) << bit for bit in range(32)) for word in range(8)] for axis in luts]
