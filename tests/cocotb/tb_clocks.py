"""The card whose pixels have a clock of their own: to host and camera it is the card of one clock."""

import os

import cocotb
import numpy as np
from cocotb.triggers import FallingEdge
from cocotb.utils import get_sim_time

from magtrak.protocol import CAMERA_ERRORS, AmbientMode, AnswerCode, Phase, SnapshotSource
from magtrak.reference import Background, measure, mix, snapshot
from tests.cocotb.card import PERIOD_NS, CardDriver
from tests.cocotb.tb_core import TABLES, apply, compare, new_card, random_image, random_settings

PIXEL_PS = int(os.environ["PIXEL_PS"])
OPEN = np.ones((3, 256), bool)


async def card_of(dut) -> CardDriver:
    return await new_card(dut, stalls=0.0, pixel_ps=PIXEL_PS)


async def clocks(card: CardDriver, count: int) -> None:
    for _ in range(count):
        await FallingEdge(card.dut.clk)


async def running(dut):
    """A card that measures, with settings that find the line, and these settings."""
    card = await card_of(dut)
    settings, _ = random_settings(card.rng, 32)
    settings |= {"floor": 20, "weight_r": 85, "weight_g": 86, "weight_b": 85, "run_width_max": 4095, "detector": 2}
    settings |= {"column_first": 0, "column_last": 4095}
    await apply(card, settings, OPEN, 1)
    await card.write("run", 1)
    return card, settings


@cocotb.test()
async def test_every_image_has_the_settings_of_its_generation(dut):
    """The host never stops writing settings and tables, and the camera never stops; commits come at any time."""
    card = await card_of(dut)
    rng = card.rng
    sets, images = {}, []
    await apply(card, *sets.setdefault(1, random_settings(rng, 40)), 1)
    await card.write("run", 1)
    done = []

    async def host():
        for generation in range(2, 9):
            settings, _ = sets[generation - 1]
            new, tables = random_settings(rng, 40)
            changed = {name: value for name, value in new.items() if value != settings[name] and rng.random() < 0.5}
            sets[generation] = (settings | changed, tables)
            await apply(card, changed, tables, generation)
            while await card.read("pending"):
                pass
            assert await card.read("generation") == generation
        done.append(1)

    cocotb.start_soon(host())
    while not done or len(images) % 4:
        images.append(random_image(rng, rng.choice([8, 10, 13]), rng.choice([17, 40, 64])))
        await card.show(images[-1], rng.choice([0.0, 0.3]), 180 + rng.randrange(100))
    frames = await last_frames(card, len(images))
    for frame in frames:
        assert frame.header["camera_errors"] == 0
        compare(frame, images[frame.header["frame"]], *sets[frame.header["generation"]])
    generations = [frame.header["generation"] for frame in frames]
    assert generations == sorted(generations)
    assert len(set(generations)) > 4, generations


async def last_frames(card: CardDriver, images: int):
    """All frames; what the link was too slow for was dropped, and counted."""
    await clocks(card, 3000)
    assert await card.read("frames") == images
    frames = list(card.frames)
    assert len(frames) + await card.read("dropped") == images
    assert card.damaged == 0
    return frames


@cocotb.test()
async def test_snapshots_are_whole(dut):
    card, _ = await running(dut)
    rng = card.rng
    image = random_image(rng, 12, 64)
    wanted = {
        "source": SnapshotSource.RAW,
        "step": 2,
        "column_first": 3,
        "column_last": 60,
        "row_first": 1,
        "row_last": 9,
    }
    for name, value in wanted.items():
        await card.write(f"snapshot_{name}", value)
    assert await card.read("snapshot_busy") == 0
    await card.write("snapshot", 7)
    assert await card.read("snapshot_busy") == 1
    for _ in range(30):
        await card.show(image, pause=8000)  # a piece has to fit between two frames
        if card.pieces and card.pieces[-1][0]["pixels"] == 0:
            break
    assert await card.read("snapshot_busy") == 0
    pieces = snapshot(image, (3, 60), (1, 9), 2)
    assert len(card.pieces) == len(pieces)
    for (header, data), piece in zip(card.pieces[:-1], pieces[:-1], strict=True):
        assert (header["row"], header["column"], header["generation"]) == (piece.row, piece.column, 1)
        assert data == piece.pixels.tobytes()


@cocotb.test()
async def test_a_clock_that_stands_still_holds_up_nothing_else(dut):
    """Within an image; it ends as it was begun when the clock goes on, and one word of a table was kept."""
    card, settings = await running(dut)
    rng = card.rng
    images = [random_image(rng, 10, 32) for _ in range(3)]
    camera = cocotb.start_soon(card.show(images[0], pause=200))
    await clocks(card, 60)
    card.pixel_clock.stop()
    await clocks(card, 20_000)
    assert not camera.done()
    assert await card.read("clock_hz")
    assert await card.write("floor", 30) == AnswerCode.DONE
    assert await card.write("lut_hue", 0, 2) == AnswerCode.DONE
    assert await card.write("lut_hue", 0, 3) == AnswerCode.NO_CLOCK
    assert await card.write("floor", 40) == AnswerCode.DONE
    assert await card.write("lut_luminance", 0, 0) == AnswerCode.NO_CLOCK
    assert not card.frames
    card.pixel_clock.start()
    await camera
    assert await card.write("lut_luminance", 0xFFFF_FFFF, 0) == AnswerCode.DONE
    for number in set(range(8)) - {2}:
        assert await card.write("lut_hue", 0xFFFF_FFFF, number) == AnswerCode.DONE
    for name in TABLES[1:]:
        for number in range(8):
            assert await card.write(name, 0xFFFF_FFFF, number) == AnswerCode.DONE
    await card.write("commit", 2)
    for image in images[1:]:
        await card.show(image, pause=200)
    frames = await last_frames(card, 3)
    luts = OPEN.copy()
    luts[0, 64:96] = False
    for frame in frames:
        late = frame.header["generation"] == 2
        assert late == (frame.header["frame"] > 0)
        assert frame.header["camera_errors"] == 0
        compare(
            frame, images[frame.header["frame"]], settings | ({"floor": 40} if late else {}), luts if late else OPEN
        )
    assert frames[-1].header["frame"] == 2


