"""RGB565, and what the card makes of it."""

import numpy as np
import pytest
from PIL import Image

from magtrak.reference import gate, luts_from_words, measure
from magtrak.settings_file import PRESETS, load_settings
from sim.quantise import rgb565
from tests.support.pictures import folder


def preset(name: str):
    settings = load_settings(name)
    values = {name: words[0] for name, words in settings.register_values(50e6)}
    return values, luts_from_words([list(words) for _, words in settings.tables()])


def test_by_hand():
    colours = [(0, 0, 0), (255, 255, 255), (7, 3, 7), (8, 4, 8), (0x94, 0x92, 0x6F), (248, 252, 248)]
    expected = [(0, 0, 0), (255, 255, 255), (0, 0, 0), (8, 4, 8), (0x94, 0x92, 0x6B), (255, 255, 255)]
    assert rgb565(np.array(colours, np.uint8)).tolist() == [list(colour) for colour in expected]


@pytest.mark.parametrize("name", PRESETS)
def test_presets_pass_their_laser_in_fewer_bits(name):
    """From a quarter of full scale to where it turns white."""
    _, luts = preset(name)
    light = np.linspace(60, 255, 196)[:, None]
    colour = [1.0, 0.16, 0.12] if name.startswith("red") else [0.16, 1.0, 0.12]
    line = (light * colour).round().astype(np.uint8)
    other = line[:, [1, 0, 2]]
    for pixels, passes in ((line, True), (other, False)):
        for some in (pixels, rgb565(pixels)):
            assert (gate(some, luts) == passes).all()


def test_real_lines_stay_where_they_are():
    values, luts = preset("red")
    for path in sorted(folder("board_distances").glob("*.png"))[::3]:
        with Image.open(path) as file:
            picture = np.asarray(file.convert("RGB"))
        full, fewer = (measure(some, values, luts)[100:330] for some in (picture, rgb565(picture)))
        assert full["valid"].all() and fewer["valid"].all() and not fewer["ambiguous"].any()
        difference = (full["position"] - fewer["position"]) / 256
        print(f"{path.name}: {np.sqrt(np.mean(difference**2)):.4f} px RMS")
        assert np.sqrt(np.mean(difference**2)) < 0.012
