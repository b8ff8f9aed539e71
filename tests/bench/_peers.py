"""What people do in software, row by row, with the thresholds published with it. NaN where nothing is found.

Each is written from its description. The peers read the same pixels as the card.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Pixels = NDArray[np.uint8]


def hls_in_range(rows: Pixels) -> Floats:
    """OpenCV: ``cvtColor`` to HLS, ``inRange``, then the centroid of the mask, weighted by the red channel.

    Thresholds for a red laser from the OpenCV forum, question 209190: hue 0 to 10 or 160 to 179, saturation and value
    at least 100. A pure colour's luminance is half its value.
    """
    hls = cv2.cvtColor(rows, cv2.COLOR_RGB2HLS)
    mask = cv2.inRange(hls, (0, 50, 100), (10, 255, 255)) | cv2.inRange(hls, (160, 50, 100), (179, 255, 255))
    return _centroid(np.where(mask > 0, rows[..., 0], 0))


def horus(rows: Pixels) -> Floats:
    """The way of the Horus scanner (bqlabs), as its user interface describes it, with its defaults.

    The red channel; pixels of less than 50 are removed; so are those more than 8 columns from the brightest that is
    left; centroid of the rest.
    """
    red = rows[..., 0]
    return _windowed(np.where(red >= 50, red, 0))


def horus_blurred(rows: Pixels) -> Floats:
    """Horus with its default blur, a box of 5 px, along the row only: rows here know nothing of each other."""
    red = rows[..., 0]
    return _windowed(cv2.blur(np.where(red >= 50, red, np.uint8(0)), (5, 1)))


PEERS = {"HLS inRange": hls_in_range, "Horus": horus, "Horus, blur": horus_blurred}


def _windowed(grey: NDArray[np.integer]) -> Floats:
    near = np.abs(np.arange(grey.shape[1]) - grey.argmax(axis=1)[:, None]) <= 8
    return _centroid(np.where(near, grey, 0))


def _centroid(weight: NDArray[np.integer]) -> Floats:
    total = weight.sum(axis=1, dtype=np.float64)
    moment = (weight * np.arange(weight.shape[1], dtype=np.float64)).sum(axis=1)
    return np.divide(moment, total, out=np.full(len(total), np.nan), where=total > 0)
