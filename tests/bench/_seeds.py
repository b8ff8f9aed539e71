"""Benchmarks of whole sessions, by seeds: ``SEEDS=2,3 python -m tests.bench …``; 1 unless told otherwise."""

import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from tests.bench import Figure

SEEDS = tuple(int(seed) for seed in os.environ.get("SEEDS", "1").split(","))


def by_seeds(one: Callable[[int, Path], Iterator[Figure]]) -> Iterator[Figure]:
    """What ``one`` measures with each seed, in a folder of its own that goes away."""
    # One thread: matrices of three columns are no work to share, and the card needs the other processor.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for seed in SEEDS:
        with tempfile.TemporaryDirectory() as name:
            for figure in one(seed, Path(name)):
                yield replace(figure, what=f"seed {seed}: {figure.what}")
