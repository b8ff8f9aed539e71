"""The whole chain on small pictures: scene, camera, gateware, serial port, receiver, cloud, against the truth.

The scene ``quick`` has 160 x 120 pixels, f = 200 px, at 2 m: a pixel is 10 mm wide there, and a hundredth of a
pixel in the image about 0.4 mm in depth. ``make scan`` and ``make bench`` show what a VGA camera reaches.
"""

import math

import pytest

from tests.support.scan import judged_scan


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return judged_scan(tmp_path_factory.mktemp("scan"), "quick", "--speckle", "0")


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    return judged_scan(
        tmp_path_factory.mktemp("paper"),
        "quick",
        "--speckle",
        "0",
        settings='[peak]\ndetector = "binary"\n',
        receiver=("--angle", "bare"),
    )


def test_points_lie_on_the_surfaces(scan):
    print(f"clean {scan.clean}, edge {scan.edge}")
    assert scan.clean.points > 1000
    assert scan.clean.rms < 1.8


def test_no_points_from_nothing(scan):
    assert scan.dark_share <= 0.001


def test_lit_rows_give_points(scan):
    assert scan.found_share >= 0.98


def test_every_row_has_its_angle(scan):
    counts = scan.angle_rms_rad * scan.counts_per_turn / (2 * math.pi)
    print(f"angle error {counts:.4f} counts RMS")
    assert counts < 0.05


def test_the_paper_is_beaten(scan, paper):
    print(f"paper {paper.clean}")
    assert paper.clean.points > 1000
    assert paper.clean.rms > 10 * scan.clean.rms
