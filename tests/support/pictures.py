"""Real pictures by others, read where they are; the project holds no copies of them.

They lie in ``shared/data`` beside the checkout, or where ``MAGTRAK_DATA`` says. Sources:

- ``board_distances``: github.com/B33Boy/3D-Scanner, commit 163efb14 (MIT)
- ``laser_on_off``: github.com/chrisspen/laser-range-finder, commit 77a8060d (MIT)
"""

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("MAGTRAK_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def folder(name: str) -> Path:
    """The folder of a set; skips the test, in one line, where it is missing."""
    path = DATA / name
    if not path.is_dir():
        pytest.skip(f"the real pictures '{name}' are not on this machine (set MAGTRAK_DATA)")
    return path
