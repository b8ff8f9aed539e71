"""Learns the gate: which colours are the laser's, from pictures of it."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import LearnError
from .gate import Spans
from .reference.hls import U8, hls
from .settings import Gate

MIN_PIXELS = 16
"""A line of fewer coloured pixels tells nothing."""

DARK = 20
"""Grey levels: a patch with no brighter pixel has no line in it."""

WHITE = 230
"""A pixel whose weakest channel is at least so bright has no colour that tells anything."""

MIN_CHROMA = 24
"""Grey levels between the strongest and the weakest channel from which on a colour has a hue that can be trusted,
RGB565 (steps of 8) included."""

MIN_RISE = 12
"""Grey levels by which the laser has to colour a pixel of an on/off pair."""

CLIPPED = 240
"""Grey levels from which on a channel may be clipped."""

SURROUNDINGS_PX = 15
"""To each side; wider than any line."""

COVERAGE = 0.96
"""Part of the line's pixels whose hue is to pass; the rest are strays."""

_SMOOTH = 2.5  # of the histogram of hues, in hue bytes: RGB565 leaves gaps of up to 5
_MARGIN = 1  # hue bytes more on either side
_RARE = 1e-5  # density of a hue that others hardly have
_LOWEST = 0.75  # of the darkest line pixels' luminance and saturation: the line is darker farther away


@dataclass(frozen=True)
class Sample:
    """Pixels of the line, and others; (n, 3) RGB each."""

    line: U8
    others: U8


def from_patch(picture: U8, x: int, y: int, width: int, height: int) -> Sample:
    """The line's pixels in a rectangle that someone has picked; the others are what lies outside.

    The line is what is at least half as bright as the brightest in the patch, and neither white nor grey.

    Raises
    ------
    LearnError
        The patch is not in the picture, too small, dark, white, or has no hue.
    """
    rows, columns = picture.shape[:2]
    name = f"the patch {x} {y} {width} {height}"
    if x < 0 or y < 0 or width < 1 or height < 1 or x + width > columns or y + height > rows:
        raise LearnError(f"{name} is not within the picture of {columns} x {rows} pixels: give X Y WIDTH HEIGHT in it")
    if width * height < MIN_PIXELS:
        raise LearnError(f"{name} has {width * height} pixels: draw it larger, at least {MIN_PIXELS} are needed")
    inside = np.zeros((rows, columns), bool)
    inside[y : y + height, x : x + width] = True
    patch = picture[inside]
    strongest = patch.max(axis=1)
    brightest = np.percentile(strongest, 99)
    if brightest < DARK:
        raise LearnError(f"{name} is dark, {brightest:.0f} of 255 at most: pick one with the line in it")
    bright = patch[strongest >= brightest / 2]
    white = bright.min(axis=1) >= WHITE
    line = bright[~white & (_chroma(bright) >= MIN_CHROMA)]
    if len(line) < MIN_PIXELS:
        if white.mean() > 0.5:
            raise LearnError(
                f"{name} is white, {100 * white.mean():.0f} % of its bright pixels are over-exposed: pick one with the"
                " line's coloured rim in it, or shorten the exposure"
            )
        raise LearnError(
            f"{name} has no hue, only {len(line)} of its bright pixels have a colour: pick one with the line in it,"
            " or darken the room"
        )
    return Sample(line, picture[~inside])


def from_pair(on: U8, off: U8) -> Sample:
    """The pixels that the laser coloured, from two pictures of one scene; the others are those that it did not.

    The exposure may differ: each channel of ``off`` is scaled by the median of the ratios.

    Raises
    ------
    LearnError
        The sizes differ, or no line stands out of the difference.
    """
    if on.shape != off.shape:
        sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in (on, off))
        raise LearnError(f"the two pictures have {sizes} pixels: take both with one camera at one setting")
    rise = np.stack([_risen(on[..., channel], off[..., channel]) for channel in range(3)], axis=-1)
    # The laser's channel is the one that rose most over the others, and over its surroundings: lines are thin, while
    # another exposure or white balance changes areas. A white core does not count, nor what was clipped before.
    over = 1.5 * rise - 0.5 * rise.sum(axis=-1, keepdims=True)
    over = np.where(off.max(axis=-1, keepdims=True) < CLIPPED, _mean(over, 1) - _mean(over, SURROUNDINGS_PX), 0.0)
    channel = int(np.argmax(np.percentile(over, 99.8, axis=(0, 1))))
    coloured = over[..., channel]
    noise = 1.4826 * float(np.median(np.abs(coloured - np.median(coloured))))
    lit = (coloured > max(MIN_RISE, 6 * noise)) & (_chroma(on) >= MIN_CHROMA) & (on.min(axis=-1) < WHITE)
    if lit.sum() < MIN_PIXELS:
        raise LearnError(
            f"the two pictures are too alike, or differ everywhere: only {lit.sum()} pixels became more coloured than"
            " their surroundings; is the laser on in the first and off in the second, does the camera see the line and"
            " stand still?"
        )
    return Sample(on[lit], on[~lit])


