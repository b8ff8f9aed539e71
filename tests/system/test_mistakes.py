"""What users do wrong: one plain sentence each, no traceback, nothing lost that was already measured."""

import json
import signal
import subprocess
import time

import numpy as np
import pytest
from PIL import Image

from magtrak.cloud.ply import read_ply
from tests.support.virtual import BIN, refused, run, virtual_card

ANGLES = "frame,angle_start_deg,angle_end_deg\n0,10,10.1\n1,10.2,10.3\n2,10.4,10.5\n"


@pytest.fixture
def pictures(tmp_path):
    """Three small pictures with a green line, and their angles."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for number in range(3):
        image = np.full((24, 40, 3), 4, np.uint8)
        image[:, 17:22] = (30, 140, 40)
        image[:, 19] = (60, 240, 70)
        Image.fromarray(image).save(folder / f"{number}.png")
    (tmp_path / "angles.csv").write_text(ANGLES)
    return folder


@pytest.fixture
def calibration(tmp_path):
    path = tmp_path / "calibration.json"
    assert run("python", "-m", "sim.scene", "quick", "--calibration", path).returncode == 0
    return path


def show(pictures, *options):
    return run("magtrak-sim", "--frames", pictures, "--angles", pictures.parent / "angles.csv", *options, timeout_s=60)


def test_pictures_of_different_sizes(pictures):
    Image.new("RGB", (41, 24)).save(pictures / "2.png")
    message = refused(show(pictures))
    assert "2.png" in message and "41 x 24" in message and "40 x 24" in message


def test_a_picture_that_is_none(pictures):
    (pictures / "1.png").write_bytes(b"\x89PNG\r\n\x1a\n nothing of the kind")
    assert "1.png" in refused(show(pictures))


def test_a_folder_without_pictures(pictures, tmp_path):
    assert "no picture" in refused(run("magtrak-sim", "--frames", tmp_path, "--angles", tmp_path / "angles.csv"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ANGLES.replace("1,10.2,10.3\n", ""), ["frame 1", "missing"]),
        (ANGLES + "2,10,10\n", ["frame 2", "line 5"]),
        (ANGLES.replace("10.3", "x"), ["'x'", "line 3"]),
        (ANGLES + "7,1,1\n", ["frame 7"]),
        ("a,b,c\n", ["header"]),
        ("", ["header"]),
    ],
)
def test_angles_that_do_not_fit_the_pictures(pictures, text, words):
    (pictures.parent / "angles.csv").write_text(text)
    message = refused(show(pictures))
    assert "angles.csv" in message
    for word in words:
        assert word in message, message


def test_rows_that_take_longer_than_a_picture(pictures):
    assert "longer than" in refused(show(pictures, "--frame-rate", "100", "--row-time", "1000"))


def test_a_link_that_is_a_file(pictures, tmp_path):
    (tmp_path / "card").write_text("precious")
    assert "exists already" in refused(show(pictures, "--link", tmp_path / "card"))
    assert (tmp_path / "card").read_text() == "precious"


def test_a_port_that_is_not_there(calibration, tmp_path):
    done = run("magtrak-recv", "--port", "/dev/nowhere", "--calibration", calibration, "--output", tmp_path / "c.ply")
    assert "/dev/nowhere" in refused(done)


def test_a_port_that_is_no_card(calibration, tmp_path):
    silent = tmp_path / "silent"
    code = f"import os, pty, time; m, s = pty.openpty(); os.symlink(os.ttyname(s), {str(silent)!r}); time.sleep(60)"
    process = subprocess.Popen([BIN / "python", "-c", code])
    try:
        while not silent.is_symlink():
            time.sleep(0.02)
        done = run("magtrak-recv", "--port", silent, "--calibration", calibration, "--output", tmp_path / "c.ply")
        assert "does not answer as a Magtrak card" in refused(done)
    finally:
        process.kill()
        process.wait()


def test_no_calibration(tmp_path):
    done = run("magtrak-recv", "--port", "x", "--calibration", tmp_path / "no.json", "--output", tmp_path / "c.ply")
    assert "no.json" in refused(done)


@pytest.mark.parametrize(
    ("path", "value", "name"),
    [
        (["format"], "other", "format"),
        (["version"], 2, "version"),
        (["camera", "model"], "fisheye", "camera.model"),
        (["camera", "width"], "wide", "camera.width"),
        (["camera", "matrix"], [[1, 2], [3, 4]], "camera.matrix"),
        (["camera", "distortion"], [1, 2, 3], "camera.distortion"),
        (["camera", "time_offset_s"], "late", "camera.time_offset_s"),
        (["laser", "camera_from_laser"], [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "camera_from_laser"),
        (["laser", "offset_mm"], None, "laser.offset_mm"),
        (["laser", "tilt_rad"], "x", "laser.tilt_rad"),
        (["laser", "zero_rad"], [], "laser.zero_rad"),
        (["laser", "sense"], 0, "laser.sense"),
        (["laser", "counts_per_turn"], -4, "laser.counts_per_turn"),
    ],
)
def test_each_field_of_a_calibration_is_checked(calibration, tmp_path, path, value, name):
    values = json.loads(calibration.read_text())
    at = values
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    calibration.write_text(json.dumps(values))
    message = refused(run("magtrak-recv", "--port", "x", "--calibration", calibration, "--output", tmp_path / "c.ply"))
    assert name in message and "calibration.json" in message, message


def test_ctrl_c_in_the_middle_writes_the_cloud(calibration, tmp_path):
    link, cloud = tmp_path / "card", tmp_path / "cloud.ply"
    with virtual_card(link, "--scene", "quick", "--loop"):
        command = [BIN / "magtrak-recv", "--port", link, "--calibration", calibration, "--output", cloud]
        receiver = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        time.sleep(6)
        receiver.send_signal(signal.SIGINT)
        out, errors = receiver.communicate(timeout=60)
    assert receiver.returncode == 0, errors
    assert "Traceback" not in errors
    points = read_ply(cloud)
    assert len(points) > 100
    assert f"{len(points)} points" in out


def test_a_card_that_goes_away_leaves_the_cloud(calibration, tmp_path):
    link, cloud = tmp_path / "card", tmp_path / "cloud.ply"
    with virtual_card(link, "--scene", "quick", "--loop") as card:
        command = [BIN / "magtrak-recv", "--port", link, "--calibration", calibration, "--output", cloud]
        receiver = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        time.sleep(6)
        card.kill()
        _, errors = receiver.communicate(timeout=60)
    assert "Traceback" not in errors
    assert len(read_ply(cloud)) > 100
