"""The encoder's position at each row, against movements that are known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from magtrak.angle import AngleTracker, bare_angles
from magtrak.frames import Frame, LoggedEdge, decode_frame
from tests.support.frames import CLOCK_HZ, Recorder

COUNTS_PER_TURN = 2000


def track(recorder: Recorder, count: int, time_offset_s: float = 0.0, lost: tuple[int, ...] = ()):
    """Errors in counts and standing flags, an array of rows for each frame, and the frames."""
    tracker = AngleTracker(CLOCK_HZ, time_offset_s)
    frames = [decode_frame(p) for n, p in enumerate(recorder.payloads(count)) if n not in lost]
    found = [pair for frame in frames for pair in tracker.push(frame)] + tracker.flush()
    assert [frame.number for frame, _ in found] == [frame.number for frame in frames]
    truth = [recorder.movement(recorder.row_times(frame.number) + time_offset_s) for frame, _ in found]
    errors = np.array([angles.counts - p for (_, angles), p in zip(found, truth, strict=True)])
    return errors + recorder.index_count, np.array([angles.standing for _, angles in found])


def track_without_log(recorder: Recorder, count: int):
    """As :func:`track`, of a card without edge log."""
    tracker = AngleTracker(CLOCK_HZ)
    frames = [decode_frame(payload) for payload in recorder.payloads(count)]
    frames = [replace(frame, edges=[]) for frame in frames]
    found = [pair for frame in frames for pair in tracker.push(frame)] + tracker.flush()
    truth = [recorder.movement(recorder.row_times(frame.number)) for frame, _ in found]
    errors = np.array([angles.counts - p for (_, angles), p in zip(found, truth, strict=True)])
    return errors, np.array([angles.standing for _, angles in found])


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def sweep(amplitude_deg: float, frequency_hz: float) -> Callable[[np.ndarray], np.ndarray]:
    """A sine sweep, with a ripple of 1 % of the greatest speed at 50 Hz."""
    amplitude, omega = amplitude_deg / 360 * COUNTS_PER_TURN, 2 * np.pi * frequency_hz
    ripple = 0.01 * amplitude * omega / (2 * np.pi * 50)
    return lambda t: amplitude * np.sin(omega * (t + 0.03)) + ripple * np.sin(2 * np.pi * 50 * t)


@pytest.mark.parametrize("speed", [55.6, -55.6, 556.0])
def test_constant_speed(speed: float) -> None:
    errors, standing = track(Recorder(lambda t: 3.3 + speed * t), 20)
    # What is left is the clock's period.
    assert np.abs(errors).max() < 2 * abs(speed) / CLOCK_HZ + 1e-6
    assert not standing.any()


def test_constant_acceleration_through_a_reversal_is_exact() -> None:
    errors, standing = track(Recorder(lambda t: 3.3 - 60 * t + 100 * t * t), 40)
    assert np.abs(errors).max() < 1e-4
    assert not standing.any()


def test_edge_jitter_of_a_microsecond_at_constant_speed() -> None:
    errors, _ = track(Recorder(lambda t: 0.4 + 55.6 * t, jitter_s=1e-6), 40)
    assert rms(errors) < 1 / 500


def test_line_spacing_error() -> None:
    lines = np.random.default_rng(4).normal(0, 0.01, 1000)
    recorder = Recorder(lambda t: 0.4 + 55.6 * t, line_error=lambda k: lines[k % 1000], jitter_s=1e-6)
    assert rms(track(recorder, 60)[0]) < 1 / 80  # of which the lines alone make 1 / 100


@pytest.mark.parametrize(("amplitude_deg", "frequency_hz"), [(7, 0.5), (20, 2)])
def test_sweeps_with_reversals(amplitude_deg: float, frequency_hz: float) -> None:
    recorder = Recorder(sweep(amplitude_deg, frequency_hz), jitter_s=1e-6)
    errors, _ = track(recorder, 110)
    assert rms(errors) < 1 / 50
    assert np.abs(errors).max() < 1 / 10
    bare = [bare_angles(decode_frame(p)).counts for p in recorder.payloads(110)]
    truth = [recorder.movement(recorder.row_times(n)) for n in range(110)]
    assert rms(np.array(bare) - truth) > 20 * rms(errors)


def test_fast_turning_thins_the_log_and_stays_smooth() -> None:
    recorder = Recorder(lambda t: 6000 * t + 3 * np.sin(30 * t), jitter_s=1e-7)
    shifts = {decode_frame(p).header["edge_shift"] for p in recorder.payloads(4)}
    assert max(shifts) >= 3
    assert rms(track(recorder, 20)[0]) < 1 / 50


@pytest.mark.parametrize("speed", [55.6, -55.6, 556.0, -6000.0])
def test_without_a_log_the_latches_tell_a_constant_speed(speed: float) -> None:
    errors, standing = track_without_log(Recorder(lambda t: 3.3 + speed * t), 20)
    assert np.abs(errors).max() < 2 * abs(speed) / CLOCK_HZ + 1e-6
    assert not standing.any()


def test_without_a_log_a_ripple_of_the_speed_is_followed_less_well() -> None:
    """1 % at 50 Hz, the rate of the images, and 1 us of jitter; a bare count per image is far worse."""
    recorder = Recorder(lambda t: 300 * t + 3 / (2 * np.pi * 50) * np.sin(2 * np.pi * 50 * t), jitter_s=1e-6)
    errors, standing = track_without_log(recorder, 60)
    assert rms(errors) < 1 / 50
    assert rms(track(recorder, 60)[0]) < rms(errors)
    assert not standing.any()


def test_without_a_log_a_motor_that_turns_round_is_within_a_count() -> None:
    errors, _ = track_without_log(Recorder(sweep(20, 2), jitter_s=1e-6), 110)
    assert np.abs(errors).max() <= 1
    assert rms(errors) < 1 / 5


def test_without_a_log_standstill_is_the_middle_of_the_count() -> None:
    errors, standing = track_without_log(Recorder(lambda t: np.full_like(t, 12.25)), 5)
    assert standing.all()
    assert np.allclose(errors, 0.25)


def test_time_offsets_of_calibration_and_frame_add_up() -> None:
    recorder = Recorder(lambda t: 100 * t)
    tracker = AngleTracker(CLOCK_HZ, -0.003)
    payloads = recorder.payloads(6, time_offset_ns=-2_000_000)
    found = [pair for p in payloads for pair in tracker.push(decode_frame(p))] + tracker.flush()
    for frame, angles in found:
        assert np.abs(angles.counts - 100 * (recorder.row_times(frame.number) - 0.005)).max() < 1e-4


def test_counts_are_from_the_index() -> None:
    errors, _ = track(Recorder(lambda t: 900 + 100 * t, index_count=888), 5)
    assert np.abs(errors).max() < 1e-4


def test_standstill_is_the_middle_of_the_count_and_said() -> None:
    errors, standing = track(Recorder(lambda t: np.full_like(t, 12.25)), 5)
    assert standing.all()
    assert np.allclose(errors, 0.25)


def test_a_stop_after_a_rush_is_seen_though_its_last_edges_were_thinned_out() -> None:
    recorder = Recorder(lambda t: 5000.3 + 30_000 * np.minimum(t - 0.0981, 0))  # frames begin at 0.1 s
    assert decode_frame(recorder.payloads(1)[0]).header["edge_shift"] >= 4
    errors, standing = track(recorder, 12)
    assert np.abs(errors).max() <= 0.5
    assert standing.all()


def test_stopping_and_starting_again() -> None:
    def movement(t: np.ndarray) -> np.ndarray:
        return 3.3 + 60 * (np.minimum(t, 0.4) + np.maximum(t - 1.6, 0))

    recorder = Recorder(movement)
    errors, standing = track(recorder, 100)
    assert np.abs(errors).max() <= 0.5
    times = np.array([recorder.row_times(n) for n in range(100)])
    assert standing[(times > 0.5) & (times < 1.5)].all()
    assert not standing[(times < 0.35) | (times > 1.7)].any()
    assert np.abs(errors[~standing]).max() < 0.35  # within a count while it gets going


def test_reversal_on_an_edge_and_shaking_about_it() -> None:
    recorder = Recorder(lambda t: 5 + 0.05 * np.sin(2 * np.pi * 23 * t))
    errors, _ = track(recorder, 20)
    # Half a swing goes unseen between two edges; the parabola about it is off by little.
    assert np.abs(errors).max() < 0.06


@pytest.mark.parametrize("lost", [(5,), (5, 6, 7), (0, 1)])
def test_lost_frames_cost_no_accuracy_at_constant_speed(lost: tuple[int, ...]) -> None:
    for speed in (70.0, -70.0):
        errors, standing = track(Recorder(lambda t, s=speed: 1000.7 + s * t), 15, lost=lost)
        assert np.abs(errors).max() < 1e-3
        assert not standing.any()


def test_time_of_edges_wraps_at_32_bits() -> None:
    recorder = Recorder(lambda t: 500 + 100 * t)
    shift = 2**32 - round(0.2 * CLOCK_HZ)
    tracker = AngleTracker(CLOCK_HZ)
    frames = [later(decode_frame(p), shift) for p in recorder.payloads(12)]
    assert frames[0].header["first_time"] < 2**32 < frames[-1].header["first_time"]
    for done, angles in [pair for frame in frames for pair in tracker.push(frame)] + tracker.flush():
        assert np.abs(angles.counts - recorder.movement(recorder.row_times(done.number))).max() < 1e-4


def later(frame: Frame, clocks: int) -> Frame:
    """The frame as if the card had been running for so long before."""
    header = {**frame.header}
    header["first_time"] += clocks
    header["last_time"] += clocks
    edges = [edge._replace(time=edge.time + clocks & 0xFFFF_FFFF) for edge in frame.edges]
    return Frame(header, frame.flags, edges, frame.rows)


def test_an_edge_older_than_its_time_can_tell_is_left_out() -> None:
    """After half an hour of standstill the log's first edges have wrapped; the moving rows stay right."""
    recorder = Recorder(lambda t: 100.5 + 80 * t)
    tracker = AngleTracker(CLOCK_HZ)
    frames = [decode_frame(p) for p in recorder.payloads(8)]
    first = frames[0]
    stray = [LoggedEdge((first.header["last_time"] - 100) & 0xFFFF_FFFF, 7, 0), *first.edges[2:]]
    frames[0] = Frame(first.header, first.flags, stray, first.rows)
    found = [pair for frame in frames for pair in tracker.push(frame)] + tracker.flush()
    for frame, angles in found:
        assert np.abs(angles.counts - recorder.movement(recorder.row_times(frame.number))).max() < 1e-3


def test_frames_come_out_as_soon_as_two_edges_after_them_are_known() -> None:
    recorder = Recorder(lambda t: 400 * t)
    tracker = AngleTracker(CLOCK_HZ)
    counts = [len(tracker.push(decode_frame(p))) for p in recorder.payloads(10)]
    assert counts == [0] + [1] * 9


def test_patience_limits_how_long_a_frame_is_held_back() -> None:
    recorder = Recorder(lambda t: np.full_like(t, 3.5))
    tracker = AngleTracker(CLOCK_HZ, patience_s=0.1)
    counts = [len(tracker.push(decode_frame(p))) for p in recorder.payloads(10)]
    assert counts == [0] * 6 + [1] * 4
