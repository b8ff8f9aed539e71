"""Block RAM: what is promised, and that the tests of this folder see where nothing is."""

import random

from gateware.layouts import Pixel
from gateware.memory import BlockRam
from tests.support.simulation import simulate

DEPTH = 12
BITS = 8


def run(moves):
    """What is read in the clock after each of ``moves``: write enable, address, word, read enable, address."""
    dut = BlockRam(BITS, DEPTH)
    seen = []

    async def testbench(ctx):
        for write, at, word, read, from_ in moves:
            ctx.set(dut.write.en, write)
            ctx.set(dut.write.addr, at)
            ctx.set(dut.write.data, word)
            ctx.set(dut.read.en, read)
            ctx.set(dut.read.addr, from_)
            await ctx.tick()
            seen.append(ctx.get(dut.read.data))

    simulate(dut, testbench)
    return seen


def test_reads_what_was_written_unless_both_meet():
    rng = random.Random(1)
    moves = [
        (rng.random() < 0.5, rng.randrange(DEPTH), rng.randrange(1 << BITS), rng.random() < 0.7, rng.randrange(DEPTH))
        for _ in range(2000)
    ]
    words, held, met = [0] * DEPTH, 0, 0
    for move, got in zip(moves, run(moves), strict=True):
        write, at, word, read, from_ = move
        if read:
            collision = write and at == from_
            held = words[from_] ^ (0xFF if collision else 0)
            met += collision
        if write:
            words[at] = word
        assert got == held, move
    assert met > 20


def test_a_word_may_be_a_struct():
    dut = BlockRam(Pixel, 4)

    async def testbench(ctx):
        ctx.set(dut.write.data, {"g": 200, "row_last": 1})
        ctx.set(dut.write.addr, 3)
        ctx.set(dut.write.en, 1)
        await ctx.tick()
        ctx.set(dut.read.addr, 3)
        ctx.set(dut.write.en, 0)
        await ctx.tick()
        assert ctx.get(dut.read.data.g) == 200 and ctx.get(dut.read.data.row_last)

    simulate(dut, testbench)
