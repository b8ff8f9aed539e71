"""Folders of pictures, good and bad."""

import numpy as np
import pytest
from PIL import Image

from sim.errors import SimError
from sim.pictures import Pictures


def save(path, picture) -> None:
    Image.fromarray(np.asarray(picture, dtype=np.uint8)).save(path)


def test_reads_in_order_of_name(tmp_path) -> None:
    random = np.random.default_rng(1)
    pictures = random.integers(0, 256, (3, 20, 30, 3), dtype=np.uint8)
    for name, picture in zip(("b.png", "a.bmp", "c.PNG"), pictures, strict=True):
        save(tmp_path / name, picture)
    (tmp_path / "notes.txt").write_text("not a picture")
    found = Pictures(tmp_path)
    assert (len(found), found.width, found.height) == (3, 30, 20)
    assert np.array_equal(found[0], pictures[1])
    assert np.array_equal(np.stack(list(found)), pictures[[1, 0, 2]])


def test_grey_and_transparent_pictures_become_rgb(tmp_path) -> None:
    save(tmp_path / "a.png", np.full((4, 5), 77))
    save(tmp_path / "b.png", np.full((4, 5, 4), 99))
    found = Pictures(tmp_path)
    assert found[0].shape == (4, 5, 3)
    assert np.all(found[0] == 77)
    assert np.all(found[1] == 99)


def test_none(tmp_path) -> None:
    with pytest.raises(SimError, match="there is no picture in"):
        Pictures(tmp_path)
    with pytest.raises(SimError, match=r"nowhere can't be read: No such file"):
        Pictures(tmp_path / "nowhere")


def test_other_size(tmp_path) -> None:
    save(tmp_path / "a.png", np.zeros((20, 30, 3)))
    save(tmp_path / "b.png", np.zeros((30, 20, 3)))
    with pytest.raises(SimError, match=r"b\.png has 20 x 30 pixels, and a\.png has 30 x 20"):
        Pictures(tmp_path)


@pytest.mark.parametrize("kind", ["text", "cut"])
def test_unreadable(tmp_path, kind: str) -> None:
    save(tmp_path / "a.png", np.random.default_rng(2).integers(0, 256, (50, 50, 3)))
    path = tmp_path / "b.png"
    path.write_bytes(b"hello" if kind == "text" else (tmp_path / "a.png").read_bytes()[:3000])
    with pytest.raises(SimError, match=r"the picture .*b\.png can't be read") as error:
        Pictures(tmp_path)
    assert "\n" not in str(error.value)
