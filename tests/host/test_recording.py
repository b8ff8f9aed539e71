"""Recordings: replayed to the same cloud, cut short anywhere, damaged."""

import errno
import io
import json
import random
import signal
import subprocess
import sys
import time
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from magtrak.cloud.ply import read_ply
from magtrak.errors import OutputError
from magtrak.receive import Limits, receive
from magtrak.replay import Recording, RecordingError, Replay, open_recording
from magtrak.scan import Scan
from tests.host.test_receive import Receiver, wall
from tests.support.calibrations import example_calibration
from tests.support.fake_card import FakeCard


@pytest.fixture
def receiver(tmp_path: Path) -> Receiver:
    return Receiver(tmp_path)


def magtrak(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    program = "import sys; sys.argv[0] = 'magtrak'; from magtrak.cli.magtrak import main; main()"
    command = [sys.executable, "-W", "error", "-c", program, *options]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=False)


def points(recording: Recording) -> np.ndarray:
    scan = Scan(recording.calibration, recording.clock_hz)
    Replay(recording).run(scan)
    return scan.cloud()


def time_zero(cloud: Path) -> datetime:
    (moment,) = (line for line in cloud.read_bytes().split(b"\n") if line.startswith(b"comment time 0 is "))
    return datetime.fromisoformat(moment.split()[-1].decode())


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording of 60 frames and the cloud made meanwhile."""
    receiver = Receiver(tmp_path_factory.mktemp("recorded"))
    with FakeCard(wall(60), frame_s=0.02) as card:
        done = receiver.run(card.port, "--record", "scan.mcap")
    assert done.returncode == 0, done.stderr
    return receiver.folder


def test_a_replay_gives_the_same_cloud_bit_by_bit(recorded: Path, tmp_path: Path) -> None:
    done = magtrak(recorded, "replay", "scan.mcap", "--output", str(tmp_path / "again.ply"))
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("60 frames, 2880 points, 0 lost frames")
    again = read_ply(tmp_path / "again.ply")
    assert again.tobytes() == read_ply(recorded / "cloud.ply").tobytes()
    # The receiver's clock heard the card's answers too, the replay's only its frames.
    assert abs(time_zero(recorded / "cloud.ply") - time_zero(tmp_path / "again.ply")) < timedelta(seconds=0.1)
    # Another calibration moves the points, and nothing else.
    values = example_calibration()
    values["laser"]["camera_from_laser"][0][3] += 10
    (tmp_path / "other.json").write_text(json.dumps(values))
    options = ("--calibration", str(tmp_path / "other.json"), "--output", str(tmp_path / "moved.ply"))
    assert magtrak(recorded, "replay", "scan.mcap", *options).returncode == 0
    moved = read_ply(tmp_path / "moved.ply")
    assert np.array_equal(moved["scalar_column"], again["scalar_column"])
    assert np.abs(moved["z"] - again["z"]).min() > 1


def test_other_programs_can_read_it(recorded: Path) -> None:
    with (recorded / "scan.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        counts = {summary.channels[n].topic: c for n, c in summary.statistics.channel_message_counts.items()}
        assert counts["/profile"] == 60 and counts["/wire"] >= 10 and counts["/status"] >= 1
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        attached = {a.name: a.data for a in reader.iter_attachments()}
    assert json.loads(attached["calibration.json"]) == example_calibration()
    assert b"[gate]" in attached["settings.toml"]


def test_a_recording_cut_short_anywhere_keeps_what_is_whole(recorded: Path, tmp_path: Path) -> None:
    data = (recorded / "scan.mcap").read_bytes()
    whole = points(open_recording(recorded / "scan.mcap"))
    path = tmp_path / "cut.mcap"
    seed = random.randrange(2**32)
    print("seed", seed)
    cuts = random.Random(seed).sample(range(len(data)), 25)
    got = []
    for size in sorted([0, 5, 8, 9, len(data) - 1, *cuts]):
        path.write_bytes(data[:size])
        try:
            recording = open_recording(path)
        except RecordingError as error:
            assert "cut short" in str(error) or "no MCAP" in str(error)
            got.append(0)
            continue
        assert recording.cut is not None
        again = open_recording(path)  # what was repaired is whole, for everybody
        assert again.cut is None
        with path.open("rb") as file:
            assert make_reader(file).get_summary() is not None
        cloud = points(again) if again.clock_hz else whole[:0]
        # The last frames' angles lean on edges that were lost with the frames after them.
        sure = max(len(cloud) - 48 * 4, 0)
        assert cloud[:sure].tobytes() == whole[:sure].tobytes()
        got.append(len(cloud))
    assert got == sorted(got) and got[-1] == len(whole)


def test_a_damaged_chunk_costs_itself_and_is_told(recorded: Path, tmp_path: Path) -> None:
    data = bytearray((recorded / "scan.mcap").read_bytes())
    data[len(data) // 2] ^= 0x10
    path = tmp_path / "scan.mcap"
    path.write_bytes(data)
    done = magtrak(tmp_path, "replay", "scan.mcap")
    assert done.returncode == 0
    assert "scan.mcap has 1 damaged parts, left out" in done.stderr
    frames = int(done.stdout.split()[0])
    assert 0 < frames < 60
    assert f"{60 - frames} lost frames" in done.stdout


def test_what_is_no_recording(tmp_path: Path) -> None:
    for content, words in ((None, "does not exist"), (b"abc", "no MCAP recording"), (b"", "no MCAP recording")):
        if content is not None:
            (tmp_path / "x.mcap").write_bytes(content)
        done = magtrak(tmp_path, "replay", "x.mcap")
        assert (done.returncode, done.stdout) == (1, "")
        assert words in done.stderr and done.stderr.count("\n") == 1


def test_a_killed_program_leaves_a_recording(receiver: Receiver) -> None:
    with FakeCard(wall(100), frame_s=0.03, loop_for_ever=True) as card:
        process = subprocess.Popen(receiver.command(card.port, "--record", "scan.mcap"), cwd=receiver.folder)
        deadline = time.monotonic() + 60
        while (sent := card.frames_sent) < 120 and time.monotonic() < deadline:
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert not (receiver.folder / "cloud.ply").exists()
    done = magtrak(receiver.folder, "replay", "scan.mcap", "--output", "cloud.ply")
    assert done.returncode == 0
    assert "scan.mcap was cut short; repaired" in done.stderr
    frames = int(done.stdout.split()[0])
    assert frames >= sent - 90, f"{frames} of {sent} frames"  # half a second, and a busy computer
    assert "0 lost frames (0 dropped by the card), 0 damaged" in done.stdout


def test_a_card_that_comes_back_is_one_scan_and_replays_the_same(receiver: Receiver, tmp_path: Path) -> None:
    link = tmp_path / "card"
    with FakeCard(wall(20), frame_s=0.01, cut_after=15) as card:
        link.symlink_to(card.port)
        command = receiver.command(str(link), "--record", "scan.mcap", "--reconnect", "10", "--frames", "25")
        process = subprocess.Popen(
            command, cwd=receiver.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        card.join()
    link.unlink()
    time.sleep(0.5)
    with FakeCard(wall(20), frame_s=0.01, loop_for_ever=True) as card:
        link.symlink_to(card.port)
        out, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert "went away; waiting 10 s for it" in errors
    assert out.startswith("25 frames, 1200 points, 0 lost frames")
    assert "1 restarts of the card" in out
    cloud = read_ply(receiver.cloud)
    assert sorted(set(cloud["scalar_frame"])) == list(range(25))
    assert (np.diff(cloud["scalar_time"].reshape(25, 48), axis=0) > 0).all()
    away = np.diff(cloud["scalar_time"].reshape(25, 48)[:, 0])[14]
    assert 0.4 < away < 10
    done = magtrak(receiver.folder, "replay", "scan.mcap", "--output", "again.ply")
    assert done.returncode == 0, done.stderr
    assert read_ply(receiver.folder / "again.ply").tobytes() == cloud.tobytes()


def test_a_full_disk_ends_the_scan_and_leaves_the_cloud(receiver: Receiver, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(io.FileIO):
        def write(self, data: Any) -> int:
            if self.tell() > 10_000:
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data)

    opened = Path.open

    def open_file(path: Path, *more: Any, **by: Any) -> Any:
        return Full(path, "wb") if path.suffix == ".mcap" else opened(path, *more, **by)

    monkeypatch.setattr(Path, "open", open_file)
    monkeypatch.chdir(receiver.folder)
    with (
        FakeCard(wall(60), frame_s=0.03) as card,
        pytest.raises(OutputError, match="No space left on device; the cloud so far"),
    ):
        receive(
            port=card.port,
            baud=3_000_000,
            calibration=Path("rig.json"),
            settings="green",
            output=Path("cloud.ply"),
            record=Path("scan.mcap"),
            limits=Limits(),
        )
    assert len(read_ply(receiver.cloud)) >= 48 * 5


def test_nothing_is_lost_that_came_before_a_limit_or_a_bad_frame(receiver: Receiver) -> None:
    payloads = wall(30)
    payloads[4] += b"\0"
    with FakeCard(payloads, loop_for_ever=True) as card:
        done = receiver.run(card.port, "--record", "scan.mcap", "--frames", "10", "--min-quality", "0.3")
    assert done.returncode == 0
    assert done.stdout.startswith("10 frames, ")
    done = magtrak(receiver.folder, "replay", "scan.mcap", "--output", "again.ply")
    assert done.stdout.startswith("10 frames, ")
    assert read_ply(receiver.folder / "again.ply").tobytes() == read_ply(receiver.cloud).tobytes()
