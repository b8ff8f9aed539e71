"""The CRC against zlib's."""

import random
import zlib

from gateware.link.crc import Crc32
from tests.support.simulation import simulate


def test_crc_and_match_are_those_of_zlib():
    rng = random.Random(5)
    texts = [b"123456789", b"", b"\0", b"\xff" * 7, *(rng.randbytes(rng.randrange(1, 40)) for _ in range(20))]
    dut = Crc32()

    async def feed(ctx, data, *, together):
        """``start`` comes with the first byte or before it."""
        ctx.set(dut.start, 1)
        if not together or not data:
            await ctx.tick()
            ctx.set(dut.start, 0)
        for byte in data:
            ctx.set(dut.data, byte)
            ctx.set(dut.valid, 1)
            await ctx.tick()
            ctx.set(dut.start, 0)
            ctx.set(dut.valid, 0)
            if rng.randrange(3) == 0:
                ctx.set(dut.data, rng.randrange(256))
                await ctx.tick()

    async def testbench(ctx):
        for text in texts:
            crc = zlib.crc32(text)
            await feed(ctx, text, together=rng.randrange(2))
            assert ctx.get(dut.crc) == crc
            whole = text + crc.to_bytes(4, "little")
            await feed(ctx, whole, together=rng.randrange(2))
            assert ctx.get(dut.match)
            wrong = bytearray(whole)
            wrong[rng.randrange(len(wrong))] ^= 1 << rng.randrange(8)
            await feed(ctx, wrong, together=rng.randrange(2))
            assert not ctx.get(dut.match)
        await feed(ctx, b"123456789", together=True)
        assert ctx.get(dut.crc) == 0xCBF4_3926  # the check value of every catalogue

    simulate(dut, testbench, clocks=10_000)
