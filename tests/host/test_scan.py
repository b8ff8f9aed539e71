"""What the scan makes of frames, however they come."""

import numpy as np
import pytest

from magtrak.calibration import Calibration
from magtrak.frames import decode_frame
from magtrak.protocol import Phase
from magtrak.scan import Scan
from tests.support.calibrations import example_calibration
from tests.support.frames import CLOCK_HZ, Recorder, in_phase


@pytest.mark.parametrize("seed", range(3))
def test_points_of_waiting_frames_are_the_same_as_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    recorder = Recorder(lambda t: 3 + 600 * np.sin(1.5 * t))

    def columns(number: int) -> np.ndarray:
        return np.where(rng.random(recorder.rows) < 0.2, np.nan, rng.uniform(0, 63, recorder.rows))

    payloads = recorder.payloads(40, columns)
    phases = rng.choice([Phase.MEASURED, Phase.BACKGROUND, Phase.UNSUBTRACTED], 40, p=[0.8, 0.1, 0.1])
    frames = [decode_frame(in_phase(p, Phase(phase))) for p, phase in zip(payloads, phases, strict=True)]
    scans = [Scan(Calibration.parse(example_calibration(64, 48)), CLOCK_HZ) for _ in range(2)]
    for frame, more in zip(frames, rng.random(len(frames)) < 0.8, strict=True):
        scans[0].push(frame)
        scans[1].push(frame, more=bool(more))
    for scan in scans:
        scan.finish()
    one_by_one, together = scans
    assert one_by_one.counts.points > 500
    assert together.counts == one_by_one.counts
    assert together.cloud().tobytes() == one_by_one.cloud().tobytes()
    assert len(together.chunks) < len(one_by_one.chunks)
