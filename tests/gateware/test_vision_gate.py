"""The gate's tables: every entry, banks, and the whole colour path against the reference."""

import numpy as np
from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from gateware.layouts import LutWrite
from gateware.vision.gate import Gate
from gateware.vision.hls import HLS
from magtrak.reference import luts_from_words, words_from_luts
from tests.support.simulation import simulate
from tests.support.vision import load_luts, random_luts

SEED = 5
ALL = np.ones((3, 256), bool)


async def passes(ctx, dut, colours) -> list[int]:
    results = []
    for hue, luminance, saturation in [*colours, *[(0, 0, 0)] * dut.latency]:
        ctx.set(dut.i, {"hue": hue, "luminance": luminance, "saturation": saturation})
        _, _, bit = await ctx.tick().sample(dut.o)
        results.append(bit)
    return results[dut.latency :]


def test_nothing_passes_after_reset():
    dut = Gate()

    async def testbench(ctx):
        assert not any(await passes(ctx, dut, [(n, n, n) for n in range(256)]))

    simulate(dut, testbench)


def test_every_entry_of_each_table():
    dut = Gate()

    async def testbench(ctx):
        for axis in range(3):
            luts = ALL.copy()
            luts[axis] = np.random.default_rng(axis).random(256) < 0.5
            await load_luts(ctx, dut.lut, luts)
            colours = [tuple(n if at == axis else 7 for at in range(3)) for n in range(256)]
            assert await passes(ctx, dut, colours) == luts[axis].tolist()

    simulate(dut, testbench)


def test_idle_bank_waits_for_the_swap():
    dut = Gate()
    probe = [(n, n, n) for n in range(0, 256, 5)]

    async def testbench(ctx):
        await load_luts(ctx, dut.lut, ALL)
        assert all(await passes(ctx, dut, probe))
        for axis in range(3):  # all words of the idle bank written with 0, but not swapped
            for word in range(8):
                ctx.set(dut.lut.valid, 1)
                ctx.set(dut.lut.axis, axis)
                ctx.set(dut.lut.word, word)
                ctx.set(dut.lut.data, 0)
                await ctx.tick()
        ctx.set(dut.lut.valid, 0)
        assert all(await passes(ctx, dut, probe))
        ctx.set(dut.lut.swap, 1)
        await ctx.tick()
        ctx.set(dut.lut.swap, 0)
        assert not any(await passes(ctx, dut, probe))
        ctx.set(dut.lut.written, 0)
        ctx.set(dut.lut.swap, 1)  # nothing was written
        await ctx.tick()
        ctx.set(dut.lut.swap, 0)
        assert not any(await passes(ctx, dut, probe))
        ctx.set(dut.lut.written, 0b111)
        ctx.set(dut.lut.swap, 1)  # back to the bank that was in use
        await ctx.tick()
        ctx.set(dut.lut.swap, 0)
        assert all(await passes(ctx, dut, probe))

    simulate(dut, testbench)


class ColourPath(wiring.Component):
    lut: In(LutWrite())
    r: In(8)
    g: In(8)
    b: In(8)
    o: Out(1)
    latency = HLS.latency + Gate.latency

    def elaborate(self, platform):
        m = Module()
        m.submodules.hls = hls = HLS()
        m.submodules.gate = gate = Gate()
        wiring.connect(m, gate.lut, wiring.flipped(self.lut))
        m.d.comb += [hls.r.eq(self.r), hls.g.eq(self.g), hls.b.eq(self.b), gate.i.eq(hls.o), self.o.eq(gate.o)]
        return m


def test_colours_against_reference():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    dut = ColourPath()

    async def testbench(ctx):
        for _ in range(3):
            luts = random_luts(rng)
            await load_luts(ctx, dut.lut, luts)
            colours = rng.integers(0, 256, (500, 3), dtype=np.uint8)
            results = []
            for colour in colours.tolist() + [[0, 0, 0]] * dut.latency:
                for name, value in zip("rgb", colour, strict=True):
                    ctx.set(getattr(dut, name), value)
                _, _, bit = await ctx.tick().sample(dut.o)
                results.append(bit)
            expected = Gate.reference(colours, luts)
            assert 50 < expected.sum() < 450
            np.testing.assert_array_equal(results[dut.latency :], expected)

    simulate(dut, testbench)


def test_words():
    luts = np.zeros((3, 256), bool)
    luts[0, 0] = luts[1, 33] = luts[2, 255] = True
    words = words_from_luts(luts)
    assert words == [[1, 0, 0, 0, 0, 0, 0, 0], [0, 2, 0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0, 0, 1 << 31]]
    np.testing.assert_array_equal(luts_from_words(words), luts)
