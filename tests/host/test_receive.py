"""``magtrak-recv`` as a user runs it."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magtrak import protocol
from magtrak.calibration import Calibration
from magtrak.cloud.ply import read_ply
from magtrak.protocol import Phase
from tests.support.calibrations import example_calibration
from tests.support.fake_card import FakeCard
from tests.support.frames import Recorder, in_phase

WALL_MM = 2000.0
FRAMES = 20


def movement(t: np.ndarray) -> np.ndarray:
    return np.asarray(200 + 250 * t)


def wall(frames: int = FRAMES, **header: int) -> list[bytes]:
    """A wall square to the optical axis, seen by the example's camera and lit by its laser."""
    calibration = Calibration.parse(example_calibration())
    recorder = Recorder(movement)

    def columns(number: int) -> np.ndarray:
        alpha = calibration.laser.alpha(movement(recorder.row_times(number)))
        x = -500 + WALL_MM * np.tan(alpha)
        return np.asarray(80 * x / WALL_MM + 31.5)

    return recorder.payloads(frames, columns, **header)


class Receiver:
    """Runs the command in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cloud = folder / "cloud.ply"
        self.calibrate(example_calibration())

    def calibrate(self, values: dict[str, Any]) -> None:
        (self.folder / "rig.json").write_text(json.dumps(values))

    def command(self, port: str, *more: str) -> list[str]:
        options = {"--port": port, "--calibration": "rig.json", "--output": "cloud.ply"}
        given = [part for pair in options.items() if pair[0] not in more for part in pair]
        program = "import sys; sys.argv[0] = 'magtrak-recv'; from magtrak.cli.recv import main; main()"
        return [sys.executable, "-W", "error", "-c", program, *given, *more]

    def run(self, port: str, *more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.command(port, *more), cwd=self.folder, capture_output=True, text=True, timeout=60, check=False
        )

    def fails(self, port: str, *more: str) -> str:
        """What it says when it fails: one sentence, on standard error."""
        done = self.run(port, *more)
        assert done.returncode == 1, done
        assert re.fullmatch(r"magtrak-recv: [^\n]+\n", done.stderr), done.stderr
        return done.stderr


@pytest.fixture
def receiver(tmp_path: Path) -> Receiver:
    return Receiver(tmp_path)


def test_a_wall_is_where_it_is(receiver: Receiver) -> None:
    with FakeCard(wall()) as card:
        done = receiver.run(card.port, "--picture", "cloud.png")
    assert (done.returncode, done.stderr) == (0, "")
    summary = "20 frames, 960 points, 0 lost frames (0 dropped by the card), 0 damaged packets, 0 encoder errors"
    rates = r", [0-9.]+ frames/s at [0-9]+ kB/s, (frames late by [0-9.]+ ms \(median\), )?answers in [0-9.]+ ms\n"
    assert re.fullmatch(re.escape(summary) + rates, done.stdout)
    cloud = read_ply(receiver.cloud)
    # Columns are rounded to 1/256 px, which is 0.2 mm here.
    assert np.abs(cloud["z"] - WALL_MM).max() < 0.25
    assert np.array_equal(cloud["scalar_frame"], np.repeat(np.arange(20), 48))
    assert np.array_equal(cloud["scalar_row"], np.tile(np.arange(48), 20))
    times = np.concatenate([Recorder(movement).row_times(n) for n in range(20)])
    assert np.abs(cloud["scalar_time"] - (times - times[0])).max() < 1e-7
    assert np.abs(cloud["scalar_angle"] - 2 * np.pi * movement(times) / 8192).max() < 1e-6
    assert np.allclose(cloud["intensity"], 200 / 255)
    assert np.allclose(cloud["scalar_width"], 6)
    assert (receiver.folder / "cloud.png").read_bytes().startswith(b"\x89PNG")
    # Laser off, motor off, no more frames: at the end of a stream nobody is left to be told, before it somebody is.
    with FakeCard(wall(), loop_for_ever=True) as card:
        done = receiver.run(card.port, "--frames", "5")
        assert done.returncode == 0
        assert card.written[-3:] == [("laser_arm", 0), ("motor_mode", 0), ("run", 0)]
    assert done.stdout.startswith("5 frames, 240 points, ")


def test_backgrounds_give_no_points_but_their_edges(receiver: Receiver) -> None:
    phases = [Phase.UNSUBTRACTED, Phase.SKIPPED, Phase.BACKGROUND, Phase.SKIPPED] + [
        Phase.MEASURED,
        Phase.SKIPPED,
        Phase.BACKGROUND,
        Phase.SKIPPED,
    ] * 4
    payloads = [in_phase(payload, phase) for payload, phase in zip(wall(), phases, strict=True)]
    for bare in ("rows", "bare"):
        with FakeCard(payloads) as card:
            done = receiver.run(card.port, "--angle", bare)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith("20 frames, 192 points, 0 lost frames")
        assert done.stdout.endswith("15 frames of background, 1 frames before the first background\n")
        cloud = read_ply(receiver.cloud)
        assert np.array_equal(cloud["scalar_frame"], np.repeat([4, 8, 12, 16], 48))
        if bare == "rows":  # frame 8's curve needs the edges of 7 and 9
            times = np.concatenate([Recorder(movement).row_times(n) for n in (4, 8, 12, 16)])
            assert np.abs(cloud["scalar_angle"] - 2 * np.pi * movement(times) / 8192).max() < 1e-6
    with FakeCard(payloads[:4]) as card:
        done = receiver.run(card.port)
    assert "no frame had a background to subtract" in done.stderr


def test_bare_angles_are_visibly_worse(receiver: Receiver) -> None:
    with FakeCard(wall()) as card:
        assert receiver.run(card.port, "--angle", "bare").returncode == 0
    cloud = read_ply(receiver.cloud)
    assert len(set(cloud["scalar_angle"][:48])) == 1
    assert np.abs(cloud["z"] - WALL_MM).max() > 5


def test_it_ends_after_so_many_seconds(receiver: Receiver) -> None:
    with FakeCard(wall(5), loop_for_ever=True) as card:
        start = time.monotonic()
        done = receiver.run(card.port, "--seconds", "0.7")
        assert done.returncode == 0
        assert 0.7 < time.monotonic() - start < 40
    assert done.stdout.startswith("5 frames, 240 points")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_writes_the_cloud_so_far(receiver: Receiver, number: signal.Signals) -> None:
    with FakeCard(wall(), frame_s=0.01, loop_for_ever=True) as card:
        process = subprocess.Popen(receiver.command(card.port), cwd=receiver.folder, stdout=subprocess.PIPE, text=True)
        until = time.monotonic() + 20
        while card.value("run") == 0 and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(0.4)
        process.send_signal(number)
        out, _ = process.communicate(timeout=60)
        assert process.returncode == 0
        assert card.value("run") == 0
    frames = int(out.split()[0])
    assert frames == FRAMES
    assert len(read_ply(receiver.cloud)) == 48 * frames


def test_lost_frames_leave_a_gap_and_are_counted(receiver: Receiver) -> None:
    payloads = wall()
    del payloads[7:9]
    head = protocol.FRAME.unpack(payloads[-1][: protocol.FRAME.size])
    payloads[-1] = protocol.FRAME.pack({**head, "dropped": 1}) + payloads[-1][protocol.FRAME.size :]
    with FakeCard(payloads[2:]) as card:
        done = receiver.run(card.port)
    assert done.stdout.startswith("16 frames, 768 points, 2 lost frames (1 dropped by the card)")
    cloud = read_ply(receiver.cloud)
    assert sorted(set(cloud["scalar_frame"])) == [*range(5), *range(7, 18)]
    assert np.abs(cloud["z"] - WALL_MM).max() < 0.5


def test_a_card_stopped_within_a_packet_costs_that_packet(receiver: Receiver) -> None:
    with FakeCard(wall(), cut_after=10) as card:
        done = receiver.run(card.port)
    assert done.returncode == 1
    assert "closed in the middle of a packet" in done.stderr
    assert "the cloud so far is in cloud.ply" in done.stderr
    assert done.stdout.startswith("10 frames, 480 points")
    assert len(read_ply(receiver.cloud)) == 480


def test_frames_without_index_give_no_points_and_it_says_so(receiver: Receiver) -> None:
    with FakeCard(wall(flags=0)) as card:
        done = receiver.run(card.port)
    assert done.returncode == 0
    assert done.stdout.rstrip().endswith("20 frames before the index")
    assert "the cloud is empty; the index was never passed" in done.stderr
    assert len(read_ply(receiver.cloud)) == 0


def test_a_card_that_was_reset_is_noticed(receiver: Receiver) -> None:
    payloads = wall()
    with FakeCard(payloads[5:9] + payloads[:3]) as card:
        done = receiver.run(card.port)
    assert done.returncode == 1
    assert "the card was reset during the scan" in done.stderr
    assert len(read_ply(receiver.cloud)) == 4 * 48


def test_least_quality_leaves_points_out_and_counts_them(receiver: Receiver) -> None:
    payloads = wall(4)
    full, size = protocol.FULL_ROW, protocol.FULL_ROW.size
    row = full.unpack(payloads[2][-size:])
    payloads[2] = payloads[2][:-size] + full.pack({**row, "ambiguous": 1})
    with FakeCard(payloads) as card:
        done = receiver.run(card.port, "--min-quality", "0.5")
    assert done.stdout.startswith("4 frames, 191 points")
    assert done.stdout.rstrip().endswith("1 points below the least quality")


def test_what_users_get_wrong_before_the_scan(receiver: Receiver) -> None:
    assert "port ./none does not exist" in receiver.fails("./none")
    assert "calibration no.json does not exist" in receiver.fails("./none", "--calibration", "no.json")
    assert "settings 'blue' are not known" in receiver.fails("./none", "--settings", "blue")
    assert "there is no folder" in receiver.fails("./none", "--output", "nowhere/cloud.ply")
    assert "is a folder" in receiver.fails("./none", "--output", ".")
    values = example_calibration()
    values["laser"]["sense"] = 2
    receiver.calibrate(values)
    assert "rig.json: laser.sense is 2; it must be 1 or -1" in receiver.fails("./none")
    assert not receiver.cloud.exists()


def test_settings_against_the_calibration(receiver: Receiver) -> None:
    (receiver.folder / "mine.toml").write_text("[encoder]\ncounts_per_turn = 2000\n")
    said = receiver.fails("./none", "--settings", "mine.toml")
    assert "mine.toml: encoder.counts_per_turn is 2000, the calibration has 8192" in said


def test_pictures_of_another_size_than_the_calibrations(receiver: Receiver) -> None:
    receiver.calibrate(example_calibration(width=128))
    with FakeCard(wall()) as card:
        said = receiver.run(card.port).stderr
    assert "the calibration is for pictures of 128 x 48, the card sends 64 columns" in said


def test_a_device_that_is_no_card(receiver: Receiver) -> None:
    master, slave = pty.openpty()
    try:
        said = receiver.fails(os.ttyname(slave))
    finally:
        os.close(master)
        os.close(slave)
    assert "does not answer as a Magtrak card" in said or "no Magtrak packets" in said


def test_usage_errors_are_click_s(receiver: Receiver) -> None:
    done = receiver.run("./none", "--frames", "0")
    assert done.returncode == 2
    assert "Invalid value for '--frames'" in done.stderr


def test_progress_is_shown_on_a_terminal(receiver: Receiver) -> None:
    master, slave = pty.openpty()
    with FakeCard(wall(), frame_s=0.05) as card:
        process = subprocess.Popen(
            receiver.command(card.port), cwd=receiver.folder, stdout=subprocess.DEVNULL, stderr=slave
        )
        os.close(slave)
        shown = b""
        try:
            while chunk := os.read(master, 4096):
                shown += chunk
        except OSError:
            pass  # Linux's way to say that the other side has closed
        assert process.wait(timeout=60) == 0
    os.close(master)
    assert re.search(rb"\d+\.\d s  \d+ frames  \d+ points  0 lost  0 damaged", shown)
    assert shown.endswith(b"\r\x1b[K")
