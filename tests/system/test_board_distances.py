"""Ten real pictures of a board at hand-placed distances: see :mod:`tests.support.board`."""

import pytest

from tests.support import board

PEAKS = {"fir": 'detector = "fir"', "centroid": 'detector = "centroid"\nwindow = 15'}


@pytest.fixture(scope="module", params=PEAKS)
def lines(request, tmp_path_factory):
    found, ambiguous = board.measured_lines(tmp_path_factory.mktemp("board"), PEAKS[request.param])
    assert not ambiguous
    return found


def test_rows_give_points(lines):
    shares = board.shares(lines)
    assert shares.min() >= 0.9, shares


@pytest.mark.parametrize("left_out", range(len(board.DISTANCES_MM)))
def test_nine_pictures_predict_the_tenth(lines, left_out):
    error_mm = board.prediction_error_mm(lines, left_out)
    print(f"{board.DISTANCES_MM[left_out]} mm: {error_mm:+.2f} mm")
    assert abs(error_mm) <= 2.5


def test_rows_lie_on_a_line(lines):
    for distance, rms in zip(board.DISTANCES_MM, board.scatter_mm(lines), strict=True):
        print(f"{distance} mm: rows scatter by {rms:.2f} mm RMS")
        assert rms <= (1.2 if distance <= 220 else 1.6)
