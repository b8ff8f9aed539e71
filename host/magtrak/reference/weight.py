"""The signed mix of the channels, which measures the line."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .hls import U8

FRACTION_BITS = 8
"""Coefficients are signed Q2.8: 256 is 1."""


def mix(rgb: U8, settings: Mapping[str, int]) -> NDArray[np.int32]:
    """``(weight_r * R + weight_g * G + weight_b * B + 128) >> 8``, clipped to 0..255."""
    red, green, blue = (rgb[..., axis].astype(np.int32) for axis in range(3))
    total = settings["weight_r"] * red + settings["weight_g"] * green + settings["weight_b"] * blue
    clipped: NDArray[np.int32] = np.clip((total + 128) >> FRACTION_BITS, 0, 255)
    return clipped


def weight(mixed: NDArray[np.int32], settings: Mapping[str, int]) -> NDArray[np.int32]:
    """The mix less the floor, clipped at 0."""
    above: NDArray[np.int32] = np.maximum(mixed - settings["floor"], 0)
    return above


def saturated(rgb: U8) -> NDArray[np.bool_]:
    """Where a channel is at full scale."""
    full: NDArray[np.bool_] = (rgb == 255).any(axis=-1)
    return full
