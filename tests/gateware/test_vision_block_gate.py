"""The gate in block RAM: every entry, banks, and colours against the reference."""

import numpy as np

from gateware.vision.block_gate import BlockGate
from magtrak.reference import hls, words_from_luts
from tests.support.simulation import simulate
from tests.support.vision import random_luts

SEED = 6
ALL = np.ones((3, 256), bool)


async def write(ctx, dut, luts: np.ndarray) -> None:
    """All words, as fast as they may come; after each, data are other ones."""
    for axis, words in enumerate(words_from_luts(luts)):
        for word, value in enumerate(words):
            ctx.set(dut.lut.axis, axis)
            ctx.set(dut.lut.word, word)
            ctx.set(dut.lut.data, value)
            ctx.set(dut.lut.valid, 1)
            await ctx.tick()
            ctx.set(dut.lut.valid, 0)
            await ctx.tick().repeat(BlockGate.write_clocks - 1)
            ctx.set(dut.lut.data, 0xA5A5_5A5A)
            ctx.set(dut.lut.axis, 3)


async def swap(ctx, dut, written: int = 0b111) -> None:
    ctx.set(dut.lut.written, written)
    ctx.set(dut.lut.swap, 1)
    await ctx.tick()
    ctx.set(dut.lut.swap, 0)


async def passes(ctx, dut, colours: np.ndarray) -> list[int]:
    results = []
    for r, g, b in colours.tolist() + [[0, 0, 0]] * dut.latency:
        ctx.set(dut.r, r)
        ctx.set(dut.g, g)
        ctx.set(dut.b, b)
        _, _, bit = await ctx.tick().sample(dut.o)
        results.append(bit)
    return results[dut.latency :]


def test_nothing_passes_after_reset():
    async def testbench(ctx):
        assert not any(await passes(ctx, dut, np.random.default_rng(SEED).integers(0, 256, (200, 3))))

    dut = BlockGate()
    simulate(dut, testbench)


def colours_of_all(axis: int) -> np.ndarray:
    """A colour for each hue, luminance or saturation. Saturation 254 has none."""
    rng = np.random.default_rng(axis)
    greys = np.arange(256)[:, None]
    colours = np.concatenate((rng.integers(0, 256, (60_000, 3)), greys.repeat(3, axis=1), greys ^ [0, 0, 1]))
    colours = colours.astype(np.uint8)
    value, first = np.unique(hls(colours)[axis], return_index=True)
    assert set(range(256)) - set(value.tolist()) == ({254} if axis == 2 else set())
    return colours[first]


def test_every_entry_of_each_table():
    async def testbench(ctx):
        for axis in range(3):
            colours = colours_of_all(axis)
            luts = ALL.copy()
            luts[axis] = np.random.default_rng(axis).random(256) < 0.5
            await write(ctx, dut, luts)
            await swap(ctx, dut)
            assert await passes(ctx, dut, colours) == luts[axis][hls(colours)[axis]].tolist()

    dut = BlockGate()
    simulate(dut, testbench)


def test_the_idle_bank_waits_for_the_swap_of_its_table():
    colours = np.random.default_rng(SEED).integers(0, 256, (50, 3))

    async def testbench(ctx):
        await write(ctx, dut, ALL)
        assert not any(await passes(ctx, dut, colours))
        await swap(ctx, dut, 0b011)
        assert not any(await passes(ctx, dut, colours))
        await swap(ctx, dut, 0b100)
        assert all(await passes(ctx, dut, colours))
        await write(ctx, dut, ~ALL)
        assert all(await passes(ctx, dut, colours))
        await swap(ctx, dut, 0)
        assert all(await passes(ctx, dut, colours))
        for axis in range(3):
            await swap(ctx, dut, 1 << axis)
            assert not any(await passes(ctx, dut, colours))
            await swap(ctx, dut, 1 << axis)

    dut = BlockGate()
    simulate(dut, testbench)


def test_against_the_reference():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)

    async def testbench(ctx):
        for _ in range(4):
            luts, colours = random_luts(rng), rng.integers(0, 256, (1200, 3)).astype(np.uint8)
            await write(ctx, dut, luts)
            await swap(ctx, dut)
            assert await passes(ctx, dut, colours) == BlockGate.reference(colours, luts).tolist()

    dut = BlockGate()
    simulate(dut, testbench)
