"""Testbench ends of streams."""

import random
from collections.abc import Iterable


async def send(ctx, stream, payloads: Iterable, *, stall: float = 0, seed: int = 0) -> None:
    """Give ``payloads``; before each one wait a clock with probability ``stall``, again and again."""
    rng = random.Random(seed)
    for payload in payloads:
        while rng.random() < stall:
            await ctx.tick()
        ctx.set(stream.payload, payload)
        ctx.set(stream.valid, 1)
        ready = False
        while not ready:
            _, _, ready = await ctx.tick().sample(stream.ready)
        ctx.set(stream.valid, 0)


async def receive(ctx, stream, count: int, *, stall: float = 0, seed: int = 0) -> list:
    """Take ``count`` payloads; before each one wait a clock with probability ``stall``, again and again.

    A payload that changes while it waits to be taken breaks the rules of streams.
    """
    rng = random.Random(seed)
    payloads = []
    for _ in range(count):
        seen = None
        while rng.random() < stall:
            _, _, valid, payload = await ctx.tick().sample(stream.valid, stream.payload)
            assert seen is None or (valid and payload == seen), f"{seen} was withdrawn"
            seen = payload if valid else None
        ctx.set(stream.ready, 1)
        valid = False
        while not valid:
            _, _, valid, payload = await ctx.tick().sample(stream.valid, stream.payload)
        assert seen is None or payload == seen, f"{seen} became {payload}"
        payloads.append(payload)
        ctx.set(stream.ready, 0)
    return payloads


def packet_items(data: bytes) -> list[dict[str, int]]:
    """``data`` as one packet of :data:`gateware.layouts.Packets`."""
    return [{"data": byte, "last": int(at == len(data) - 1)} for at, byte in enumerate(data)]
