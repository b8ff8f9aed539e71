"""What the scan makes of frames, however they come."""

from dataclasses import replace

import numpy as np
import pytest

from magtrak.calibration import Calibration
from magtrak.frames import decode_frame
from magtrak.protocol import Phase
from magtrak.scan import Scan
from tests.support.calibrations import example_calibration
from tests.support.frames import CLOCK_HZ, Movement, Recorder, in_phase

MOVEMENTS: dict[str, Movement] = {
    "turns round": lambda t: 3 + 600 * np.sin(1.5 * t),
    "edges left out": lambda t: 5000 * t,
    "stands": lambda t: 100 * np.where(t < 0.3, t, np.where(t < 1.1, 0.305, t - 0.795)),
    "slow": lambda t: 0.2 + 3 * t,
}


@pytest.mark.parametrize("movement", MOVEMENTS)
@pytest.mark.parametrize("seed", range(2))
def test_points_of_waiting_frames_are_the_same_as_one_by_one(seed: int, movement: str) -> None:
    rng = np.random.default_rng(seed)
    recorder = Recorder(MOVEMENTS[movement])

    def columns(number: int) -> np.ndarray:
        return np.where(rng.random(recorder.rows) < 0.2, np.nan, rng.uniform(0, 63, recorder.rows))

    count = 120
    payloads = recorder.payloads(count, columns)
    phases = rng.choice([Phase.MEASURED, Phase.BACKGROUND, Phase.UNSUBTRACTED], count, p=[0.8, 0.1, 0.1])
    frames = [decode_frame(in_phase(p, Phase(phase))) for p, phase in zip(payloads, phases, strict=True)]
    # From the middle on with other settings; and one is lost.
    later = [replace(frame, header={**frame.header, "time_offset_ns": 3_000_000}) for frame in frames[count // 2 :]]
    frames = frames[: count // 2] + later
    del frames[int(rng.integers(5, 20))]
    one_by_one, together, replayed = (Scan(Calibration.parse(example_calibration(64, 48)), CLOCK_HZ) for _ in range(3))
    for frame, more in zip(frames, rng.random(len(frames)) < 0.8, strict=True):
        one_by_one.push(frame)
        together.push(frame, more=bool(more))
        replayed.push(frame, more=True)
    for scan in (one_by_one, together, replayed):
        scan.finish()
    assert one_by_one.counts.points > 500
    for scan in (together, replayed):
        assert scan.counts == one_by_one.counts
        assert scan.cloud().tobytes() == one_by_one.cloud().tobytes()
        assert len(scan.chunks) < len(one_by_one.chunks)
