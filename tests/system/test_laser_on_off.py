"""Ten pairs of real pictures of a furnished room, laser on and off, through the virtual card.

The room is lit, and holds red things and lamps. Where the line is follows from the difference of a pair. At first the
card does not get it: it has to find the line in the lit picture alone, and to say where it cannot be sure. Then it gets
both pictures, as a camera gives them whose laser alternates, and subtracts what its memory holds of the dark one.
"""

from importlib import resources

import numpy as np
import pytest
from PIL import Image

from sim.quantise import rgb565
from tests.support.pictures import folder
from tests.support.virtual import ambiguous, measured_pictures

PAIRS = range(1, 11)
CLEAR = 25
"""Grey levels by which the laser has to brighten a row somewhere, for its place to be sure."""
NEAR_PX = 4


def pair(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Laser off, laser on."""
    return picture(f"sample{number}-a-0.jpg"), picture(f"sample{number}-b-0.jpg")


def picture(name: str) -> np.ndarray:
    """The line is nearly level in the pictures; transposed, each row crosses it."""
    with Image.open(folder("laser_on_off") / name) as file:
        return np.asarray(file.convert("RGB")).transpose(1, 0, 2).astype(float)


def line(off: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Column of the line in each row; -1 where nothing or not one place stands out.

    The exposure differs within a pair: what counts is how much redder a pixel became, and a third of how much brighter.
    """
    redder = (on - off) @ [1.0, -0.5, -0.5]
    brighter = (on - off).sum(axis=2)
    lit = np.clip(redder, 0, None) + np.clip(brighter, 0, None) / 3
    smooth = np.apply_along_axis(np.convolve, 1, lit, np.full(5, 0.2), "same")
    column = smooth.argmax(axis=1)
    greatest = smooth.max(axis=1)
    elsewhere = np.abs(np.arange(smooth.shape[1]) - column[:, None]) > 12
    second = np.where(elsewhere, smooth, 0).max(axis=1)
    return np.where((greatest > CLEAR) & (greatest > 2 * second), column, -1)


def measured(path, images: list[np.ndarray], settings: str) -> np.ndarray:
    """The points of the images, in order."""
    pictures = path / "pictures"
    pictures.mkdir()
    for number, image in enumerate(images):
        Image.fromarray(image.astype(np.uint8)).save(pictures / f"{number:02}.png")
    height, width = images[0].shape[:2]
    camera = {
        "model": "brown-conrady",
        "width": width,
        "height": height,
        "matrix": [[300, 0, (width - 1) / 2], [0, 300, (height - 1) / 2], [0, 0, 1]],
        "distortion": [0, 0, 0, 0, 0],
    }
    return measured_pictures(path, pictures, camera, settings)


@pytest.mark.parametrize(
    ("settings", "right_share", "sure_share", "silent_share"),
    [("red-daylight", 0.88, 0.77, 0.012), ("red", 0.80, 0.82, 0.016)],
)
def test_rows_that_are_wrong_say_so(tmp_path, settings, right_share, sure_share, silent_share):
    """Of the rows whose place is known and that gave a point: the share that is right, the share of these that is not
    flagged ambiguous, and the share that is wrong and not flagged.
    """
    pairs = [pair(number) for number in PAIRS]
    points = measured(tmp_path, [on for _, on in pairs], settings)
    truths = [line(off, on) for off, on in pairs]
    truth = np.array(truths)[points["scalar_frame"].astype(int), points["scalar_row"].astype(int)]
    known = truth >= 0
    right = np.abs(points["scalar_column"] - truth)[known] <= NEAR_PX
    flagged = ambiguous(points)[known]
    silent = ~right & ~flagged
    print(
        f"{settings}: {right.size} rows, {right.sum()} right, of these {np.sum(right & ~flagged)} not flagged;"
        f" wrong and not flagged {silent.sum()}"
    )
    assert right.size >= 1300
    assert right.mean() >= right_share
    assert (~flagged[right]).mean() >= sure_share
    assert silent.mean() <= silent_share


PRESETS = resources.files("magtrak") / "presets"


@pytest.mark.parametrize("change", [lambda image: image, rgb565], ids=["RGB888", "RGB565"])
def test_what_is_subtracted_leaves_the_line(tmp_path, change):
    """Of all rows whose place is known, those that gave no point included: the share that is right."""
    settings = tmp_path / "settings.toml"
    text = (PRESETS / "red-ambient.toml").read_text()
    assert 'mode = "skip"' in text
    settings.write_text(text.replace('mode = "skip"', 'mode = "alternate"'))
    pairs = [pair(number) for number in PAIRS]
    # The card needs two images to learn how coarse the background has to be; 320 x 240 pixels are 160 x 120 blocks.
    off, on = pairs[0]
    images = [on, off, *(image for pair in pairs for image in (on, pair[0], pair[1], pair[0]))]
    first = 2
    points = measured(tmp_path, [change(image.astype(np.uint8)) for image in images], str(settings))
    frame, row = points["scalar_frame"].astype(int), points["scalar_row"].astype(int)
    assert set(frame.tolist()) <= set(range(first, len(images), 2)), "backgrounds give no points"
    known = right = silent = 0
    for number, (off, on) in enumerate(pairs):
        truth = line(off, on)
        mine = (frame == first + 4 * number + 2) & (truth[row] >= 0)
        good = np.abs(points["scalar_column"][mine] - truth[row[mine]]) <= NEAR_PX
        known += np.sum(truth >= 0)
        right += good.sum()
        silent += np.sum(~good & ~ambiguous(points)[mine])
    print(f"red-ambient: {known} rows, {right} right; wrong and not flagged {silent}")
    assert known >= 1500
    assert right >= 0.97 * known
    assert silent <= 0.005 * known
