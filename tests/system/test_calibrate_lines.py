"""``magtrak calibrate lines``: pictures of a line through the virtual card into a session."""

import csv
import json

import cv2
import numpy as np

from tests.support.fake_card import FakeCard
from tests.support.frames import Recorder
from tests.support.virtual import refused, run, virtual_card

COUNTS = 8192
FRAMES, WIDTH, HEIGHT = 8, 64, 48
DEG_S = 40.0
FRAME_S, ROW_S = 0.02, 0.8 * 0.02 / HEIGHT


def test_rows_and_angles_arrive_as_they_were(tmp_path):
    (tmp_path / "laser").mkdir()
    across = np.arange(WIDTH)
    angles = ["frame,angle_start_deg,angle_end_deg"]
    for number in range(FRAMES):
        middle = 24 + 2 * number + 0.05 * np.arange(HEIGHT)[:, None]
        green = 200 * np.exp(-((across - middle) ** 2) / (2 * 1.5**2))
        picture = np.zeros((HEIGHT, WIDTH, 3))
        picture[:, :, 1] = green
        cv2.imwrite(str(tmp_path / "laser" / f"{number:02}.png"), np.round(picture))
        start = 3 + DEG_S * FRAME_S * number
        angles.append(f"{number},{start},{start + DEG_S * ROW_S * (HEIGHT - 1)}")
    (tmp_path / "angles.csv").write_text("\n".join(angles) + "\n")
    views = [{"board": "a3", "picture": "none.png", "frames": [1, 2]}, {"board": "a3", "picture": "later.png"}]
    session = {"counts_per_turn": COUNTS, "boards": {}, "views": views}
    (tmp_path / "session.json").write_text(json.dumps(session))
    options = ["--frames", tmp_path / "laser", "--angles", tmp_path / "angles.csv", "--counts-per-turn", f"{COUNTS}"]
    with virtual_card(tmp_path / "card", *options) as card:
        done = run("magtrak", "calibrate", "lines", tmp_path, "--port", tmp_path / "card", "--view", "later.png")
        assert done.returncode == 0, done.stderr
        assert card.wait(timeout=60) == 0
    assert f"{FRAMES} frames" in done.stdout
    # Frames of a further view are numbered on.
    assert json.loads((tmp_path / "session.json").read_text())["views"][1]["frames"] == list(range(3, 3 + FRAMES))
    with (tmp_path / "lines.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == FRAMES * HEIGHT
    inner = [row for row in rows if 0 < int(row["frame"]) - 3 < FRAMES - 1]
    number = np.array([int(row["frame"]) - 3 for row in inner])
    row = np.array([float(item["row"]) for item in inner])
    counts = np.array([float(item["counts"]) for item in inner])
    true = (3 + DEG_S * (FRAME_S * number + ROW_S * row)) / 360 * COUNTS
    assert np.abs(counts - true).max() < 0.02
    assert np.allclose([float(item["counts_per_s"]) for item in inner], DEG_S / 360 * COUNTS, rtol=2e-3)
    column = np.array([float(item["column_px"]) for item in inner])
    assert np.abs(column - (24 + 2 * number + 0.05 * row)).max() < 0.06
    assert {item["flags"] for item in inner} <= {"", "a"}


def test_lines_without_an_index_are_refused(tmp_path):
    (tmp_path / "session.json").write_text(json.dumps({"counts_per_turn": COUNTS, "boards": {}, "views": []}))
    payloads = Recorder(lambda t: 100.0 * t).payloads(5, flags=0)
    with FakeCard(payloads) as card:
        done = run("magtrak", "calibrate", "lines", tmp_path, "--port", card.port)
    assert "no frame has seen the index" in refused(done)
    assert not (tmp_path / "lines.csv").exists()
