"""Synthetic colour rows across a red laser line, and the bound of what can be known of it.

The line is Gaussian, of amplitude 180 in red; green and blue see 0.25 and 0.2 of it, which turns an over-exposed core
white. The background is 20 in all channels. Each row has a place of its own, uniform over 16 columns in the middle of
96. Speckle multiplies the laser's light of a pixel by a gamma variate of mean 1, the same in all channels. Noise is
normal and independent in all pixels and channels; then come rounding and clipping, and RGB565 drops the low bits
and fills up with the high ones.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.quantise import rgb565

Floats = NDArray[np.float64]

AMPLITUDE = 180.0
BACKGROUND = 20.0
RESPONSE = np.array([1.0, 0.25, 0.2])
COLUMNS = 96
FIRST, LAST = 40.0, 56.0


@dataclass(frozen=True)
class Condition:
    """What the rows are like: sigma in px, noise in grey levels, exposure as a factor, contrast of speckle."""

    sigma: float
    noise: float
    exposure: int = 1
    speckle: float = 0.0
    rgb565: bool = False

    def __str__(self) -> str:
        what = f"{'RGB565' if self.rgb565 else 'RGB888'}, sigma {self.sigma:g}, noise {self.noise:g}"
        if self.exposure > 1:
            what += f", {self.exposure}x over-exposed"
        if self.speckle:
            what += f", speckle {self.speckle:g}"
        return what


CONDITIONS = [
    Condition(sigma, noise, exposure, speckle, rgb565)
    for rgb565 in (False, True)
    for noise, exposure, speckle in (
        *((noise, 1, 0.0) for noise in (0, 2, 5, 10)),
        *((2, exposure, 0.0) for exposure in (4, 8)),
        *((2, 1, speckle) for speckle in (0.1, 0.3)),
    )
    for sigma in (0.8, 1.5, 3.0)
]


def make_rows(condition: Condition, count: int, seed: int) -> tuple[NDArray[np.uint8], Floats]:
    """(count, COLUMNS, 3) pixels, and the true place of the line in each row, in px."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(FIRST, LAST, count)
    light = AMPLITUDE * condition.exposure * _line(np.arange(COLUMNS) - place[:, None], condition.sigma)
    if condition.speckle:
        shape = condition.speckle**-2
        light *= rng.gamma(shape, 1 / shape, light.shape)
    clean = BACKGROUND + light[..., None] * RESPONSE
    pixels = (clean + rng.normal(0, condition.noise, clean.shape)).round().clip(0, 255).astype(np.uint8)
    if condition.rgb565:
        pixels = rgb565(pixels)
    return pixels, place


def bound(condition: Condition) -> float:
    """Cramer-Rao bound of the place from the red channel alone, in px; NaN where it is clipped or speckled.

    ``1 / sqrt(sum((dI/dc)**2) / variance)``, its square averaged over the places in a pixel. The variance is that of
    the noise and of rounding, step**2 / 12; RGB565 has a step of 8. Amplitude and width are taken as known: what is
    not known of a symmetric line does not widen the bound.
    """
    if condition.exposure > 1 or condition.speckle:
        return float("nan")
    variance = condition.noise**2 + (8 if condition.rgb565 else 1) ** 2 / 12
    x = np.arange(-40, 41) - np.linspace(0, 1, 32, endpoint=False)[:, None]
    slope = AMPLITUDE * _line(x, condition.sigma) * x / condition.sigma**2
    return float(np.sqrt(np.mean(variance / (slope**2).sum(axis=1))))


def _line(x: Floats, sigma: float) -> Floats:
    return np.exp(-(x**2) / (2 * sigma**2))
