"""The link through the compiled card: it stalls, vanishes and comes back; pictures and settings over it."""

import contextlib
import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from magtrak import reference
from magtrak.card import Card
from magtrak.cloud.ply import read_ply
from magtrak.discover import Candidate, greet_all
from magtrak.link import Link
from magtrak.settings import LaserSwitch, Settings
from magtrak.settings_file import load_settings
from magtrak.snapshot import Area, take_snapshot
from tests.support.virtual import BIN, FACING_PLANE, refused, run, virtual_card

WIDTH, HEIGHT, PICTURES = 32, 96, 8
CAMERA = {
    "model": "brown-conrady",
    "width": WIDTH,
    "height": HEIGHT,
    "matrix": [[40, 0, 16], [0, 40, 48], [0, 0, 1]],
    "distortion": [0, 0, 0, 0, 0],
}


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with pictures of a green line on noise, their angles, and a calibration."""
    folder = tmp_path_factory.mktemp("shown")
    rng = np.random.default_rng(3)
    (folder / "pictures").mkdir()
    for number in range(PICTURES):
        image = rng.integers(0, 12, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        centre = 8 + number + np.arange(HEIGHT)[:, None] / 10
        image[:, :, 1] += (200 * np.exp(-((np.arange(WIDTH) - centre) ** 2) / 4)).astype(np.uint8)
        Image.fromarray(image).save(folder / "pictures" / f"{number}.png")
    angles = "".join(f"{number},{10 + number},{10.8 + number}\n" for number in range(PICTURES))
    (folder / "angles.csv").write_text("frame,angle_start_deg,angle_end_deg\n" + angles)
    calibration = {"format": "magtrak-calibration", "version": 1, "camera": CAMERA, "laser": FACING_PLANE}
    (folder / "rig.json").write_text(json.dumps(calibration))
    return folder


@contextlib.contextmanager
def card_at(link: Path, shown: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    pictures = ("--frames", shown / "pictures", "--angles", shown / "angles.csv", "--frame-rate", "400", "--loop")
    with virtual_card(link, *pictures, *options) as card:
        yield card


def receiver(link: Path, shown: Path, folder: Path, *options: str) -> subprocess.Popen[str]:
    files = ("--calibration", shown / "rig.json", "--output", folder / "cloud.ply")
    command = [BIN / "magtrak-recv", "--port", link, *files, *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_growth(path: Path, size: int) -> None:
    deadline = time.monotonic() + 60
    while not path.exists() or path.stat().st_size < size:
        assert time.monotonic() < deadline, f"{path} does not grow"
        time.sleep(0.05)


def test_a_host_that_stops_reading_loses_whole_frames_and_gets_the_newest_next(shown: Path, tmp_path: Path) -> None:
    with card_at(tmp_path / "card", shown, "--pace", "real"), Link(str(tmp_path / "card")) as link:
        card = Card(link)
        card.apply(Settings(laser=LaserSwitch(arm=False)))
        card.start(Settings(laser=LaserSwitch(arm=False)))
        frames = [next(filter(None, card.frames()))]

        os.kill(link.reader_pid, signal.SIGSTOP)  # nobody reads; the system holds some 64 kB
        time.sleep(6)
        os.kill(link.reader_pid, signal.SIGCONT)
        for frame in filter(None, card.frames()):
            frames.append(frame)
            if frame.header["dropped"] and frame.number > frames[0].number + 40:
                break
            assert len(frames) < 3000, "nothing was ever dropped: was the host too quick?"
        for _ in range(30):
            frames.append(next(filter(None, card.frames())))

        statistics = link.statistics
        assert (statistics.damaged, statistics.lost, card.damaged_frames) == (0, 0, 0)  # none torn, no packet missing
        assert all(len(frame.rows.row) == HEIGHT for frame in frames)
        numbers = np.array([frame.number for frame in frames])
        gaps = np.diff(numbers) - 1
        assert gaps.min() == 0 and gaps.sum() == frames[-1].header["dropped"] - frames[0].header["dropped"] > 0
        # What was under way when nobody read comes first; behind the gap comes the newest, and all after it but perhaps
        # one that came while the newest was still being sent.
        at = int(gaps.argmax())
        assert gaps[at] > 10 and gaps[:at].sum() == 0, gaps
        assert gaps[at + 1 : at + 3].sum() <= 2 and gaps[at + 3 :].sum() == 0, gaps


def test_a_killed_program_leaves_its_recording_and_a_card_that_others_can_use(shown: Path, tmp_path: Path) -> None:
    with card_at(tmp_path / "card", shown):
        process = receiver(tmp_path / "card", shown, tmp_path, "--record", str(tmp_path / "scan.mcap"))
        wait_for_growth(tmp_path / "scan.mcap", 60_000)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        done = run("magtrak", "replay", tmp_path / "scan.mcap", "--output", tmp_path / "saved.ply")
        assert done.returncode == 0, done.stderr
        assert "was cut short; repaired" in done.stderr
        assert len(read_ply(tmp_path / "saved.ply")) > 10 * HEIGHT
        assert "0 lost frames (0 dropped by the card), 0 damaged packets" in done.stdout
        # Nothing of the killed program holds the port, and the card goes on for somebody else.
        again = receiver(tmp_path / "card", shown, tmp_path, "--frames", "10", "--record", str(tmp_path / "again.mcap"))
        out, errors = again.communicate(timeout=60)
    assert again.returncode == 0, errors
    assert out.startswith("10 frames, ") and "0 lost frames" in out
    done = run("magtrak", "replay", tmp_path / "again.mcap", "--output", tmp_path / "again.ply")
    assert read_ply(tmp_path / "again.ply").tobytes() == read_ply(tmp_path / "cloud.ply").tobytes()


def test_a_card_that_vanishes_is_found_again_by_its_serial_number(shown: Path, tmp_path: Path) -> None:
    link = tmp_path / "card"
    with card_at(link, shown, "--serial", "C0FFEE") as card:
        options = ("--record", str(tmp_path / "scan.mcap"), "--reconnect", "60", "--seconds", "300")
        process = receiver(link, shown, tmp_path, *options)
        wait_for_growth(tmp_path / "scan.mcap", 60_000)
        card.kill()
    link.unlink()
    with card_at(link, shown, "--serial", "BAD"):  # another card on the same port is left alone
        time.sleep(3)
        assert process.poll() is None
    before = (tmp_path / "scan.mcap").stat().st_size
    with card_at(link, shown, "--serial", "C0FFEE"):
        wait_for_growth(tmp_path / "scan.mcap", before + 60_000)
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert errors.startswith(f"magtrak-recv: {link} went away; waiting 60 s for it") and errors.count("\n") == 1
    assert "1 restarts of the card" in out
    cloud = read_ply(tmp_path / "cloud.ply")
    assert (np.diff(cloud["scalar_time"]) >= 0).all() and np.diff(cloud["scalar_time"]).max() > 3
    done = run("magtrak", "replay", tmp_path / "scan.mcap", "--output", tmp_path / "again.ply")
    assert read_ply(tmp_path / "again.ply").tobytes() == cloud.tobytes(), done.stderr


def test_several_cards_are_told_apart_and_a_port_in_use_is_said_to_be(shown: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    with card_at(one, shown, "--serial", "1A"), card_at(two, shown, "--serial", "2B"):
        found = greet_all([Candidate(str(one)), Candidate(str(two)), Candidate(str(tmp_path / "none"))])
        assert [f.identity and f.identity.serial for f in found] == [0x1A, 0x2B, None]
        assert "does not exist" in found[2].problem
        ports = {"MAGTRAK_PORTS": f"{one}:{two}"}
        listed = run("magtrak", "list", str(one), str(two))
        assert listed.returncode == 0
        assert [line.split()[1] for line in listed.stdout.splitlines()] == ["SERIAL", "1A", "2B"]
        by_serial = subprocess.run(
            [BIN / "magtrak", "info", "--port", "2b"],
            env=os.environ | ports,
            capture_output=True,
            text=True,
            check=False,
        )
        assert by_serial.returncode == 0, by_serial.stderr
        assert f"{two}\nserial number  2B" in by_serial.stdout
        with Link(str(one)):
            said = refused(run("magtrak", "info", "--port", one))
            assert re.search(rf"another program has it open, \S+ \({os.getpid()}\); close that first", said), said


def test_settings_and_registers_by_command(shown: Path, tmp_path: Path) -> None:
    link = tmp_path / "card"
    with card_at(link, shown):
        done = run("magtrak", "set", "floor=33", "peak.detector=binary", "laser_lease_ms=700", "--port", link)
        assert done.returncode == 0, done.stderr
        words = [line.split() for line in done.stdout.splitlines()]
        # No image comes yet: in force is what was, and what waits is said.
        assert words[0] == ["floor", "20", "grey", "levels", "33", "pending:", "no", "image", "comes"]
        assert words[2] == ["laser_lease_ms", "700", "ms"]
        assert run("magtrak", "set", "run=1", "--port", link).returncode == 0
        done = run("magtrak", "get", "floor", "detector", "generation", "laser_lease_ms", "--port", link)
        assert [line.split()[1] for line in done.stdout.splitlines()] == ["33", "0", "1", "700"]
        done = run("magtrak", "set", "gate.hue=[10, 40]", "run_reach=3", "--port", link)
        assert [line.split() for line in done.stdout.splitlines()] == [
            ["lut_hue", "table", "written"],
            ["run_reach", "3", "px"],
        ]
        watched = run("magtrak", "watch", "--seconds", "2", "--port", link)
        assert watched.returncode == 0 and "frames/s" in watched.stdout
        assert "'fair'" in refused(run("magtrak", "set", "peak.detector=fair", "--port", link))
        assert "no register is called 'x'" in refused(run("magtrak", "get", "x", "--port", link))


def test_snapshots_are_what_the_card_sees(shown: Path, tmp_path: Path) -> None:
    pictures = [np.asarray(Image.open(shown / "pictures" / f"{number}.png")) for number in range(PICTURES)]
    link = tmp_path / "card"
    with card_at(link, shown):
        with Link(str(link)) as opened:
            card = Card(opened)
            chosen = load_settings("green")
            card.apply(chosen)
            raw = take_snapshot(card, "raw", Area())
            assert raw.picture.shape == (HEIGHT, WIDTH, 3) and raw.faults == 0
            # Each row is of one image.
            assert all(any(np.array_equal(raw.picture[row], p[row]) for p in pictures) for row in range(HEIGHT))
            part = take_snapshot(card, "raw", Area(5, 30, 10, 80, 3))
            assert part.picture.shape == (24, 9, 3)
            assert all(any(np.array_equal(part.picture[i], p[10 + 3 * i, 5:31:3]) for p in pictures) for i in range(24))
            weight = take_snapshot(card, "weight", Area())
            values = {name: words[0] for name, words in chosen.register_values(1e6)}
            made = [reference.weight(reference.mix(picture, values), values) for picture in pictures]
            assert all(any(np.array_equal(weight.picture[row], m[row]) for m in made) for row in range(HEIGHT))
            gate = take_snapshot(card, "gate", Area())
            assert set(np.unique(gate.picture)) == {0, 255}
            assert card.read("run") == 0
            assert opened.statistics.lost == 0
        done = run("magtrak", "snapshot", "-o", tmp_path / "x.png", "--rows", "3", "50", "--step", "2", "--port", link)
        assert done.returncode == 0, done.stderr
        saved = np.asarray(Image.open(tmp_path / "x.png"))
        assert saved.shape == (24, 16, 3)
        assert all(any(np.array_equal(saved[i], p[3 + 2 * i, ::2]) for p in pictures) for i in range(24))
        outside = run("magtrak", "snapshot", "-o", tmp_path / "y.png", "--rows", "500", "600", "--port", link)
        assert "rows 500 to 600 are not in the image" in refused(outside)
        assert not (tmp_path / "y.png").exists()
