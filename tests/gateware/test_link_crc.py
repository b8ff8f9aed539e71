"""The CRC against zlib's."""

import random
import zlib

import pytest

from gateware.link.crc import Crc32
from tests.support.simulation import simulate


@pytest.mark.parametrize("bits", [1, 4, 8])
def test_crc_and_match_are_those_of_zlib(bits):
    rng = random.Random(5)
    texts = [b"123456789", b"", b"\0", b"\xff" * 7, *(rng.randbytes(rng.randrange(1, 40)) for _ in range(20))]
    dut = Crc32(bits)

    async def feed(ctx, data):
        ctx.set(dut.start, 1)
        ctx.set(dut.valid, rng.randrange(2))
        await ctx.tick()
        ctx.set(dut.start, 0)
        for byte in data:
            for at in range(0, 8, bits):
                ctx.set(dut.data, byte >> at)
                ctx.set(dut.valid, 1)
                await ctx.tick()
                ctx.set(dut.valid, 0)
                if rng.randrange(3) == 0:
                    ctx.set(dut.data, rng.randrange(256))
                    await ctx.tick()

    async def shifted(ctx):
        """The CRC as it leaves."""
        crc = 0
        ctx.set(dut.shift, 1)
        ctx.set(dut.valid, 1)
        for at in range(0, 32, bits):
            crc |= (ctx.get(dut.crc) & (1 << bits) - 1) << at
            ctx.set(dut.data, rng.randrange(256))
            await ctx.tick()
        ctx.set(dut.shift, 0)
        ctx.set(dut.valid, 0)
        return crc

    async def testbench(ctx):
        for text in texts:
            crc = zlib.crc32(text)
            await feed(ctx, text)
            assert ctx.get(dut.crc) == crc
            assert await shifted(ctx) == crc
            whole = text + crc.to_bytes(4, "little")
            await feed(ctx, whole)
            assert ctx.get(dut.match)
            wrong = bytearray(whole)
            wrong[rng.randrange(len(wrong))] ^= 1 << rng.randrange(8)
            await feed(ctx, wrong)
            assert not ctx.get(dut.match)
        await feed(ctx, b"123456789")
        assert ctx.get(dut.crc) == 0xCBF4_3926  # the check value of every catalogue

    simulate(dut, testbench, clocks=100_000)
