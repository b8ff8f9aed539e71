"""A scan in a lit room: the virtual card's laser alternates, and the light of the room is subtracted."""

import re
from pathlib import Path

import pytest

import sim
from tests.support.scan import judged_scan

SETTINGS = """
[gate]
hue = [65, 185]
luminance = [0.02, 1.0]
saturation = [0.05, 1.0]

[weight]
floor = 8

[ambient]
mode = "{mode}"
"""


@pytest.fixture(scope="module")
def lit_room(tmp_path_factory):
    """The scene ``quick`` with eight times the light."""
    text = (Path(sim.__file__).parent / "scenes" / "quick.toml").read_text()
    text, changes = re.subn(r"colour = \[14, 14, 15\]", "colour = [110, 100, 80]", text)
    assert changes == 1
    path = tmp_path_factory.mktemp("room") / "lit.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("mode", "least_dark", "most_dark", "least_points", "most_points"),
    [("off", 0.1, 1.0, 1000, 2000), ("alternate", 0.0, 0.001, 500, 700)],
)
def test_points_come_from_the_laser(tmp_path, lit_room, mode, least_dark, most_dark, least_points, most_points):
    """Without subtraction so wide a gate finds lines where none are; with it, half of the images are left."""
    scan = judged_scan(tmp_path, str(lit_room), "--speckle", "0", settings=SETTINGS.format(mode=mode))
    print(f"{mode}: clean {scan.clean}, from nothing {scan.dark_share:.4f}, found {scan.found_share:.4f}")
    assert least_dark <= scan.dark_share <= most_dark
    assert least_points <= scan.clean.points <= most_points
    assert scan.found_share >= 0.98
    assert scan.clean.rms < 2.2
