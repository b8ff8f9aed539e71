"""Pictures of a board from a card that runs: by the taker alone, and through the virtual card by the command."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from magtrak.calibrate.board import A3, Board
from magtrak.calibrate.detect import read_picture
from magtrak.calibrate.live import ViewTaker
from magtrak.errors import CalibrationError
from tests.support.board_pictures import picture
from tests.support.virtual import run, virtual_card

PLACES = [(-150.0, -110.0, 700.0), (-250.0, -160.0, 800.0), (-60.0, -60.0, 800.0)]
CHESS = Board("chess", "chessboard", 6, 5, 60.0)
EACH = 130


def shown(place: int, seed: int, board: Board = A3) -> np.ndarray:
    """(480, 640, 3): a board at one of the places, with other noise each time."""
    return np.repeat(picture(board, at=PLACES[place], seed=seed)[:, :, None], 3, axis=2)


def test_a_view_is_taken_once_and_only_at_rest(tmp_path):
    taker = ViewTaker(A3, tmp_path / "p")
    first = taker.offer(shown(0, 1))
    assert (first.taken, first.text) == (None, "the board is seen: hold it still")
    second = taker.offer(shown(0, 2))
    assert second.taken == tmp_path / "p" / "000.png"
    assert second.text.startswith(f"000.png: view 1, {A3.corners} corners; next ")
    assert np.array_equal(read_picture(second.taken), shown(0, 2)[:, :, 0])
    assert "this view is taken" in taker.offer(shown(0, 3)).text
    # On the way to another place it is not at rest, and without a board nothing is.
    assert taker.offer(shown(1, 4)).taken is None
    assert "grey levels between black and white" in taker.offer(np.full((480, 640, 3), 90, np.uint8)).text
    assert "hold it still" in taker.offer(shown(1, 5)).text
    assert taker.offer(shown(1, 6)).views == 2
    assert taker.cells.sum() == 2 * A3.corners
    # Another taker goes on in the same folder, numbers and views.
    later = ViewTaker(A3, tmp_path / "p")
    assert np.array_equal(later.cells, taker.cells)
    later.offer(shown(1, 7))
    assert "this view is taken" in later.offer(shown(1, 8)).text
    later.offer(shown(2, 9))
    assert later.offer(shown(2, 10)).taken == tmp_path / "p" / "002.png"


def test_half_a_picture_of_each_place_is_not_taken(tmp_path):
    """A snapshot comes in pieces of several images: while the board moves, it is torn."""
    taker = ViewTaker(A3, tmp_path)
    taker.offer(shown(0, 1))
    torn = np.concatenate([shown(0, 2)[:240], shown(1, 2)[240:]])
    assert taker.offer(torn).taken is None
    assert taker.offer(shown(1, 3)).taken is None


def test_where_corners_are_wanted(tmp_path):
    taker = ViewTaker(A3, tmp_path)
    taker.cells[:] = 5
    taker.cells[4:, 5:] = 0
    assert taker.wanted() == "at the lower right"
    taker.cells[:] = 5
    taker.cells[2:4, 3:5] = 0
    assert taker.wanted() == "in the middle"
    assert taker.coverage().splitlines()[2].split() == ["5", "5", "5", ".", ".", "5", "5", "5"]


def test_a_mirrored_picture_ends_it(tmp_path):
    with pytest.raises(CalibrationError, match="mirrored"):
        ViewTaker(A3, tmp_path).offer(shown(0, 1)[:, ::-1])


def write_frames(folder: Path) -> list[np.ndarray]:
    """Two places one after another in small pictures, for which a chessboard suffices; each is shown long enough for
    three snapshots, which take some 40 images.
    """
    (folder / "shown").mkdir()
    small = [cv2.resize(shown(place, place, CHESS), (160, 120), interpolation=cv2.INTER_AREA) for place in range(2)]
    lines = ["frame,angle_start_deg,angle_end_deg"]
    for number in range(2 * EACH):
        cv2.imwrite(str(folder / "shown" / f"{number:03}.png"), small[number // EACH])
        lines.append(f"{number},0,0")
    (folder / "angles.csv").write_text("\n".join(lines) + "\n")
    return small


def test_live_through_the_virtual_card(tmp_path):
    places, out, folder = write_frames(tmp_path), tmp_path / "camera.json", tmp_path / "taken"
    shows = ["--frames", tmp_path / "shown", "--angles", tmp_path / "angles.csv", "--frame-rate", "200"]
    with virtual_card(tmp_path / "card", *shows):
        done = run(
            "magtrak", "calibrate", "camera", folder, "--live", tmp_path / "card", "--views", "2", "--output", out,
            "--pattern", "chessboard", "--square", "60", "--columns", "6", "--rows", "5",
        )  # fmt: skip
    print(done.stdout, done.stderr)
    assert "001.png: view 2, 20 corners" in done.stdout
    # Both are kept, and then found to be too few: nothing measured gets lost.
    assert done.returncode == 1
    assert done.stderr.strip().endswith("take 6 more, with the board tilted, near and far")
    kept = [cv2.imread(str(path)) for path in sorted(folder.iterdir())]
    assert len(kept) == 2
    assert all(np.array_equal(one, other) for one, other in zip(kept, places, strict=True))
