"""From bytes to points: load, speed, and latency on a 3 Mbaud link, with the host as it is.

The stream is 1080 rows x 60 images a second in the compact form, a line in every row. Its edges are those of a sweep at
20 deg/s with 8192 counts a turn; the exposure is 10 ms, so that a row's light was gathered 5 ms before its time.

Latency is measured through a pseudo-terminal: a process writes each frame at the time of its last pixel, at the pace of
the wire, and the host (reader process, link, scan) notes when the points of the frame are there.
"""

import json
import math
import os
import struct
import subprocess
import sys
import time
import tty
from collections.abc import Iterator
from statistics import median

import cobs.cobs
import numpy as np

from magtrak import protocol
from magtrak.calibration import Calibration
from magtrak.frames import decode_frame
from magtrak.link import Link
from magtrak.protocol import Packet, PacketType, RowForm, frame_packet
from magtrak.scan import Scan
from magtrak.stream import PacketStream
from tests.bench import Figure
from tests.support.calibrations import example_calibration
from tests.support.frames import CLOCK_HZ, Recorder

ROWS, COLUMNS, RATE_HZ = 1080, 1920, 60
BAUD = 3_000_000
LIVE_CHUNK = 4096  # what one read of a port gives whose reader keeps up
BACKLOG_CHUNK = 65536  # and of one that has data waiting
LOAD_FRAMES, LATENCY_FRAMES = 240, 240
SETTLED = 30
EXPOSURE_OFFSET_S = -0.005


LENS = (-0.1, 0.05, 0.001, -0.0005, 0.01)
"""Distortion of a common lens: five steps take it out."""


def calibration(time_offset_s: float = EXPOSURE_OFFSET_S, distortion: tuple[float, ...] = (0.0,) * 5) -> Calibration:
    values = example_calibration(width=COLUMNS, height=ROWS)
    values["camera"] |= {"time_offset_s": time_offset_s, "matrix": [[2000, 0, 959.5], [0, 2000, 539.5], [0, 0, 1]]}
    values["camera"]["distortion"] = list(distortion)
    return Calibration.parse(json.loads(json.dumps(values)))


def wires(count: int) -> list[bytes]:
    """Frames as they are on the wire."""
    recorder = Recorder(lambda t: 40 + 455 * t, rows=2, frame_s=1 / RATE_HZ, rows_s=0.8 / RATE_HZ)
    packets = []
    for number, payload in enumerate(recorder.payloads(count)):
        header = protocol.FRAME.unpack(payload[: protocol.FRAME.size])
        edges = payload[protocol.FRAME.size :][: header["edges"] * protocol.EDGE.size]
        header |= {"rows": ROWS, "columns": COLUMNS, "form": RowForm.COMPACT}
        position = np.linspace(400, 700, ROWS) + 2 * number
        # position 19 bits, valid, 4 flags, peak and width 4 bits each
        words = (np.round(position * 256).astype(np.uint32)) | 1 << 19 | 12 << 24 | 5 << 28
        data = protocol.FRAME.pack(header) + edges + words.astype("<u4").tobytes()
        packets.append(frame_packet(Packet(PacketType.FRAME, number, data)))
    return packets


def ours(stream: bytes, scan: Scan, chunk: int) -> None:
    """As the receiver does: what is there already is told to the scan."""
    decoder = PacketStream()
    for at in range(0, len(stream), chunk):
        packets = decoder.feed(stream[at : at + chunk])
        for left, packet in zip(reversed(range(len(packets))), packets, strict=True):
            scan.push(decode_frame(packet.payload), more=left > 0)
    scan.finish()


def seconds(stream: bytes, chunk: int, used: Calibration) -> float:
    """Of a core, from bytes to points; the least of ten runs: what else runs on a machine makes it longer only."""
    took = []
    for _ in range(10):
        scan = Scan(used, CLOCK_HZ)
        start = time.process_time()
        ours(stream, scan, chunk)
        took.append(time.process_time() - start)
        assert scan.counts.points > 0.95 * ROWS * LOAD_FRAMES, scan.counts
    return min(took)


