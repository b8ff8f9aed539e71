"""What can happen to a link, on the compiled card: a reset, a host that does not read, snapshots on a full line."""

import random

import numpy as np
import pytest

from gateware.link.gap import OVERDUE_CLOCKS
from magtrak import protocol
from magtrak.frames import decode_frame
from magtrak.protocol import SNAPSHOT, AnswerCode, Deframer, SnapshotSource, register
from magtrak.reference import gate, mix, snapshot, weight, words_from_luts
from tests.support.card_link import CardLink


def random_image(seed: int, rows: int = 12, columns: int = 64) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (rows, columns, 3), dtype=np.uint8)


@pytest.fixture
def cards():
    """Makes cards, and frees them."""
    made = []

    def make(*arguments, **options) -> CardLink:
        made.append(CardLink(*arguments, **options))
        return made[-1]

    yield make
    for card in made:
        card.close()


@pytest.mark.parametrize("seed", range(4))
def test_a_reset_in_the_middle_of_a_frame_costs_that_frame(cards, seed):
    """The host's decoder goes on where it was: what the new card sends is all there."""
    print("seed", seed)
    rng = random.Random(seed)
    line = Deframer()
    old = cards(0.05, line)
    old.write("run", 1)
    for number in range(3):
        old.show(random_image(number))
    until = old.core.clock + rng.randrange(200, 8000)
    while old.core.clock < until or not line.within_packet:
        old.run(37)
    whole, damaged = len(old.frames), line.damaged
    assert damaged == 0

    new = cards(0.05, line)
    assert new.read("frames") == 0
    assert line.damaged == 1, "the frame that was cut off"
    assert new.write("run", 1) == AnswerCode.DONE
    new.show(random_image(9))
    new.settle()
    assert [decode_frame(payload).number for payload in new.frames] == [0]
    assert line.damaged == 1
    assert len(old.frames) == whole


def test_a_host_that_does_not_read_gets_the_newest_image_next(cards):
    card = cards(0.5)
    card.write("run", 1)
    card.reading = False
    images = [random_image(number, rows=40) for number in range(30)]
    for image in images:
        card.show(image)
    card.reading = True
    card.settle()
    frames = [decode_frame(payload) for payload in card.frames]
    numbers = [frame.number for frame in frames]
    assert numbers[-1] == 29, "the newest"
    assert len(numbers) + card.read("dropped") == card.read("frames") == 30
    # Those before it were under way when the line's own buffer was full; nothing stale lies between.
    assert numbers[:-1] == list(range(len(numbers) - 1))
    assert frames[-1].header["dropped"] == 30 - len(numbers)
    assert card.deframer.damaged == 0


def luts_for(card: CardLink, seed: int) -> np.ndarray:
    """Random gate tables, loaded."""
    luts = np.random.default_rng(seed).integers(0, 4, (3, 256)) > 0
    for name, words in zip(("lut_hue", "lut_luminance", "lut_saturation"), words_from_luts(luts), strict=True):
        for number, word in enumerate(words):
            assert card.write(name, word, number) == AnswerCode.DONE
    return luts


@pytest.mark.parametrize("source", SnapshotSource)
def test_a_snapshot_shows_what_the_card_sees(cards, source):
    """Raw picture, gate and weight of a moving scene: each piece is of the image that it names."""
    card = cards()
    luts = luts_for(card, 3)
    card.write("commit", 7)
    card.write("run", 1)
    region = {"column_first": 5, "column_last": 190, "row_first": 1, "row_last": 4095, "step": 1 + source}
    for name, value in region.items():
        card.write(f"snapshot_{name}", value)
    card.write("snapshot_source", source)
    card.write("snapshot", 77)
    images = [random_image(number, rows=9, columns=200) for number in range(40)]
    for image in images:
        card.show(image)
    card.settle(quiet=OVERDUE_CLOCKS + 4000)
    assert card.read("snapshot_busy") == 0

    settings = {name: register(name).init for name in ("weight_r", "weight_g", "weight_b", "floor")}
    pictures = {
        SnapshotSource.RAW: lambda image: image,
        SnapshotSource.GATE: lambda image: 255 * gate(image, luts).astype(np.uint8),
        SnapshotSource.WEIGHT: lambda image: weight(mix(image, settings), settings),
    }
    wanted = snapshot(pictures[source](images[0]), (5, 190), (1, 4095), 1 + source)
    assert len(card.pieces) == len(wanted)
    for payload, piece in zip(card.pieces[:-1], wanted, strict=False):
        header = SNAPSHOT.unpack(payload[: SNAPSHOT.size])
        facts = {"generation": 7, "number": 77, "source": source, "row": piece.row, "column": piece.column, "flags": 0}
        assert header.items() >= facts.items()
        pixels = np.frombuffer(payload[SNAPSHOT.size :], np.uint8).reshape(piece.pixels.shape)
        shown = pictures[source](images[header["frame"]])
        columns = piece.column + (1 + source) * np.arange(len(piece.pixels))
        assert np.array_equal(pixels, shown[piece.row, columns])
    assert len(card.frames) == len(images)


def test_snapshots_on_a_full_line_cost_no_frame_and_change_none(cards):
    """Frames take 94 % of the line; a snapshot of the whole image goes between them."""
    rows, columns, row_clocks, byte_clocks, count = 100, 200, 216, 12, 60
    frame_bytes = protocol.FRAME.size + rows * protocol.FULL_ROW.size + 9
    assert 0.93 < frame_bytes * byte_clocks / (rows * row_clocks + 160) < 0.95
    results = []
    for number in (0, 1):
        card = cards(1.0001 / byte_clocks)
        card.write("run", 1)
        card.write("snapshot", number)
        for n in range(count):
            card.show(random_image(n % 3, rows, columns), row_clocks)
        assert card.read("dropped") == 0
        card.settle(quiet=OVERDUE_CLOCKS + 40_000)
        results.append((card.frames, card.pieces))
    (alone, none), (beside, pieces) = results
    assert none == []
    assert len(pieces) >= 1  # when the images are over, at the latest
    assert len(alone) == len(beside) == count
    for before, after in zip(alone, beside, strict=True):
        size = protocol.FRAME.size
        assert decode_frame(before).header["rows"] == rows
        assert before[size:] == after[size:]
