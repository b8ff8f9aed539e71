"""The queue of bytes: all that went in comes out, in order, however both ends pause."""

import random

import pytest

from gateware.link.fifo import PacketFifo
from tests.support.simulation import simulate

DEPTH = 8


@pytest.mark.parametrize(("fill", "drain"), [(1.0, 1.0), (1.0, 0.2), (0.2, 1.0), (0.5, 0.5)])
def test_bytes_come_out_in_order(fill, drain):
    rng = random.Random(5)
    print("seed", 5)
    dut = PacketFifo(DEPTH)
    sent = [{"data": rng.randrange(256), "last": rng.randrange(2)} for _ in range(500)]
    got, most = [], [0]

    async def testbench(ctx):
        at = 0
        held = False  # a byte that was offered stays
        while len(got) < len(sent):
            held = held or (at < len(sent) and rng.random() < fill)
            ctx.set(dut.i.valid, held)
            if held:
                ctx.set(dut.i.payload, sent[at])
            ctx.set(dut.o.ready, rng.random() < drain)
            taken = held and ctx.get(dut.i.ready)
            if ctx.get(dut.o.valid) and ctx.get(dut.o.ready):
                got.append({"data": ctx.get(dut.o.payload.data), "last": ctx.get(dut.o.payload.last)})
            await ctx.tick()
            if taken:
                at, held = at + 1, False
            most[0] = max(most[0], at - len(got))

    simulate(dut, testbench, clocks=10_000)
    assert got == sent
    if drain < fill:
        assert most[0] == DEPTH  # two on their way out, all but two in the memory


def test_a_depth_that_is_not_possible_is_refused():
    for depth in (0, 4, 12, 256):
        with pytest.raises(ValueError, match=f"depth is {depth};"):
            PacketFifo(depth)
