"""Gates learned from pictures: made ones, real ones, and those from which nothing can be learned."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from magtrak.cli.magtrak import main
from magtrak.errors import LearnError
from magtrak.learn import Sample, _hues, from_pair, from_patch, learn, read_picture, share
from magtrak.learned import toml
from magtrak.reference import Background, luts_from_words, measure, mix
from magtrak.settings import Gate, Settings
from magtrak.settings_file import PRESETS, load_settings, load_values, parse_settings
from sim.quantise import rgb565
from tests.support.pictures import folder

RED, GREEN = (255, 40, 60), (30, 255, 60)


def scene(colour: tuple[int, int, int] | None, *, amplitude: float = 1.0, seed: int = 3) -> np.ndarray:
    """A line of that colour in a grey room with a blue thing; 60 x 80."""
    rng = np.random.default_rng(seed)
    image = np.full((60, 80, 3), 40.0)
    image[35:50, 50:70] = (20, 30, 120)
    if colour is not None:
        light = np.exp(-((np.arange(80) - 30.3) ** 2) / 4.5)
        image += amplitude * light[:, None] * np.array(colour)
    return (image + rng.normal(0, 2, image.shape)).clip(0, 255).astype(np.uint8)


def luts(gate: Gate) -> np.ndarray:
    return luts_from_words([list(words) for _, words in Settings(gate=gate).tables()])


@pytest.mark.parametrize("change", [lambda image: image, rgb565], ids=["RGB888", "RGB565"])
@pytest.mark.parametrize("colour", [RED, GREEN])
def test_line_passes_and_the_room_does_not(colour, change):
    on, off = change(scene(colour)), change(scene(None, seed=4))
    for sample in (from_pair(on, off), from_patch(on, 26, 5, 9, 20)):
        tables = luts(learn(sample))
        print(learn(sample), share(sample.line, tables), share(off.reshape(-1, 3), tables))
        assert len(sample.line) >= 60
        assert share(sample.line, tables) >= 0.9
        assert share(off.reshape(-1, 3), tables) <= 0.01
        other = np.array([[RED, GREEN][colour == RED], (20, 30, 120), (128, 128, 128)], np.uint8)
        assert share(other, tables) == 0


def test_hues_through_zero_and_in_pieces():
    line = np.array([[200, 10, 10], [200, 10, 30], [200, 30, 10]] * 20 + [[150, 10, 200]] * 20, np.uint8)
    gate = learn(Sample(line, np.array([[10, 200, 10]] * 50, np.uint8)))
    assert len(gate.hue) == 2
    assert any(first > last for first, last in gate.hue)
    assert share(line, luts(gate)) == 1.0
    assert _hues(np.ones(256, bool)) == ((0.0, 360.0),)


def test_patches_that_tell_nothing():
    picture = scene(RED)
    picture[:10, :10] = 0
    picture[10:20, :10] = 250
    for patch, why in (
        ((75, 0, 10, 10), "not within the picture of 80 x 60"),
        ((0, 0, 0, 5), "not within"),
        ((0, 0, 3, 5), "has 15 pixels: draw it larger"),
        ((0, 0, 10, 10), "is dark, 0 of 255"),
        ((0, 10, 10, 10), "is white, 100 % of its bright pixels are over-exposed"),
        ((0, 30, 10, 10), "has no hue"),
    ):
        with pytest.raises(LearnError, match=why):
            from_patch(picture, *patch)


def test_pairs_that_tell_nothing():
    on, off = scene(RED), scene(None, seed=4)
    with pytest.raises(LearnError, match="80 x 60 and 80 x 59 pixels"):
        from_pair(on, off[1:])
    with pytest.raises(LearnError, match="too alike, or differ everywhere: only 0 pixels"):
        from_pair(off, scene(None, seed=5))
    with pytest.raises(LearnError, match="too alike"):  # the other way round
        from_pair(off, on)
    rng = np.random.default_rng(1)
    with pytest.raises(LearnError, match="differ everywhere"):
        blobs = np.kron(rng.integers(0, 2, (30, 40, 1)), np.ones((2, 2, 1))) * np.array(RED)
        from_pair(blobs.astype(np.uint8), off)


def test_exposure_may_differ():
    on, off = scene(RED), (scene(None, seed=4) * 0.6).astype(np.uint8)
    assert share(off.reshape(-1, 3), luts(learn(from_pair(on, off)))) <= 0.01


@pytest.mark.parametrize("name", PRESETS)
def test_settings_are_written_as_they_were(name):
    values = load_values(name)
    assert parse_settings(tomllib.loads(toml(values))) == load_settings(name)


def run(*options: object):
    return CliRunner().invoke(main, ["learn-gate", *map(str, options)], prog_name="magtrak")


def test_command(tmp_path):
    on, off, out = tmp_path / "on.png", tmp_path / "off.png", tmp_path / "learned.toml"
    Image.fromarray(scene(RED)).save(on)
    Image.fromarray(scene(None, seed=4)).save(off)
    done = run("--on", on, "--off", off, "--settings", "red-daylight", "--output", out)
    assert done.exit_code == 0, done.output
    assert "of the line" in done.output and "of the rest" in done.output
    settings, base = load_settings(str(out)), load_settings("red-daylight")
    assert settings.gate != base.gate
    assert (settings.weight, settings.peak) == (base.weight, base.peak)
    done = run("--picture", on, "--patch", 26, 5, 9, 20, "--output", out)
    assert done.exit_code == 0, done.output
    assert "patch" in out.read_text()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ((), "give either --picture FILE with --patch"),
        (("--on", "on.png"), "give either"),
        (("--on", "on.png", "--off", "none.png"), "none.png does not exist"),
        (("--on", "on.png", "--off", "text.png"), "text.png cannot be read"),
        (("--on", "on.png", "--off", "on.png"), "too alike"),
        (("--on", "on.png", "--off", "off.png", "--settings", "blue"), "'blue' are not known"),
        (("--on", "on.png", "--off", "off.png", "--output", "none/x.toml"), "cannot be written"),
    ],
)
def test_command_refuses(tmp_path, monkeypatch, capsys, options, why):
    monkeypatch.chdir(tmp_path)
    Image.fromarray(scene(RED)).save("on.png")
    Image.fromarray(scene(None, seed=4)).save("off.png")
    Path("text.png").write_text("no picture")
    done = run("--output", "out.toml", *options)
    assert done.exit_code == 1
    (line,) = done.stderr.splitlines()
    assert why in line
    assert not Path("out.toml").exists()


def rows_right(pictures, truths, values, tables) -> float:
    """Share of all rows whose place is known, with the background subtracted."""
    right = known = 0
    for (off, on), truth in zip(pictures, truths, strict=True):
        record = measure(on, values, tables, Background.of(mix(off, values), 1))
        found = (record["valid"] == 1) & (np.abs(record["position"] / 256 - truth) <= 4)
        right += np.sum(found & (truth >= 0))
        known += np.sum(truth >= 0)
    return right / known


@pytest.mark.parametrize("change", [lambda image: image, rgb565], ids=["RGB888", "RGB565"])
def test_learned_from_real_pairs_finds_more_than_the_preset(change):
    """Each pair's own gate, against the one of ``red``; all else as in ``red`` with a lower floor."""
    from tests.system.test_laser_on_off import line, pair

    preset = load_settings("red")
    values = {name: words[0] for name, words in preset.register_values(50e6)} | {"floor": 8}
    shares = []
    for number in (2, 4, 7, 9):
        off, on = pair(number)
        pictures = [tuple(change(image.astype(np.uint8)) for image in (off, on))]
        sample = from_pair(pictures[0][1], pictures[0][0])
        assert share(sample.line, luts(learn(sample))) >= 0.95
        truths = [line(off, on)]
        shares.append([rows_right(pictures, truths, values, luts(gate)) for gate in (preset.gate, learn(sample))])
        print(f"pair {number}: preset {shares[-1][0]:.3f}, learned {shares[-1][1]:.3f}")
    mean = np.mean(shares, axis=0)
    assert mean[1] >= mean[0] + 0.03
    assert mean[1] >= 0.94


def test_learned_from_a_real_patch_is_as_good_as_the_preset():
    """From the farthest board; for all ten."""
    names = sorted(folder("board_distances").glob("*.png"))
    preset = load_settings("red")
    values = {name: words[0] for name, words in preset.register_values(50e6)}
    first = read_picture(names[0])
    column = int(first[215:265].astype(int).sum(axis=(0, 2)).argmax())
    gate = learn(from_patch(first, column - 20, 215, 40, 50))
    for name in names[::3]:
        picture = read_picture(name)
        a, b = (measure(picture, values, luts(some))[100:330] for some in (preset.gate, gate))
        good = [np.sum((record["valid"] == 1) & (record["ambiguous"] == 0)) for record in (a, b)]
        print(name.name, good)
        assert good[1] >= good[0]
        np.testing.assert_array_equal(a["position"], b["position"])
