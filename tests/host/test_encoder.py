"""The learned table of an encoder's lines, from frames of a perfect card."""

import numpy as np
import pytest

from magtrak.encoder import LineErrors
from magtrak.errors import CalibrationError
from magtrak.frames import decode_frame
from tests.support.frames import Movement, Recorder

COUNTS = 64
ERRORS = np.random.default_rng(7).normal(0, 0.05, COUNTS)
ERRORS -= ERRORS.mean()


def learn(movement: Movement, frames: int) -> np.ndarray:
    recorder = Recorder(movement, rows=4, line_error=lambda lines: ERRORS[np.mod(lines, COUNTS)])
    errors = LineErrors(COUNTS)
    for payload in recorder.payloads(frames):
        errors.push(decode_frame(payload))
    return errors.table()


@pytest.mark.parametrize("speed", [400.0, -330.0])
def test_constant_speed_gives_the_errors(speed: float) -> None:
    """But for what the fit of the drift takes with it; a constant is not an error of a line."""
    table = learn(lambda t: 5.5 + speed * t, 45)
    assert np.sqrt(np.mean((table - ERRORS) ** 2)) < 0.1 * np.sqrt(np.mean(ERRORS**2))


def test_slow_drift_of_the_speed_is_not_taken_for_lines() -> None:
    table = learn(lambda t: 400 * t + 15 * t**2 - 4 * t**3, 60)
    assert np.sqrt(np.mean((table - ERRORS) ** 2)) < 0.1 * np.sqrt(np.mean(ERRORS**2))


def test_too_little_is_refused_with_the_reason() -> None:
    with pytest.raises(CalibrationError, match=r"0\.\d turns were recorded, 2 are needed: turn longer"):
        learn(lambda t: 100 * t, 10)
    with pytest.raises(CalibrationError, match="the motor turned both ways"):
        learn(lambda t: 10 + 500 * t - 60 * t**2 * (t > 0.5) * 8, 80)
    with pytest.raises(CalibrationError, match="% of the encoder's lines were seen"):
        learn(lambda t: 3200 * t, 6)