def learn(sample: Sample) -> Gate:
    """The gate that passes nearly all of the line: hues in one or more ranges, luminance and saturation from the
    lowest up.

    Hues come in the order of how much more common they are in the line than elsewhere, until they cover the line.
    """
    hue, luminance, saturation = hls(sample.line)
    counts = np.bincount(hue, minlength=256)
    ratio = _density(hue) / (_density(hls(sample.others)[0]) + _RARE)
    order = np.argsort(-ratio, kind="stable")
    enough = int(np.searchsorted(np.cumsum(counts[order]), COVERAGE * counts.sum())) + 1
    passes = np.zeros(256, bool)
    for step in range(-_MARGIN, _MARGIN + 1):
        passes[(order[:enough] + step) % 256] = True
    return Gate(_hues(passes), *(_from_lowest(values) for values in (luminance, saturation)))


def _density(hue: NDArray[np.integer]) -> NDArray[np.float64]:
    """Smoothed part of the pixels at each hue byte."""
    counts = np.bincount(hue, minlength=256).astype(float)
    place = np.minimum(np.arange(256), 256 - np.arange(256))
    kernel = np.exp(-((place / _SMOOTH) ** 2) / 2)
    smooth: NDArray[np.float64] = np.fft.ifft(np.fft.fft(counts) * np.fft.fft(kernel / kernel.sum())).real
    return smooth / max(len(hue), 1)


def share(pixels: U8, luts: NDArray[np.bool_]) -> float:
    """Part of the pixels that pass, 0 to 1; 0 of none."""
    from .reference import gate

    return float(gate(pixels, luts).mean()) if len(pixels) else 0.0


def read_picture(path: Path) -> U8:
    """(rows, columns, 3) RGB.

    Raises
    ------
    LearnError
        It cannot be read.
    """
    try:
        from PIL import Image
    except ImportError:
        raise LearnError("reading pictures needs Pillow: pip install pillow") from None
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"))
    except FileNotFoundError:
        raise LearnError(f"the picture {path} does not exist: check the path") from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise LearnError(f"the picture {path} cannot be read ({error}): give a PNG or JPEG file") from None


def _chroma(pixels: U8) -> NDArray[np.int16]:
    chroma: NDArray[np.int16] = pixels.max(axis=-1).astype(np.int16) - pixels.min(axis=-1)
    return chroma


def _risen(on: U8, off: U8) -> NDArray[np.float64]:
    """How much brighter a channel is than the exposure explains."""
    # Where the ratio means something: neither black nor clipped.
    use = (off >= 16) & (off < CLIPPED) & (on < CLIPPED)
    gain = float(np.median(on[use] / off[use])) if use.sum() >= 100 else 1.0
    risen: NDArray[np.float64] = on - np.minimum(gain * off, 255)
    return risen


def _mean(values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Of a square that reaches so far to each side of each pixel; borders replicated."""
    size = 2 * reach + 1
    for axis in (0, 1):
        pads = [(0, 0)] * values.ndim
        pads[axis] = (reach + 1, reach)
        sums = np.cumsum(np.pad(values, pads, mode="edge"), axis=axis)
        ends = np.arange(values.shape[axis]) + size
        values = (np.take(sums, ends, axis=axis) - np.take(sums, ends - size, axis=axis)) / size
    return values


def _hues(passes: NDArray[np.bool_]) -> Spans:
    """Ranges in degrees of the hue bytes that pass."""
    if passes.all():
        return ((0.0, 360.0),)
    starts = np.flatnonzero(passes & ~np.roll(passes, 1))
    ends = np.flatnonzero(passes & ~np.roll(passes, -1))
    if ends[0] < starts[0]:  # through 360
        ends = np.roll(ends, -1)
    degrees = 360 / 256
    return tuple(
        (round(a * degrees, 1), round(b * degrees, 1)) for a, b in zip(starts.tolist(), ends.tolist(), strict=True)
    )


def _from_lowest(values: Iterable[int]) -> Spans:
    lowest = _LOWEST * float(np.percentile(np.asarray(values), 1)) / 255
    return ((round(lowest, 3), 1.0),)
