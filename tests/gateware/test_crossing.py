"""Between two clocks: all that goes over, in order, within the time that is said."""

import random

import pytest

from gateware.crossing.handover import Handover
from gateware.crossing.mirror import Mirror
from gateware.crossing.strobes import Strobes
from gateware.crossing.tables import TableGuard
from magtrak import protocol
from magtrak.protocol import AnswerCode
from tests.support.simulation import PERIOD_S, simulate

RATIOS = [0.13, 0.397, 1.003, 2.47, 3.9]
"""Clocks of the pixels, here ``camera``, to one of ``sync``."""


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("domains", [("camera", "sync"), ("sync", "camera")])
def test_words_come_once_and_in_order(ratio, domains):
    """With both sides random in when they are ready."""
    rng = random.Random(f"{ratio}{domains}")
    dut = Handover(16, *domains)
    words = [rng.randrange(1 << 16) for _ in range(40)]
    came = []

    async def give(ctx):
        for word in words:
            await ctx.tick(domains[0]).repeat(rng.choice([1, 1, 2, 9]))
            ctx.set(dut.i.payload, word)
            ctx.set(dut.i.valid, 1)
            await ctx.tick(domains[0]).until(dut.i.ready)
            ctx.set(dut.i.valid, 0)
            ctx.set(dut.i.payload, 0)
        await ctx.tick(domains[0]).until(dut.i.ready)

    async def take(ctx):
        while True:
            ctx.set(dut.o.ready, rng.random() < 0.5)
            _, _, valid, ready, word = await ctx.tick(domains[1]).sample(dut.o.valid, dut.o.ready, dut.o.payload)
            if valid and ready:
                came.append(word)

    simulate(dut, give, take, camera_s=PERIOD_S / ratio, clocks=20_000)
    assert came == words


@pytest.mark.parametrize("ratio", RATIOS)
def test_what_is_mirrored_was_there(ratio):
    rng = random.Random(ratio)
    dut = Mirror(16, "camera", "sync")
    values, seen = [0], set()

    async def change(ctx):
        for _ in range(60):
            values.append(rng.choice([0xFFFF, 0, rng.randrange(1 << 16)]))
            ctx.set(dut.i, values[-1])
            await ctx.tick("camera").repeat(rng.choice([1, 2, 5, 20]))
        await ctx.tick("camera").repeat(7)
        await ctx.tick().repeat(5)
        assert ctx.get(dut.o) == values[-1]

    async def look(ctx):
        while True:
            _, _, value = await ctx.tick().sample(dut.o)
            seen.add(value)

    simulate(dut, change, look, camera_s=PERIOD_S / ratio, clocks=20_000)
    assert seen <= set(values)
    assert len(seen) > 8


def strobes(ratio, events):
    """Names and times of what came of ``events``, which are names, and pixel clocks until the next.

    Times are in clocks of ``sync``, with those of the events, and of when each first pixel was ``answered``.
    """
    dut = Strobes("camera")
    given, came, answers = [], [], []

    async def give(ctx):
        edge = 0

        async def tick(clocks):
            nonlocal edge
            edge += clocks
            await ctx.tick("camera").repeat(clocks)

        await tick(4)
        for names, wait in events:
            for name in names:
                ctx.set(getattr(dut, f"i_{name}"), 1)
            given.append((names, (edge - 1 + 0.37) / ratio))
            await tick(1)
            for name in names:
                ctx.set(getattr(dut, f"i_{name}"), 0)
            if wait > 1:
                await tick(wait - 1)
        await tick(40)
        await ctx.tick().repeat(10)

    async def look(ctx):
        names, edge = ("frame_end", "frame_first", "row_first", "refused"), 0
        while True:
            _, _, *values = await ctx.tick().sample(*(getattr(dut, name) for name in names))
            here = tuple(name for name, value in zip(names, values, strict=True) if value)
            if here:
                came.append((here, edge + 0.5))
            edge += 1

    async def answer(ctx):
        was, edge = 1, 0
        while True:
            _, _, answered = await ctx.tick("camera").sample(dut.answered)
            if answered and not was:
                answers.append((edge + 0.37) / ratio)
            was = answered
            edge += 1

    simulate(dut, give, look, answer, camera_s=PERIOD_S / ratio, clocks=40_000)
    return given, came, answers


@pytest.mark.parametrize("ratio", RATIOS)
def test_strobes_come_within_their_latency(ratio):
    """A clock of the pixels, then more than 1 and up to 2 of ``sync``; what is seen at an edge was there before it."""
    events = [(("frame_first", "row_first"), 48)]
    for image in range(12):
        events += [(("row_first",), 48 + image), (("frame_end",), 61), (("frame_first", "row_first"), 50)]
    given, came, answers = strobes(ratio, events)
    pixel = 1 / ratio
    assert [set(names) for names, _ in came] == [set(names) for names, _ in given]
    for (names, begun), (_, end) in zip(given, came, strict=True):
        # `begun` is the edge after which the strobe is high, `end` the edge at which it is sampled in `sync`.
        late = end - 1 - begun - pixel * (2 if "frame_end" in names else 1)
        assert 1 - 1e-6 < late <= 2 + 1e-6, (names, late)
    firsts = [time for names, time in given if "frame_first" in names]
    for begun, known in zip(firsts, answers, strict=True):
        assert known - begun <= 3 + 5 * pixel


@pytest.mark.parametrize("ratio", RATIOS)
def test_strobes_that_come_close_keep_their_order(ratio):
    """An image that is cut off by the next: its end, then that one's beginning; nothing of it is lost."""
    cut_off = [(("frame_end",), 1), (("frame_first", "row_first"), 1), (("row_first", "refused"), 100)]
    _, came, _ = strobes(ratio, cut_off * 3)
    order = [name for names, _ in came for name in names]
    assert order == ["frame_end", "frame_first", "row_first", "row_first", "refused"] * 3
    assert [len(names) for names, _ in came] == [1, 2, 2] * 3


def test_a_write_to_a_table_waits_and_is_refused_in_the_end():
    dut = TableGuard(patience_bits=4)
    table = protocol.register("lut_luminance").address + 3

    async def test(ctx):
        async def offer(address, *, write=1):
            """Clocks until it was taken, and its refusal."""
            ctx.set(dut.i.payload, {"write": write, "address": address, "refusal": AnswerCode.DONE})
            ctx.set(dut.i.valid, 1)
            for clocks in range(40):
                _, _, valid, ready, refusal = await ctx.tick().sample(dut.o.valid, dut.i.ready, dut.o.payload.refusal)
                assert valid == ready
                if ready:
                    ctx.set(dut.i.valid, 0)
                    await ctx.tick()
                    return clocks, refusal
            raise AssertionError("never taken")

        ctx.set(dut.o.ready, 1)
        assert await offer(table) == (0, AnswerCode.DONE)
        ctx.set(dut.busy, 1)
        assert await offer(protocol.register("floor").address) == (0, AnswerCode.DONE)
        assert await offer(table, write=0) == (0, AnswerCode.DONE)
        for _ in range(2):
            assert await offer(table) == (16, AnswerCode.NO_CLOCK)
        ctx.set(dut.i.payload, {"write": 1, "address": table, "refusal": AnswerCode.DONE})
        ctx.set(dut.i.valid, 1)
        await ctx.tick().repeat(10)
        assert not ctx.get(dut.o.valid)
        ctx.set(dut.busy, 0)
        assert ctx.get(dut.o.valid)
        assert await offer(table) == (0, AnswerCode.DONE)

    simulate(dut, test)
