"""What a camera's bus leaves of the colours."""

import numpy as np
import numpy.typing as npt


def rgb565(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """RGB of 8 bits a channel as it comes out of the card's input for RGB565.

    5 bits of red and blue and 6 of green are left, and their upper bits repeated below them, so that black stays 0
    and white 255.

    Parameters
    ----------
    image : (..., 3) uint8
    """
    red, green, blue = image[..., 0] & 0xF8, image[..., 1] & 0xFC, image[..., 2] & 0xF8
    return np.stack([red | red >> 5, green | green >> 6, blue | blue >> 5], axis=-1)
