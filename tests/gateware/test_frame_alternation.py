"""Which images are taken without laser, against the reference."""

import itertools

import numpy as np
import pytest

from gateware.frame.alternation import Alternation
from magtrak.protocol import AmbientMode, Phase
from tests.support.simulation import simulate
from tests.support.vision import default_settings

SEED = 7


def play(images):
    """Phase and laser of each image, of (mode, measured, subtracted) each: in force since its first pixel."""
    dut = Alternation()
    seen = []

    async def testbench(ctx):
        for mode, measured, subtracted in images:
            ctx.set(dut.settings, default_settings(ambient_mode=mode, ambient_measured=measured))
            ctx.set(dut.subtracted, subtracted)
            ctx.set(dut.run, 1)
            ctx.set(dut.frame_first, 1)
            await ctx.tick()
            ctx.set(dut.frame_first, 0)
            await ctx.tick().repeat(3)
            seen.append((Phase(ctx.get(dut.phase)), ctx.get(dut.laser), ctx.get(dut.background)))
            ctx.set(dut.frame_end, 1)
            await ctx.tick()
            ctx.set(dut.frame_end, 0)

    simulate(dut, testbench)
    return seen


@pytest.mark.parametrize(
    ("mode", "measured", "sequence", "lit"),
    [
        (AmbientMode.OFF, 1, "MMMMMM", "111111"),
        (AmbientMode.ALTERNATE, 1, "MBMBMB", "101010"),
        (AmbientMode.ALTERNATE, 3, "MBMMMBMMM", "101110111"),
        (AmbientMode.SKIP, 1, "MSBSMSBSM", "100110011"),
        (AmbientMode.SKIP, 2, "MSBSMMSBSMM", "10011100111"),
    ],
)
def test_sequences(mode, measured, sequence, lit):
    seen = play([(mode, measured, 1)] * len(sequence))
    assert "".join(phase.name[0] for phase, _, _ in seen) == sequence
    assert "".join(str(laser) for _, laser, _ in seen) == lit


@pytest.mark.parametrize("when", ["image", "gap"])
def test_a_run_begins_with_light(when):
    """Once no more images are wanted, the background to come is forgotten; one under way goes on to its end."""
    dut = Alternation()

    async def testbench(ctx):
        async def strobe(name):
            ctx.set(getattr(dut, name), 1)
            await ctx.tick()
            ctx.set(getattr(dut, name), 0)
            await ctx.tick()

        ctx.set(dut.settings, default_settings(ambient_mode=AmbientMode.ALTERNATE))
        ctx.set(dut.run, 1)
        await strobe("frame_first")
        await strobe("frame_end")
        assert not ctx.get(dut.laser)
        if when == "image":
            await strobe("frame_first")
        ctx.set(dut.run, 0)
        await ctx.tick().repeat(3)
        if when == "image":
            assert ctx.get(dut.background) and not ctx.get(dut.laser)
            await strobe("frame_end")
        assert ctx.get(dut.laser) and not ctx.get(dut.background)
        ctx.set(dut.run, 1)
        await strobe("frame_first")
        assert ctx.get(dut.laser) and ctx.get(dut.phase) == Phase.UNSUBTRACTED

    simulate(dut, testbench)


def test_what_is_not_subtracted_says_so():
    phases = [phase for phase, _, _ in play([(AmbientMode.ALTERNATE, 1, 0)] * 2 + [(AmbientMode.OFF, 1, 0)] * 2)]
    assert phases == [Phase.UNSUBTRACTED, Phase.BACKGROUND, Phase.MEASURED, Phase.MEASURED]


def test_modes_that_change_at_any_time():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    images = []
    while len(images) < 600:
        setting = (int(rng.integers(0, 3)), int(rng.choice([1, 2, 3, 255])))
        images += [(*setting, int(rng.integers(0, 2))) for _ in range(rng.integers(1, 9))]
    now, expected = Alternation.reference(), []
    for mode, measured, subtracted in images:
        phase = now.phase(mode, bool(subtracted))
        expected.append((phase, now.laser, phase == Phase.BACKGROUND))
        now = now.after(mode, measured)
    assert play(images) == expected
    pairs = set(itertools.pairwise(phase for phase, _, _ in expected))
    assert (Phase.SKIPPED, Phase.BACKGROUND) in pairs and (Phase.BACKGROUND, Phase.UNSUBTRACTED) in pairs