def plain(stream: bytes, laser_x_mm: float = -500.0, focal_px: float = 2000.0) -> list[tuple[float, float, float]]:
    """Points as one writes it first: the `cobs` package, a row at a time, one angle for a frame, no distortion."""
    points = []
    for stretch in stream.split(b"\0")[:-1]:
        payload = cobs.cobs.decode(stretch)[3:-4]
        header = protocol.FRAME.unpack(payload[: protocol.FRAME.size])
        at = protocol.FRAME.size + header["edges"] * protocol.EDGE.size
        tangent = math.tan(2 * math.pi * (header["first_count"] - header["index_count"]) / 8192)
        for row, (word,) in enumerate(struct.iter_unpack("<I", payload[at:])):
            if word >> 19 & 1:
                x, y = ((word & 0x7FFFF) / 256 - 959.5) / focal_px, (row - 539.5) / focal_px
                z = laser_x_mm / (x - tangent)
                points.append((x * z, y * z, z))
    return points


def _plain_seconds(stream: bytes) -> float:
    start = time.process_time()
    plain(stream)
    return time.process_time() - start


SENDER = """
import os, sys, time
descriptor, period, rate, count = int(sys.argv[1]), 1 / float(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
data = sys.stdin.buffer.read()
frames = [frame + b"\\0" for frame in data.split(b"\\0")[:-1]]
start = time.monotonic() + 0.5
for number, frame in enumerate(frames):
    due = start + number * period
    sent, ends = 0, []
    while sent < len(frame):
        now = time.monotonic()
        allowed = min(int((now - due) * rate), len(frame))
        if allowed > sent:
            sent += os.write(descriptor, frame[sent:allowed])
        else:
            time.sleep(0.0002)
    print(due, flush=True)
time.sleep(1)
"""


def latency(frames: list[bytes], time_offset_s: float) -> tuple[float, float, float]:
    """Median and 95th percentile, in s, of the time from the last pixel to the points; and the wire's share."""
    master, slave = os.openpty()
    tty.setraw(slave)
    command = [sys.executable, "-c", SENDER, str(master), str(RATE_HZ), str(BAUD / 10), str(len(frames))]
    scan = Scan(calibration(time_offset_s), CLOCK_HZ)
    ready: dict[int, float] = {}
    with Link(os.ttyname(slave)) as link:
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, pass_fds=(master,)) as sender:
            assert sender.stdin is not None and sender.stdout is not None
            sender.stdin.write(b"".join(frames))
            sender.stdin.close()
            received = 0
            while received < len(frames):
                packet = link.receive(5)
                assert packet is not None, f"{received} of {len(frames)} frames came"
                received += 1
                before = len(scan.chunks)
                scan.push(decode_frame(packet.payload))
                now = time.monotonic()
                for chunk in scan.chunks[before:]:
                    ready[int(chunk["scalar_frame"][0])] = now
            due = [float(line) for line in sender.stdout.read().split()]
        assert link.statistics.lost == 0
    os.close(master)
    os.close(slave)
    late = sorted(ready[number] - due[number] for number in range(SETTLED, len(frames)) if number in ready)
    wire = median(len(frame) for frame in frames) * 10 / BAUD
    return median(late), late[int(0.95 * len(late))], wire


def run() -> Iterator[Figure]:
    frames = wires(LOAD_FRAMES)
    stream = b"".join(frames)
    peer = min(_plain_seconds(stream) for _ in range(3))
    real = LOAD_FRAMES / RATE_HZ
    what = "row at a time"
    load, peer_load = 100 * seconds(stream, LIVE_CHUNK, calibration()) / real, 100 * peer / real
    yield Figure("1080 rows x 60 Hz to points, of a core", load, "%", what, peer_load, "at most 3", load <= 3)
    bent = seconds(stream, LIVE_CHUNK, calibration(distortion=LENS))
    yield Figure("the same with a lens's distortion", 100 * bent / real, "%")
    speed = real / seconds(stream, BACKLOG_CHUNK, calibration())
    yield Figure(
        "without distortion, flat out, times real time", speed, "x", what, real / peer, "at least 50", speed >= 50
    )

    frames = wires(LATENCY_FRAMES)
    middle, late, wire = latency(frames, EXPOSURE_OFFSET_S)
    goal = f"wire {1e3 * wire:.1f} ms + 5"
    yield Figure("last pixel to points at 3 Mbaud, median", 1e3 * middle, "ms", "", None, goal, middle <= wire + 5e-3)
    yield Figure("the same, 95th percentile", 1e3 * late, "ms")
    middle, _, _ = latency(frames, 0.0)
    yield Figure("the same with no exposure: waits for the next frame's edges", 1e3 * middle, "ms")
