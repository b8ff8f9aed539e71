"""Accuracy at 2 m: the default scene through the virtual card, beside the paper's way on the same scene."""

import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from sim.evaluate import Report
from tests.bench import Figure
from tests.support.scan import judged_scan


def scan(speckle: str, settings: str = "", receiver: tuple[str, ...] = ()) -> Report:
    with tempfile.TemporaryDirectory() as folder:
        options = ("--speckle", speckle)
        return judged_scan(Path(folder), "default", *options, settings=settings, receiver=receiver)


def run() -> Iterator[Figure]:
    with ThreadPoolExecutor(2) as pool:
        papers = '[peak]\ndetector = "binary"\n'
        paper = pool.submit(scan, "0.1", papers, ("--angle", "bare"))
        speckled = pool.submit(scan, "0.1")
        plain = pool.submit(scan, "0")
        theirs = paper.result().clean
        for name, report, limit in (("speckle 0.1", speckled.result(), 0.8), ("no speckle", plain.result(), 0.4)):
            ours = report.clean
            goal = f"at most {limit} mm"
            yield Figure(f"RMS, {name}", ours.rms, "mm", "paper's way", theirs.rms, goal, ours.rms <= limit)
            yield Figure(f"median, {name}", ours.median, "mm", "paper's way", theirs.median)
            yield Figure(f"95th percentile, {name}", ours.p95, "mm", "paper's way", theirs.p95)
            lit, dark = 100 * report.found_share, 100 * report.dark_share
            yield Figure(f"lit rows that gave a point, {name}", lit, "%", goal="at least 98 %", met=lit >= 98)
            yield Figure(f"points where nothing was lit, {name}", dark, "%", goal="at most 0.1 %", met=dark <= 0.1)
