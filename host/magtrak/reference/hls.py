"""Hue, luminance and saturation of 8-bit RGB, in whole numbers."""

import numpy as np
from numpy.typing import NDArray

U8 = NDArray[np.uint8]

SEXTANT_START = (-43, 43, 128)
"""Hue (1/256 turn) from which the quotient counts where red, green, blue is the greatest channel: the
largest whole number that keeps every quotient at 0 or above."""

SEXTANT_OFFSET = (261, 257, 259)
"""What 6 * 256 * hue lies above the start by, in units of delta, with half a step added to round:
512 * k + 3 - 6 * start for k = 0, 1, 2."""


def hls(rgb: U8) -> tuple[U8, U8, U8]:
    """Hue, luminance and saturation of each colour.

    This is the definition that the gateware computes bit for bit. With the exact (h, l, s) of Python's
    ``colorsys.rgb_to_hls``:

    - hue is 256 * h rounded half up, modulo 256: at most 1/2 step (0.703 degrees) off, the circle closed;
    - luminance is 255 * l rounded half up: at most 1/2 step off (l is always a multiple of 1/2 step);
    - saturation is 255 * s rounded half up: at most 1/2 step off;
    - greys have hue 0 and saturation 0.

    Ties between the greatest channels go to red, then green, as in ``colorsys``.

    Parameters
    ----------
    rgb : (..., 3) uint8

    Returns
    -------
    hue, luminance, saturation : (...) uint8 each
    """
    red, green, blue = (rgb[..., axis].astype(np.int32) for axis in range(3))
    high = np.maximum(np.maximum(red, green), blue)
    low = np.minimum(np.minimum(red, green), blue)
    delta, total = high - low, high + low

    sextant = np.where(red == high, 0, np.where(green == high, 1, 2))
    turn = np.choose(sextant, (green - blue, blue - red, red - green))
    some = np.maximum(delta, 1)  # greys are set to 0 at the end
    # |turn| <= delta, so the numerator is delta to 517 * delta < 2**18 and the quotient 0 to 86.
    hue = (256 * turn + np.choose(sextant, SEXTANT_OFFSET) * delta) // (6 * some)
    hue = (hue + np.choose(sextant, SEXTANT_START)) & 255

    span = np.maximum(np.where(total <= 255, total, 510 - total), 1)
    # delta <= span, so the quotient is at most 255.
    saturation = (510 * delta + span) // (2 * span)

    grey = delta == 0
    return (
        np.where(grey, 0, hue).astype(np.uint8),
        ((total + 1) >> 1).astype(np.uint8),
        np.where(grey, 0, saturation).astype(np.uint8),
    )
