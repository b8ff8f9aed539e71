"""The whole card as host and camera see it; started by ``test_cocotb.py``."""

import random

import cocotb
import numpy as np
from cocotb.triggers import FallingEdge

from magtrak import protocol
from magtrak.protocol import Access, AnswerCode, Packet, PacketType, Scope
from magtrak.reference import measure, words_from_luts
from tests.cocotb.card import CLOCK_HZ, CardDriver

TABLES = ("lut_hue", "lut_luminance", "lut_saturation")


async def new_card(dut, **options) -> CardDriver:
    seed = cocotb.RANDOM_SEED
    cocotb.log.info("seed %d", seed)
    card = CardDriver(dut, random.Random(seed), **options)
    await card.start()
    cocotb.start_soon(card.link())
    return card


def random_image(rng: random.Random, rows: int, columns: int) -> np.ndarray:
    """Noise, and in most rows a green line that may be over-exposed, or two."""
    numbers = np.random.default_rng(rng.randrange(1 << 32))
    image = numbers.integers(0, rng.choice([2, 20, 256]), (rows, columns, 3)).astype(float)
    for y in range(rows):
        for _ in range(rng.choice([0, 1, 1, 1, 2])):
            centre, sigma, height = rng.uniform(-3, columns + 3), rng.uniform(0.5, 4), rng.choice([60, 180, 1200])
            light = height * np.exp(-((np.arange(columns) - centre) ** 2) / (2 * sigma**2))
            image[y] += light[:, None] * [0.25, 1.0, 0.3]
    return image.clip(0, 255).astype(np.uint8)


def random_settings(rng: random.Random, columns: int) -> tuple[dict[str, int], np.ndarray]:
    settings = {r.name: r.init for r in protocol.REGISTERS if r.scope is Scope.FRAME and r.access is Access.BOTH}
    settings |= {
        "weight_r": rng.choice([85, -128, rng.randrange(-512, 512)]),
        "weight_g": rng.choice([86, 256, rng.randrange(-512, 512)]),
        "weight_b": rng.choice([85, -128, rng.randrange(-512, 512)]),
        "floor": rng.choice([0, 20, rng.randrange(256)]),
        "run_gated": rng.choice([0, 1, 3]),
        "run_reach": rng.randrange(16),
        "run_bridge": rng.choice([0, 0, 2, 15]),
        "run_width_min": rng.choice([0, 1, 3]),
        "run_width_max": rng.choice([4095, 12]),
        "column_first": rng.choice([0, 0, rng.randrange(columns)]),
        "column_last": rng.choice([4095, rng.randrange(columns)]),
        "detector": rng.choice(list(protocol.Detector)),
        "ambiguous_ratio": rng.randrange(256),
    }
    luts = np.ones((3, 256), bool)
    if rng.random() < 0.8:
        luts[0] = [60 <= hue <= 120 for hue in range(256)]
        luts[2, : rng.randrange(100)] = False
    return settings, luts


async def apply(card: CardDriver, settings: dict[str, int], luts: np.ndarray, generation: int) -> None:
    for name, value in settings.items():
        assert await card.write(name, value) == AnswerCode.DONE, name
    for name, words in zip(TABLES, words_from_luts(luts), strict=True):
        for number, word in enumerate(words):
            assert await card.write(name, word, number) == AnswerCode.DONE
    assert await card.write("commit", generation) == AnswerCode.PENDING


def compare(frame, image: np.ndarray, settings: dict[str, int], luts: np.ndarray) -> None:
    expected = measure(image, settings, luts)
    assert frame.header["rows"] == len(image)
    assert frame.header["columns"] == image.shape[1]
    for y, (row, record) in enumerate(zip(frame.rows, expected, strict=True)):
        wanted = {name: int(record[name]) for name in record.dtype.names}
        assert row == wanted, f"row {y}: {row}, not {wanted}; {settings}"


@cocotb.test()
async def test_greeting(dut):
    card = await new_card(dut)
    assert await card.read("magic") == protocol.MAGIC
    assert await card.read("version") == protocol.VERSION
    assert await card.read("map_hash") == protocol.map_hash()
    assert await card.read("clock_hz") == CLOCK_HZ
    assert await card.read("run") == 0


