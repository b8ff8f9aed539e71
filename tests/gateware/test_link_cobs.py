"""COBS in gateware against ``magtrak.protocol.cobs``."""

import random

import pytest

from gateware.link.cobs import CobsDecoder, CobsEncoder
from magtrak.protocol import cobs_decode, cobs_encode
from tests.support.simulation import simulate
from tests.support.streams import packet_items, receive, send

NONZERO = bytes(n % 255 + 1 for n in range(600))


def encode(packets, *, send_stall=0.0, receive_stall=0.0, seed=0, clocks=None):
    """What the encoder makes of ``packets``, without the zero that comes first."""
    dut = CobsEncoder()
    wire = b"\0" + wire_of(packets)
    got = bytearray()

    async def source(ctx):
        await send(ctx, dut.i, [item for p in packets for item in packet_items(p)], stall=send_stall, seed=seed)

    async def sink(ctx):
        got.extend(await receive(ctx, dut.o, len(wire), stall=receive_stall, seed=seed + 1))
        for _ in range(600):  # nothing may follow
            await ctx.tick()
            assert not ctx.get(dut.o.valid)

    simulate(dut, sink, source, clocks=clocks or 10 * len(wire) + 2000)
    assert got[0] == 0
    return bytes(got[1:])


def wire_of(packets):
    return b"".join(cobs_encode(packet) + b"\0" for packet in packets)


@pytest.mark.parametrize("tail", [b"", b"\0", b"\0\0", b"\x01", b"\0\x01", b"\x01\0"])
@pytest.mark.parametrize("length", [0, 1, 253, 254, 255, 507, 508, 509])
def test_encodes_all_lengths_around_a_full_block(length, tail):
    packet = NONZERO[:length] + tail
    if packet:
        assert encode([packet, b"\x07"]) == wire_of([packet, b"\x07"])


@pytest.mark.parametrize("seed", range(4))
def test_encodes_random_packets_with_stalls(seed):
    print("seed", seed)
    rng = random.Random(seed)
    packets = [
        bytes(
            rng.choice([0, rng.randrange(256)] if rng.random() < density else [1])
            for _ in range(rng.choice([1, 9, 300]))
        )
        for density in (1.0, 0.5, 0.02, 0.002)
        for _ in range(3)
    ]
    stalls = [(0.0, 0.0), (0.6, 0.0), (0.0, 0.6), (0.4, 0.4)][seed]
    assert encode(packets, send_stall=stalls[0], receive_stall=stalls[1], seed=seed) == wire_of(packets)


def test_encodes_a_byte_every_two_clocks():
    packet = NONZERO * 4
    dut = CobsEncoder()
    clocks = 0

    async def source(ctx):
        await send(ctx, dut.i, packet_items(packet))

    async def sink(ctx):
        nonlocal clocks
        ctx.set(dut.o.ready, 1)
        left = len(cobs_encode(packet)) + 2  # with the zero that comes first
        while left:
            clocks += 1
            _, _, valid = await ctx.tick().sample(dut.o.valid)
            left -= valid

    simulate(dut, sink, source, clocks=4 * len(packet))
    # The first block is collected before it leaves; then there is one more clock for each, and for the delimiter.
    blocks = -(-len(packet) // 254)
    assert clocks <= 2 * len(cobs_encode(packet)) + blocks + 254 + 12


def decode(wire, *, send_stall=0.0, ready=1.0, seed=0):
    """The packets in ``wire`` and the number of errors, by the rules of the decoder."""
    dut = CobsDecoder()
    rng = random.Random(seed)
    packets, errors, current = [], 0, bytearray()

    async def sink(ctx):
        nonlocal errors
        while True:
            ctx.set(dut.o.ready, rng.random() < ready)
            _, _, valid, taken, payload, error = await ctx.tick().sample(
                dut.o.valid, dut.o.ready, dut.o.payload, dut.error
            )
            if valid and taken:
                current.append(payload.data)
                if payload.last:
                    packets.append(bytes(current))
                    current.clear()
            if error:
                assert not valid
                errors += 1
                current.clear()

    async def source(ctx):
        await send(ctx, dut.i, wire, stall=send_stall, seed=seed)
        await ctx.tick().repeat(4)

    simulate(dut, source, sink, clocks=20 * len(wire) + 100)
    return packets, errors


def expected(wire):
    """The same, by the reference."""
    packets, errors = [], 0
    for stretch in wire.split(b"\0")[:-1]:
        if not stretch:
            continue
        try:
            packet = cobs_decode(stretch)
        except ValueError:
            packet = b""
        if packet:
            packets.append(packet)
        else:
            errors += 1
    return packets, errors


@pytest.mark.parametrize("length", [1, 2, 253, 254, 255, 508, 509])
@pytest.mark.parametrize("tail", [b"", b"\0", b"\0\0", b"\0\x05"])
def test_decodes_what_the_reference_encodes(length, tail):
    packet = NONZERO[:length] + tail
    assert decode(wire_of([packet, b"\0", b"\x09"])) == ([packet, b"\0", b"\x09"], 0)


@pytest.mark.parametrize("seed", range(4))
def test_decodes_damaged_streams_as_the_reference_does(seed):
    print("seed", seed)
    rng = random.Random(seed)
    packets = [bytes(rng.choice([0, rng.randrange(256)]) for _ in range(rng.choice([1, 5, 20]))) for _ in range(60)]
    wire = bytearray(wire_of(packets))
    for _ in range(30):
        at = rng.randrange(len(wire))
        match rng.randrange(3):
            case 0:
                wire[at] = rng.randrange(256)
            case 1:
                del wire[at]
            case _:
                wire.insert(at, rng.randrange(256))
    wire += b"\0"
    stalls = [(0.0, 1.0), (0.5, 1.0), (0.0, 0.4), (0.3, 0.5)][seed]
    got = decode(bytes(wire), send_stall=stalls[0], ready=stalls[1], seed=seed)
    assert got == expected(bytes(wire))
    assert got[1] > 0


def test_idle_zeros_are_no_error():
    assert decode(b"\0\0\0\x02\x11\0\0\x02\x22\0") == ([b"\x11", b"\x22"], 0)


def test_an_empty_packet_is_an_error():
    assert decode(b"\x01\0\x02\x22\0") == ([b"\x22"], 1)
