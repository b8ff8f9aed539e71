"""Angles from files: what the motor then does, and what a wrong file is told."""

from math import pi

import numpy as np
import pytest

from sim.encoder import Signal
from sim.errors import SimError
from sim.playback import Angles, Playback, read_angles, steady
from sim.timing import Timing

N = 8192
PITCH = 2 * pi / N
RATE = 400_000.0
TIMING = Timing(48)


def play(angles: Angles, start_s: float = 0.003) -> tuple[Playback, float, list]:
    playback = Playback(angles, TIMING, N, RATE)
    begin = playback.start(start_s)
    return playback, begin, playback.advance(begin + len(angles) * TIMING.period_s)


def test_angles_at_the_first_and_last_row() -> None:
    start, end = np.radians([10.0, 10.5, 10.2]), np.radians([10.4, 10.5, 9.9])
    playback, begin, _ = play(Angles(tuple(start), tuple(end)))
    for frame in range(3):
        rows = TIMING.rows(begin + frame * TIMING.period_s)
        assert playback.angle(rows) == pytest.approx(np.linspace(start[frame], end[frame], 48))
    between = begin + (TIMING.rows(0)[-1] + TIMING.period_s) / 2
    assert playback.angle([between]) == pytest.approx([(end[0] + start[1]) / 2])


@pytest.mark.parametrize("first_deg", [25.0, -25.0, 0.0, 0.02, -0.02, 400.0])
@pytest.mark.parametrize("sweep_deg", [0.4, -0.4, 0.0])
def test_comes_from_the_index_at_the_speed_of_picture_0(first_deg: float, sweep_deg: float) -> None:
    start = np.radians(first_deg)
    end = start + np.radians(sweep_deg)
    playback, begin, events = play(Angles((start,), (end,)))
    speed = (end - start) / (TIMING.rows(0)[-1])
    before = begin - np.linspace(0, 0.999, 50) * TIMING.period_s
    assert playback.angle(before) == pytest.approx(start + speed * (before - begin), abs=1e-9)
    index = [event for event in events if event.signal is Signal.INDEX]
    assert index
    assert index[0].level == 1
    assert index[0].time_s < begin - TIMING.period_s
    # Never faster than allowed, and the count at the index is 0.
    edges = np.array([event.time_s for event in events if event.signal is not Signal.INDEX])
    assert np.diff(edges).min() > 0.999 / RATE
    count = -8 + np.searchsorted(edges, index[0].time_s)
    assert count == 0


def test_waits_until_it_is_started_and_takes_the_time_it_says() -> None:
    playback = Playback(steady(2, 0.3, 0.31, TIMING), TIMING, N, RATE)
    assert playback.advance(0.5) == []
    need = playback.preroll_s
    begin = playback.start()
    assert begin == pytest.approx(0.5 + need)
    # 15 counts past the mark, then 391.15 counts (0.3 rad) less 7.5 and one period's 7.3 counts or so.
    assert need == pytest.approx(TIMING.period_s + 400 / RATE, rel=0.05)


def test_runs_on_for_a_period_stands_and_can_start_again() -> None:
    playback, begin, _ = play(steady(2, 0.3, 0.31, TIMING))
    playback.advance(begin + 1.0)
    rest = playback.angle([begin + 1.0])[0]
    speed = 0.01 / (TIMING.period_s + TIMING.rows(0)[-1])
    assert rest == pytest.approx(0.31 + speed * TIMING.period_s)
    again = playback.start()
    playback.advance(again + 0.1)
    assert playback.angle([again]) == pytest.approx([0.3])
    assert playback.encoder.count == np.floor(playback.angle([again + 0.1])[0] / PITCH)


def test_portions_do_not_matter() -> None:
    whole = play(steady(2, -0.3, 0.31, TIMING))
    playback = Playback(steady(2, -0.3, 0.31, TIMING), TIMING, N, RATE)
    begin = playback.start(0.003)
    end = begin + 2 * TIMING.period_s
    events = [event for until in np.linspace(0, end, 999)[1:] for event in playback.advance(until)]
    assert begin == whole[1]
    assert [e[1:] for e in events] == [e[1:] for e in whole[2]]
    assert [e.time_s for e in events] == pytest.approx([e.time_s for e in whole[2]], abs=1e-12)


def test_too_fast() -> None:
    with pytest.raises(SimError, match=r"turn at up to .* counts a second, and this card takes 400000"):
        Playback(steady(1, 0, 7.0, TIMING), TIMING, N, RATE)


GOOD = "frame,angle_start_deg,angle_end_deg\n1,2.5,3\n0,-1,1e1\n\n"


def test_reads_a_file(tmp_path) -> None:
    path = tmp_path / "angles.csv"
    path.write_text(GOOD)
    angles = read_angles(path, 2)
    assert np.degrees(angles.start_rad) == pytest.approx([-1, 2.5])
    assert np.degrees(angles.end_rad) == pytest.approx([10, 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: the header has to be frame,angle_start_deg,angle_end_deg, not nothing"),
        ("frame,start,end\n", "line 1: the header has to be .*, not frame,start,end"),
        (GOOD + "1,0,0\n", "line 5: frame 1 is given again; it stands already in line 2"),
        (GOOD.replace("2.5", "fast"), "line 2: angle_start_deg has to be a number of degrees, not 'fast'"),
        (GOOD.replace("1e1", "nan"), "line 3: angle_end_deg has to be a number of degrees, not 'nan'"),
        (GOOD.replace("1e1", "inf"), "line 3: angle_end_deg has to be a number of degrees, not 'inf'"),
        (GOOD.replace("0,-1,1e1\n", ""), "frame 0 is missing; each of the 2 pictures needs a line"),
        (GOOD.replace("0,", "2,"), "line 3: there is no picture for frame 2; the pictures are 0 to 1"),
        (GOOD.replace("0,-1", "-1,-1"), "there is no picture for frame -1"),
        (GOOD.replace("1,2.5", "1.5,2.5"), "line 2: the frame has to be a whole number, not '1.5'"),
        (GOOD.replace(",1e1", ""), "line 3: 3 values are needed, not 2"),
    ],
)
def test_wrong_files(tmp_path, text: str, message: str) -> None:
    path = tmp_path / "angles.csv"
    path.write_text(text)
    with pytest.raises(SimError, match=message) as error:
        read_angles(path, 2)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_unreadable_files(tmp_path) -> None:
    with pytest.raises(SimError, match=r"none\.csv can't be read"):
        read_angles(tmp_path / "none.csv", 1)
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(SimError, match=r"binary\.csv can't be read"):
        read_angles(tmp_path / "binary.csv", 1)
