"""How well the host knows the angle of every row: encoder edges through the gateware, beside a bare count.

Movements are given in advance; the card sees encoder and index pins and tiny images, the host its packets. Errors are
in counts, over all rows, not only those at which the card latches.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt

from magtrak import protocol
from magtrak.angle import AngleTracker, bare_angles
from magtrak.encoder import LineErrors
from magtrak.frames import decode_frame
from magtrak.laser import Laser
from magtrak.protocol import Deframer, PacketType, RowForm
from sim.core import INTERLOCK, PIN, SimulatedCore
from sim.encoder import Flaws
from sim.motor import Drive
from sim.trajectory import Segment
from tests.bench import Figure

Floats = npt.NDArray[np.float64]

CLOCK_HZ = 2_000_000
COUNTS = 8192
ROWS, COLUMNS = 48, 32
PERIOD_S = 0.02  # 50 images a second, a rolling shutter over 80 % of the period
STEP_S = 2e-3
DEG = pi / 180


class Given(Drive):
    """A movement that is a function of time, whatever the PWM; from 0 on, where it has just passed the index."""

    def __init__(self, angle: Callable[[float], float], speed: Callable[[float], float], flaws: Flaws) -> None:
        super().__init__(angle(0.0), COUNTS, flaws=flaws)
        self._angle, self._speed = angle, speed

    def _move(self, until_s: float, duty: float) -> list[Segment]:
        steps = max(round((until_s - self.time_s) / STEP_S), 1)
        times = np.linspace(self.time_s, until_s, steps + 1)
        return [
            Segment.hermite(a, b, self._angle(a), self._angle(b), self._speed(a), self._speed(b))
            for a, b in zip(times[:-1].tolist(), times[1:].tolist(), strict=True)
        ]


def constant(deg_s: float) -> tuple[Callable[[float], float], Callable[[float], float]]:
    """From just before the index on."""
    return lambda t: deg_s * DEG * t - 0.3 * DEG, lambda t: deg_s * DEG


def sweep(amplitude_deg: float, hz: float) -> tuple[Callable[[float], float], Callable[[float], float]]:
    """A sine about the index, and 1 % of its greatest speed at 50 Hz."""
    w, v = 2 * pi * hz, 2 * pi * 50
    a = amplitude_deg * DEG
    ripple = 0.01 * a * w
    return (
        lambda t: a * np.sin(w * t - 0.3) - ripple / v * np.cos(v * t),
        lambda t: a * w * np.cos(w * t - 0.3) + ripple * np.sin(v * t),
    )


@dataclass(frozen=True)
class Run:
    """What the host made of a movement: true and measured positions of all rows, and bare counts, in counts."""

    true: Floats
    rows: Floats
    bare: Floats
    standing: npt.NDArray[np.bool_]

    def errors(self) -> Floats:
        return self.rows - self.true


def run_movement(
    movement: tuple[Callable[[float], float], Callable[[float], float]],
    seconds: float,
    flaws: Flaws,
    *,
    learner: LineErrors | None = None,
    period_s: float = PERIOD_S,
) -> Run:
    """Through the gateware, from pins to packets, and through the host's tracker."""
    row_s = 0.8 * period_s / ROWS
    core = SimulatedCore(CLOCK_HZ, 1.2e6)
    drive = Given(*movement, flaws)
    levels = [(0, signal, level) for signal, level in drive.levels().items()]
    core.pins(np.array([*levels, (0, INTERLOCK, 1)], PIN))
    for name, value in (("run", 1), ("form", RowForm.COMPACT), ("counts_per_turn", COUNTS)):
        command = protocol.COMMAND.pack({"address": protocol.register(name).address, "value": value})
        core.send(protocol.frame_packet(protocol.Packet(PacketType.WRITE, 0, command)))
    deframer, tracker = Deframer(), AngleTracker(CLOCK_HZ)
    image = np.zeros((ROWS, COLUMNS, 3), np.uint8)
    done = []
    for number in range(round(seconds / period_s)):
        start_s = 0.01 + number * period_s
        events = drive.advance(start_s + period_s)
        core.pins(np.array([(round(e.time_s * CLOCK_HZ), e.signal, e.level) for e in events], PIN))
        starts = np.round((start_s + row_s * np.arange(ROWS)) * CLOCK_HZ).astype(np.int64)
        core.rows(starts, image, frame_first=True, end=int(starts[-1]) + COLUMNS + 1)
        core.run(round((start_s + period_s) * CLOCK_HZ))
        for packet in deframer.feed(core.receive()):
            if packet.type == PacketType.FRAME:
                frame = decode_frame(packet.payload)
                done += tracker.push(frame)
                if learner is not None:
                    learner.push(frame)
    done += tracker.flush()
    core.close()
    true, rows, bare, standing = [], [], [], []
    for frame, angles in done:
        if not frame.flags["index_seen"]:
            continue
        times = (frame.header["first_time"] + frame.row_times) / CLOCK_HZ
        true.append(np.array([movement[0](t) for t in times]) * COUNTS / (2 * pi))
        rows.append(angles.counts)
        bare.append(bare_angles(frame).counts)
        standing.append(angles.standing)
    return Run(*(np.concatenate(part) for part in (true, rows, bare, standing)))


def rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def figure(what: str, run: Run, limit: float) -> Figure:
    """RMS beside that of a bare count at the same row, which is a fixed half count at best."""
    # The bare count of each row itself: floor, in the middle of the step. The image's own is far worse.
    at_row = np.floor(run.true) + 0.5 - run.true
    ours = rms(run.errors())
    return Figure(what, ours, "counts", "bare count", rms(at_row), f"at most {limit:g}", ours <= limit)


def run() -> Iterator[Figure]:
    ideal = run_movement(constant(7.5), 6.0, Flaws(jitter_s=1e-6, seed=1))
    yield figure("constant speed, ideal encoder, 1 us jitter, RMS", ideal, 1 / 500)
    image = rms(ideal.bare + 0.5 - ideal.true)
    yield Figure("one bare count for a whole image, constant speed, RMS", image, "counts")
    lines = run_movement(constant(7.5), 6.0, Flaws(line_error_counts=0.01, seed=2))
    yield figure("constant speed, 1 % random line-spacing error, RMS", lines, 1 / 100)
    for amplitude, hz in ((7, 0.5), (20, 2.0)):
        swept = run_movement(sweep(amplitude, hz), 6.0, Flaws(jitter_s=1e-6, seed=3))
        name = f"sweep of +-{amplitude} deg at {hz:g} Hz, 1 % ripple at 50 Hz"
        yield figure(f"{name}, RMS", swept, 1 / 50)
        worst = float(np.abs(swept.errors()).max())
        yield Figure(f"{name}, greatest", worst, "counts", "bare count", 0.5, "at most 0.1", worst <= 0.1)
    yield from learned_table()


def learned_table() -> Iterator[Figure]:
    """5 % line-spacing error, learned from four turns, used on others at another speed."""
    flaws = Flaws(line_error_counts=0.05, jitter_s=1e-6, seed=4)
    learner = LineErrors(COUNTS)
    run_movement(constant(140.0), 10.5, flaws, learner=learner, period_s=0.0045)
    later = run_movement(constant(31.0), 6.0, flaws)
    corrected = Laser(np.eye(4), counts_per_turn=COUNTS, error_table=learner.table()).corrected(later.rows)
    before, after = rms(later.errors()), rms(corrected - later.true)
    yield Figure(
        "5 % line-spacing error with the learned table, RMS",
        after,
        "counts",
        "without",
        before,
        "at least 80 % removed",
        after <= 0.2 * before,
    )
