"""Short runs of the fuzzers, and properties by Hypothesis; ``make fuzz`` makes long ones."""

import json
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magtrak import protocol
from magtrak.calibration import Calibration
from magtrak.errors import CalibrationError, SettingsError
from magtrak.frames import decode_frame
from magtrak.protocol import Deframer, Packet, PacketType, frame_packet
from magtrak.scan import Scan
from magtrak.settings_file import parse_settings
from magtrak.stream import PacketStream
from tests.fuzz import damage
from tests.support.calibrations import example_calibration
from tests.support.frames import Recorder

ROOT = Path(__file__).parents[2]


def test_a_damaged_stream_loses_what_was_damaged_and_nothing_else() -> None:
    seed = random.randrange(2**32)
    print("seed", seed)
    result = damage.run(5000, seed)
    assert result.touched >= 5000 and result.frames > 1000
    assert set(result.damages) == {one.__name__ for one in damage.DAMAGES}


@pytest.mark.parametrize("flaw", ["no CRC", "an untouched packet dropped", "losses not counted"])
def test_the_check_finds_decoders_that_lie(flaw: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if flaw == "no CRC":
        monkeypatch.setattr(protocol.cobs, "zlib", type("Constant", (), {"crc32": staticmethod(lambda data: 0)}))
    elif flaw == "losses not counted":
        monkeypatch.setattr(PacketStream, "statistics", lambda self: Deframed(self._deframer))
    else:
        feed = Deframer.feed
        monkeypatch.setattr(Deframer, "feed", lambda self, data: [p for p in feed(self, data) if p.sequence % 50])
    with pytest.raises(AssertionError):
        damage.run(5000, 1)


class Deframed:
    """Statistics of one that does not look at sequence numbers."""

    def __init__(self, deframer: Deframer) -> None:
        self.packets, self.lost, self.restarts = deframer.packets, 0, 0


@pytest.mark.parametrize(
    ("target", "runs"), [("decoder", 3000), ("settings", 2000), ("calibration", 2000), ("recording", 1000)]
)
def test_coverage_guided(target: str, runs: int) -> None:
    seed = random.randrange(1, 2**31)
    command = [sys.executable, "-m", "tests.fuzz.targets", target, f"-runs={runs}", f"-seed={seed}"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0 and f"Done {runs} runs" in done.stderr, f"seed {seed}\n{done.stderr[-3000:]}"


def test_points_of_a_damaged_scan_are_those_of_the_whole_one() -> None:
    """Rows, columns and widths to the bit; the angle leans on the edges of frames around, some of which are gone."""
    seed = random.randrange(2**32)
    print("seed", seed)
    rng = random.Random(seed)
    recorder = Recorder(lambda t: 300 + 250 * t + 20 * np.sin(9 * t), rows=16)
    payloads = recorder.payloads(200, lambda number: np.linspace(10, 40, 16) + number / 50)
    wires = [frame_packet(Packet(PacketType.FRAME, number, payload)) for number, payload in enumerate(payloads)]
    calibration = Calibration.parse(example_calibration())
    whole = points(calibration, b"".join(wires))[0]
    hit = set(rng.sample(range(2, 198), 40))
    for number in hit:
        wire = bytearray(wires[number])
        wire[rng.randrange(len(wire) - 1)] ^= 1 << rng.randrange(8)
        wires[number] = bytes(wire)
    damaged, scan, statistics = points(calibration, b"".join(wires))
    assert scan.counts.frames == 160 and statistics.lost == 40 and scan.counts.lost_frames == 40
    assert set(damaged["scalar_frame"]) == set(range(200)) - hit
    whole = whole[~np.isin(whole["scalar_frame"], list(hit))]
    for name in ("scalar_frame", "scalar_row", "scalar_column", "scalar_width", "scalar_time", "intensity"):
        assert np.array_equal(damaged[name], whole[name]), name
    counts = np.abs(damaged["scalar_angle"] - whole["scalar_angle"]) * 8192 / (2 * np.pi)
    assert counts.max() < 0.5
    away = np.array([min(abs(number - one) for one in hit) for number in whole["scalar_frame"]]) > 3
    assert away.any() and counts[away].max() == 0


def points(calibration: Calibration, wire: bytes) -> tuple[Any, Scan, Any]:
    stream, scan = PacketStream(), Scan(calibration, 50e6)
    for packet in stream.feed(wire):
        scan.push(decode_frame(packet.payload))
    scan.finish()
    return scan.cloud(), scan, stream.statistics()


@given(st.lists(st.binary(max_size=40), min_size=1, max_size=8), st.lists(st.integers(0, 400), max_size=5), st.binary())
def test_packets_come_out_however_the_stream_is_cut_and_whatever_came_before(
    payloads: list[bytes], cuts: list[int], noise: bytes
) -> None:
    sent = [Packet(1, number, payload) for number, payload in enumerate(payloads)]
    data = noise + b"\0" + b"".join(map(frame_packet, sent))
    stream, got, at = PacketStream(), [], 0
    for cut in [*sorted(cuts), len(data)]:
        got += stream.feed(data[at:cut])
        at = max(at, cut)
    assert got[-len(sent) :] == sent
    assert stream.statistics().bytes == len(data) and not stream.within_packet


@given(st.integers(1, 3), st.binary(min_size=1, max_size=3))
def test_noise_without_end_does_not_fill_the_memory(times: int, pattern: bytes) -> None:
    noise = pattern.replace(b"\0", b"\1") * 50_000
    deframer = Deframer(limit=10_000)
    for _ in range(times):
        assert list(deframer.feed(noise)) == []
        assert deframer.damaged == 1
    assert list(deframer.feed(b"\0" + frame_packet(Packet(1, 0, b"x")))) == [Packet(1, 0, b"x")]
    assert deframer.damaged == 1


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_a_calibration_with_any_field_replaced_is_refused_or_usable(data: st.DataObject) -> None:
    values = json.loads(json.dumps(example_calibration()))
    for _ in range(data.draw(st.integers(1, 2))):
        section = data.draw(st.sampled_from(["camera", "laser", "encoder"]))
        table = values.setdefault(section, {})
        name = data.draw(st.sampled_from([*table, "error_table", "else"]))
        table[name] = data.draw(JSON | st.sampled_from([[0.0] * 8, [1.0] * 4, [[1, 0, 5], [0, 1, 5], [0, 0, 1]]]))
    try:
        calibration = Calibration.parse(values)
    except CalibrationError as error:
        assert "\n" not in str(error)
        return
    laser = calibration.laser
    normals, offsets = laser.planes(laser.alpha(np.array([0.0, 100.0])))
    assert np.isfinite(normals).all() and np.isfinite(offsets).all()


SECTIONS = ("gate", "weight", "runs", "region", "camera", "peak", "motor", "laser", "encoder", "other")
NAMES = (
    *("hue", "luminance", "mix", "floor", "min_gated", "max_width", "first_row", "last_row", "exposure_s", "detector"),
    *("choice", "mode", "sweep_deg", "watch", "arm", "sector_deg", "counts_per_turn", "index_policy", "speed_deg_s"),
)
VALUES = st.one_of(
    JSON,
    st.sampled_from(["fir", "binary", "sweep", "speed", "reset", [0, 90], ["stall"], 4, 8192, 0.5, 1e5, -1e5]),
)


@settings(max_examples=500, deadline=None)
@given(
    st.dictionaries(st.sampled_from(SECTIONS), st.dictionaries(st.sampled_from(NAMES), VALUES, max_size=3), max_size=3)
)
def test_any_settings_are_refused_or_fit_the_registers(values: dict[str, Any]) -> None:
    try:
        chosen = parse_settings(values)
        words = [*chosen.register_values(50e6), *chosen.tables()]
    except SettingsError as error:
        assert "\n" not in str(error)
        return
    for name, values_of_register in words:
        entry = protocol.register(name)
        assert all(entry.decode(entry.encode(word)) == word for word in values_of_register)