@cocotb.test()
async def test_commands_are_checked(dut):
    card = await new_card(dut)
    assert await card.write("motor_period", 15) == AnswerCode.OUT_OF_RANGE
    assert await card.write("magic", 1) == AnswerCode.NOT_ALLOWED
    answer = await card.command(PacketType.READ, 0xFFFF)
    assert answer["code"] == AnswerCode.UNKNOWN_ADDRESS
    answer = await card.command(0x85, 0)
    assert answer["code"] == AnswerCode.UNKNOWN_TYPE
    good = protocol.frame_packet(Packet(PacketType.WRITE, 9, protocol.COMMAND.pack({"address": 0x10, "value": 1})))
    for position in range(len(good) - 1):
        damaged = bytearray(good)
        damaged[position] ^= 1 << card.rng.randrange(8)
        if 0 in damaged[:-1]:
            damaged[position] = 0xA5
        card.send_raw(bytes(damaged))
    assert await card.read("run") == 0
    assert await card.read("damaged_commands") >= len(good) - 1


@cocotb.test()
async def test_images_are_measured_bit_for_bit(dut):
    card = await new_card(dut)
    rng = card.rng
    assert await card.write("run", 1) == AnswerCode.DONE
    for generation in range(1, 25):
        columns = rng.choice([16, 17, 40, 64])
        settings, luts = random_settings(rng, columns)
        await apply(card, settings, luts, generation)
        for _ in range(2):
            image = random_image(rng, rng.choice([1, 2, 8]), columns)
            await card.show(image, gaps=rng.choice([0.0, 0.0, 0.4]))
            await card.until("a frame", lambda: card.frames)
            frame = card.frames.popleft()
            assert frame.header["generation"] == generation
            assert frame.header["camera_errors"] == 0
            compare(frame, image, settings, luts)
    assert card.damaged == 0


@cocotb.test()
async def test_a_host_that_does_not_read_loses_whole_images(dut):
    card = await new_card(dut, stalls=0.0)
    rng = card.rng
    settings, luts = random_settings(rng, 32)
    await apply(card, settings, luts, 7)
    await card.write("run", 1)
    card.listening = False
    images = [random_image(rng, 6, 32) for _ in range(6)]
    for image in images:
        await card.show(image)
    card.listening = True
    await card.until("the frames that were kept", lambda: len(card.frames) == 2)
    last = random_image(rng, 6, 32)
    await card.show(last)
    await card.until("the next frame", lambda: len(card.frames) == 3)
    assert await card.read("dropped") == 4
    first, second, third = card.frames
    # The first was under way; the second gave way to newer ones.
    assert [frame.header["frame"] for frame in card.frames] == [0, 5, 6]
    assert [frame.header["dropped"] for frame in card.frames] == [0, 4, 4]
    compare(first, images[0], settings, luts)
    compare(second, images[5], settings, luts)
    compare(third, last, settings, luts)
    assert card.damaged == 0


@cocotb.test()
async def test_angle_latches_and_edge_log(dut):
    card = await new_card(dut, stalls=0.0)
    await card.write("run", 1)
    image = np.zeros((4, 32, 3), np.uint8)
    await card.show(image)

    async def turn(steps: int) -> None:
        for step in steps:
            dut.encoder_a.value = int(step % 4 in (1, 2))
            dut.encoder_b.value = int(step % 4 in (2, 3))
            for _ in range(40):
                await FallingEdge(dut.clk)

    await turn([1, 2, 3, 4, 5])
    dut.index.value = 1
    for _ in range(20):
        await FallingEdge(dut.clk)
    await turn([6, 7, 6, 5])
    await card.show(image)
    await card.until("two frames", lambda: len(card.frames) == 2)
    before, after = card.frames
    assert before.header["first_count"] == 0
    assert before.header["flags"] & 1 == 0
    assert after.header["first_count"] == after.header["last_count"] == 5
    assert after.header["flags"] & 1 == 1
    assert after.header["index_count"] == 5
    assert after.header["index_passes"] == 1
    assert [(edge["count"], edge["backward"]) for edge in after.edges] == [
        (1, 0),
        (2, 0),
        (3, 0),
        (4, 0),
        (5, 0),
        (6, 0),
        (7, 0),
        (6, 1),
        (5, 1),
    ]
    times = [edge["time"] for edge in after.edges]
    assert np.diff(times).tolist() == [40] * 4 + [60] + [40] * 3
    rows = 48 * 3
    assert after.header["last_time"] - after.header["first_time"] == rows
    assert after.header["first_age"] == after.header["first_time"] - times[-1]
