"""``magtrak-sim`` and ``magtrak-recv`` as a user starts them, for tests of the whole chain."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from magtrak.cloud.ply import read_ply
from magtrak.rows import quality

BIN = Path(sys.executable).parent
START_S = 300.0
END_S = 60.0


@contextmanager
def virtual_card(link: Path, *options: str | Path) -> Iterator[subprocess.Popen[str]]:
    """A virtual card on the port ``link``, ended at the latest when the block is left.

    ``--pace max`` unless the options say otherwise. Its standard error is a pipe.
    """
    command = [BIN / "magtrak-sim", "--link", link, "--pace", "max", *options]
    card = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        until = time.monotonic() + START_S
        while not link.exists():
            assert card.poll() is None, f"magtrak-sim ended at once: {card.stderr.read() if card.stderr else ''}"
            assert time.monotonic() < until, f"magtrak-sim made no port in {START_S:.0f} s"
            time.sleep(0.02)
        yield card
    finally:
        if card.poll() is None:
            card.terminate()
        card.communicate(timeout=END_S)


def run(command: str, *options: str | Path, timeout_s: float = 300.0) -> subprocess.CompletedProcess[str]:
    """A command of the environment, to its end, with its output as text."""
    return subprocess.run([BIN / command, *options], capture_output=True, text=True, timeout=timeout_s, check=False)


def receive(link: Path, calibration: Path, cloud: Path, *options: str | Path) -> subprocess.CompletedProcess[str]:
    """``magtrak-recv`` until the end of the stream; it must succeed."""
    done = run("magtrak-recv", "--port", link, "--calibration", calibration, "--output", cloud, *options)
    assert done.returncode == 0, f"magtrak-recv: {done.stderr}"
    return done


FACING_PLANE = {
    "camera_from_laser": np.eye(4).tolist(),
    "offset_mm": 1000.0,
    "tilt_rad": 1.5,
    "zero_rad": 0.0,
    "sense": 1,
    "counts_per_turn": 8192,
}
"""A plane nearly Z = 1000 mm at every angle, which every ray meets: what counts are rows and columns of the points."""


def measured_pictures(path: Path, pictures: Path, camera: dict[str, Any], settings: str) -> np.ndarray:
    """The points of all pictures of a folder, through the virtual card and the receiver, on one plane.

    Each row that gave a result is a point. Leaves ``calibration.json`` in ``path``.
    """
    calibration = {"format": "magtrak-calibration", "version": 1, "camera": camera, "laser": FACING_PLANE}
    (path / "calibration.json").write_text(json.dumps(calibration))
    amount = sum(1 for file in pictures.iterdir() if file.suffix.lower() in (".png", ".jpg", ".bmp"))
    angles = "".join(f"{number},0,0\n" for number in range(amount))
    (path / "angles.csv").write_text("frame,angle_start_deg,angle_end_deg\n" + angles)
    with virtual_card(path / "card", "--frames", pictures, "--angles", path / "angles.csv") as card:
        receive(path / "card", path / "calibration.json", path / "cloud.ply", "--settings", settings)
        assert card.wait(timeout=END_S) == 0
    return read_ply(path / "cloud.ply")


def ambiguous(points: np.ndarray) -> np.ndarray:
    """Which points come from ambiguous rows: no other reason takes the quality below 0.3 of what it would be."""
    no = np.zeros(len(points), bool)
    unflagged = quality(255 * points["intensity"], points["scalar_width"], no, no, no, no)
    return points["quality"] < 0.3 * unflagged


def refused(done: subprocess.CompletedProcess[str]) -> str:
    """The one line with which a command has refused; no traceback, nothing on standard output."""
    assert done.returncode == 1, f"exit status {done.returncode}: {done.stderr}"
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    return lines[0]
