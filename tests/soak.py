"""A long run of small frames through the virtual card, with commands between them and a host that pauses now and then.

``python -m tests.soak --frames 100000``. Ends with an error where a frame is missing that the card has not counted as
dropped, where a packet was damaged or lost, or where a row is not the picture's.
"""

import argparse
import random
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

from magtrak.card import Card
from magtrak.link import Link
from magtrak.settings import LaserSwitch, Settings
from tests.support.virtual import virtual_card

WIDTH, HEIGHT, PICTURES = 32, 4, 50
FRAME_RATE_HZ = 4000
"""Of the card's time; 800 kB/s on the wire, two thirds of what it carries."""


def show(folder: Path) -> None:
    """Pictures with a line that moves to the right by half a pixel each, and their angles."""
    (folder / "pictures").mkdir()
    for number in range(PICTURES):
        image = np.full((HEIGHT, WIDTH, 3), 4.0)
        image[:, :, 1] += 200 * np.exp(-((np.arange(WIDTH) - centre(number)) ** 2) / 4)
        Image.fromarray(image.astype(np.uint8)).save(folder / "pictures" / f"{number:03}.png")
    angles = "".join(f"{number},{5 + number / 50},{5.01 + number / 50}\n" for number in range(PICTURES))
    (folder / "angles.csv").write_text("frame,angle_start_deg,angle_end_deg\n" + angles)


def centre(number: int) -> float:
    return 5 + 0.4 * (number % PICTURES)


def soak(frames: int, seed: int) -> str:
    """Runs it; gives the account in one line."""
    rng = random.Random(seed)
    settings = Settings(laser=LaserSwitch(arm=False))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        show(folder)
        options = ("--frames", folder / "pictures", "--angles", folder / "angles.csv", "--loop")
        rate = ("--frame-rate", str(FRAME_RATE_HZ))
        with virtual_card(folder / "card", *options, *rate), Link(str(folder / "card")) as link:
            card = Card(link)
            card.apply(settings)
            card.start(settings)
            numbers, dropped, commands, pauses, wrong = [], [], 0, 0, 0
            start = time.monotonic()
            for frame in card.frames():
                if frame is None:
                    continue
                numbers.append(frame.number)
                dropped.append(frame.header["dropped"])
                valid = frame.rows.valid
                off = np.abs(frame.rows.column_px - centre(frame.number)) > 0.1
                wrong += int(len(valid) != HEIGHT or (~valid | off).any())
                if len(numbers) >= frames:
                    break
                if rng.random() < 1 / 500:
                    commands += len(card.read_all(["frames", "dropped", "safety", "count"]))
                if rng.random() < 1 / 20000:
                    pauses += 1
                    time.sleep(2)
            seconds = time.monotonic() - start
            statistics = link.statistics
            card.stop()
    missing = int((np.diff(np.array(numbers)) - 1).sum())
    explained = dropped[-1] - dropped[0]
    account = (
        f"soak: {len(numbers)} frames in {seconds:.0f} s, {statistics.bytes / 1e6:.0f} MB, {commands} commands and"
        f" {pauses} pauses of 2 s between them: {missing} frames missing, {explained} of them counted as dropped by the"
        f" card; {statistics.damaged} packets damaged, {statistics.lost} lost, {card.damaged_frames} impossible frames,"
        f" {wrong} frames with a wrong row; unexplained losses: {missing - explained}"
    )
    if missing != explained or statistics.damaged or statistics.lost or card.damaged_frames or wrong:
        raise SystemExit(f"{account}\nsoak: FAILED, seed {seed}")
    return account


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=random.randrange(2**32))
    options = parser.parse_args()
    print(f"soak: seed {options.seed}", flush=True)
    print(soak(options.frames, options.seed))


if __name__ == "__main__":
    main()