@cocotb.test()
async def test_backgrounds_are_subtracted(dut):
    card, settings = await running(dut)
    rng = card.rng
    await card.write("ambient_mode", AmbientMode.ALTERNATE)
    await card.write("commit", 2)
    settings["ambient_mode"] = AmbientMode.ALTERNATE
    room, phases = random_image(rng, 12, 40) // 2, "UBMBM"
    for number, name in enumerate(phases):
        image = np.maximum(room, random_image(rng, 12, 40) if name in "UM" else room)
        await card.show(image, pause=1500)
        await card.until("a frame", lambda: card.frames)
        frame = card.frames.popleft()
        phase = next(phase for phase in Phase if phase.name.startswith(name))
        assert (frame.header["frame"], frame.header["phase"]) == (number, phase)
        if name in "UM":
            background = Background.of(mix(room, settings), 0) if name == "M" else None
            expected = measure(image, settings, OPEN, background)
            got = [tuple(row[name] for name in expected.dtype.names) for row in frame.rows]
            assert got == [tuple(int(value) for value in record) for record in expected]
    # While no images are wanted, the next one is to be lit again.
    await card.write("run", 0)
    await card.show(room, pause=500)
    await card.write("run", 1)
    await card.show(room, pause=1500)
    await card.until("a frame", lambda: card.frames)
    assert card.frames.popleft().header["phase"] in (Phase.MEASURED, Phase.UNSUBTRACTED)


@cocotb.test()
async def test_stamps_are_as_late_as_they_say(dut):
    """Between any two first pixels, by the simulator's time: half a clock to either side."""
    card, _ = await running(dut)
    errors = []
    for _ in range(12):
        await FallingEdge(card.pixel_clk)
        before = get_sim_time("ps")
        await card.show(np.zeros((10, 32, 3), np.uint8), pause=1500 + card.rng.randrange(50))
        await card.until("a frame", lambda: card.frames)
        header = card.frames.popleft().header
        errors.append(header["first_time"] - before / (1000 * PERIOD_NS))
        rows = (header["last_time"] - header["first_time"]) * 1000 * PERIOD_NS / PIXEL_PS
        assert abs(rows - 9 * 48) <= 1000 * PERIOD_NS / PIXEL_PS
    assert max(errors) - min(errors) <= 1, errors


@cocotb.test()
async def test_noise_ends_with_the_noise(dut):
    card, settings = await running(dut)
    rng = card.rng
    await FallingEdge(card.pixel_clk)
    for _ in range(4000):
        begins = rng.random() < 0.02
        dut.video_valid.value = rng.random() < 0.8
        dut.video_frame_first.value = begins
        dut.video_row_first.value = begins or rng.random() < 0.05
        dut.video_row_last.value = rng.random() < 0.05
        dut.video_frame_end.value = rng.random() < 0.02
        await FallingEdge(card.pixel_clk)
    dut.video_valid.value = 0
    dut.video_frame_end.value = 1
    await FallingEdge(card.pixel_clk)
    dut.video_frame_end.value = 0
    for _ in range(1000):
        await FallingEdge(card.pixel_clk)
    await clocks(card, 2000)
    assert await card.read("camera_errors")
    number = await card.read("frames")
    assert len(card.frames) + await card.read("dropped") == number
    card.frames.clear()
    images = [random_image(rng, 10, 32) for _ in range(2)]
    for image in images:
        await card.show(image, pause=2000)
    await card.until("two frames", lambda: len(card.frames) == 2)
    assert [frame.header["frame"] for frame in card.frames] == [number, number + 1]
    # The errors of the last clocks of noise may be the first image's.
    first, second = card.frames
    assert second.header["camera_errors"] == 0
    compare(second, images[1], settings, OPEN)
    if not first.header["camera_errors"]:
        compare(first, images[0], settings, OPEN)


@cocotb.test()
async def test_a_clock_that_is_too_fast_is_told(dut):
    """Nine times the card's: the settings come too late, and each row and its image say so."""
    card, _ = await running(dut)
    for _ in range(3):
        await card.show(random_image(card.rng, 10, 64), pause=9000)
    await card.until("frames", lambda: len(card.frames) == 3)
    for frame in card.frames:
        assert CAMERA_ERRORS.unpack(frame.header["camera_errors"].to_bytes(CAMERA_ERRORS.size, "little"))["framing"]
        assert all(row["overflow"] for row in frame.rows)
