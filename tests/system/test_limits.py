"""Images at the limits, through the compiled card: as the reference says, or flagged; never wrong silently."""

import numpy as np
import pytest

from magtrak.frames import Frame
from magtrak.protocol import CAMERA_ERRORS, Detector
from magtrak.reference import ROW_DTYPE, measure
from tests.support.measured import MeasuringCard
from tests.support.vision import default_settings

DETECTORS = list(Detector)
EVERYTHING = np.ones((3, 256), bool)
GREEN = np.zeros((3, 256), bool)
GREEN[0, 60:120] = True
GREEN[1, 20:] = True
GREEN[2, 60:] = True
NEAR_PX = 1.0


@pytest.fixture
def card():
    with MeasuringCard() as made:
        yield made


def limits_image(rows: int, columns: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of all kinds in turn, and the column of the line in each, NaN where there is none."""
    rng = np.random.default_rng(seed)
    image = np.zeros((rows, columns, 3), np.uint8)
    true = np.full(rows, np.nan)
    x = np.arange(columns)
    for y in range(rows):
        kind = y % 8
        if kind == 0:  # black
            continue
        if kind == 1:  # white
            image[y] = 255
            continue
        if kind == 2:  # the greatest noise
            image[y] = 255 * rng.integers(0, 2, (columns, 3))
            continue
        if kind == 3:  # no line, but noise
            image[y] = rng.integers(0, 8, (columns, 3))
            continue
        # A line on the left border, on the right border, or anywhere, plain or over-exposed.
        places = (rng.uniform(0, 8), columns - 1 - rng.uniform(0, 8), rng.uniform(0, columns - 1))
        true[y] = places[kind % 4] if kind < 7 else rng.uniform(0, columns - 1)
        light = (1400 if kind == 7 else 180) * np.exp(-((x - true[y]) ** 2) / 4.5)
        row = rng.integers(0, 8, (columns, 3)) + light[:, None] * [0.2, 1.0, 0.25]
        image[y] = row.clip(0, 255)
    return image, true


def differing(frame: Frame, expected: np.ndarray) -> list[str]:
    """Fields in which the frame's rows are not what is expected."""
    return [
        f"{name} of row {y}"
        for name in ROW_DTYPE.names or ()
        for y in np.flatnonzero(frame.rows.raw[name] != expected[name])
    ]


def right_or_flagged(frame: Frame, expected: np.ndarray) -> None:
    """Every row that does not say ``overflow`` is the image's row of that number."""
    right = ~frame.rows.overflow
    for name in ROW_DTYPE.names or ():
        assert (frame.rows.raw[name][right] == expected[name][: len(right)][right]).all(), name


def camera_errors(frame: Frame) -> set[str]:
    said = CAMERA_ERRORS.unpack(frame.header["camera_errors"].to_bytes(CAMERA_ERRORS.size, "little"))
    return {name for name, bit in said.items() if bit}


def sound(frame: Frame, rows: int, columns: int) -> None:
    """The image kept the contract, and all of it is here."""
    assert (frame.header["rows"], frame.header["columns"], frame.header["camera_errors"]) == (rows, columns, 0)
    assert not frame.flags["camera_fault"] and not frame.flags["rows_lost"]


@pytest.mark.parametrize("isolate", [0, 3])
@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize("shape", [(16, 16), (16, 2048), (2048, 16)], ids=str)
def test_smallest_and_longest(card, shape, detector, isolate):
    image, true = limits_image(*shape, seed=1)
    for luts in (GREEN, EVERYTHING):
        settings = default_settings(detector=detector, isolate=isolate)
        card.configure(settings, luts)
        frame = card.measure(image)
        sound(frame, *shape)
        assert not differing(frame, measure(image, settings, luts))
        # Without a gate every pixel is the laser's, and all is ambiguous.
        # The filter takes rows that differ from their neighbours.
        if detector != Detector.BINARY and luts is GREEN and not isolate:
            says_what_it_does_not_know(frame, true)


def test_largest(card):
    """2048 x 2048."""
    image, true = limits_image(2048, 2048, seed=2)
    settings = default_settings()
    card.configure(settings, GREEN)
    frame = card.measure(image)
    sound(frame, 2048, 2048)
    assert not differing(frame, measure(image, settings, GREEN))
    says_what_it_does_not_know(frame, true)


def says_what_it_does_not_know(frame: Frame, true: np.ndarray) -> None:
    """A row without a flag is right, and one without a line is none or ambiguous or cut."""
    rows = frame.rows
    clear = rows.valid & ~rows.ambiguous & ~rows.cut & ~rows.overflow
    wrong = clear & ~(np.abs(rows.column_px - true) <= NEAR_PX)
    if frame.header["columns"] < 64:
        wrong[2::8] = False  # so few columns of noise now and then are a line
    assert not wrong.any(), f"rows {np.flatnonzero(wrong)} are wrong and not flagged"
    assert not rows.valid[0::8].any(), "a black row gave a result"
    inside = ~np.isnan(true) & (true > 8) & (true < frame.header["columns"] - 9)
    assert not inside.any() or clear[inside].mean() > 0.95, "lines within the image are flagged"


def test_more_than_the_card_takes(card):
    """Columns and rows beyond 2048 are left out, and both are told of."""
    settings = default_settings()
    card.configure(settings, GREEN)
    image, _ = limits_image(16, 2060, seed=4)
    frame = card.measure(image)
    assert camera_errors(frame) == {"columns"} and frame.flags["camera_fault"]
    assert frame.header["columns"] == 2048 and frame.rows.overflow.all()
    image, _ = limits_image(2060, 16, seed=5)
    frame = card.measure(image)
    assert camera_errors(frame) == {"rows"} and frame.flags["camera_fault"]
    assert frame.header["rows"] == 2048
    assert not differing(frame, measure(image[:2048], settings, GREEN))


def test_next_image_too_early(card):
    """Whatever is between two images, each one is measured or dropped whole, counted, and said to be disturbed."""
    settings = default_settings()
    card.configure(settings, GREEN)
    image, _ = limits_image(32, 64, seed=6)
    expected = measure(image, settings, GREEN)
    for gap in (0, 1, 20, 55):
        card.show(image)
        card.show(image, gap=gap)
        first, second = card.finish(2)
        sound(first, 32, 64)
        assert not first.rows.overflow[:-1].any()  # the last row is still being measured when settings may change
        assert camera_errors(second) >= {"frame_gap"} and second.flags["camera_fault"]
        for frame in (first, second):
            right_or_flagged(frame, expected)


@pytest.mark.parametrize("isolate", [0, 2])
@pytest.mark.parametrize(
    ("columns", "blanking", "row_period", "errors"),
    [
        (64, 15, 0, {"blanking"}),
        (64, 7, 0, {"blanking"}),
        (64, 1, 0, {"blanking"}),
        (16, 17, 0, {"row_period"}),
        (16, 32, 0, {"row_period"}),
        (24, 3, 0, {"blanking", "row_period"}),
        (16, 1, 0, {"blanking", "row_period"}),
    ],
)
def test_less_blanking_than_the_contract_asks_for(card, columns, blanking, row_period, errors, isolate):
    image, _ = limits_image(64, columns, seed=3)
    settings = default_settings(isolate=isolate)
    card.configure(settings, GREEN)
    expected = measure(image, settings, GREEN)
    frame = card.measure(image, blanking=blanking, row_period=row_period)
    assert camera_errors(frame) >= errors
    assert frame.flags["camera_fault"]
    assert frame.header["rows"] <= 64
    right_or_flagged(frame, expected)
    # The next image is measured as if nothing had been.
    frame = card.measure(image)
    sound(frame, 64, columns)
    assert not differing(frame, expected)
