"""Packets against ``magtrak.protocol``: what goes out, and what becomes of what comes in."""

import random
import zlib

import pytest

from gateware.link.packet import AnswerSender, PacketReceiver, PacketSender
from magtrak.protocol import ANSWER, COMMAND, AnswerCode, PacketType
from magtrak.protocol.cobs import CRC, HEADER
from tests.support.simulation import simulate
from tests.support.streams import packet_items, receive, send


def body(kind, sequence, payload):
    """A packet before it is encoded."""
    data = HEADER.pack(kind, sequence) + payload
    return data + CRC.pack(zlib.crc32(data))


async def receive_packets(ctx, stream, count, **options):
    """``count`` whole packets of ``stream``."""
    packets = []
    for _ in range(count):
        packet = bytearray()
        while True:
            (item,) = await receive(ctx, stream, 1, **options)
            packet.append(item.data)
            if item.last:
                break
        packets.append(bytes(packet))
    return packets


@pytest.mark.parametrize("stall", [0.0, 0.4])
def test_sender_wraps_payloads_and_never_mixes_them(stall):
    rng = random.Random(3)
    answers = [bytes(rng.randrange(256) for _ in range(rng.randrange(1, 12))) for _ in range(12)]
    frames = [bytes(rng.randrange(256) for _ in range(rng.randrange(1, 90))) for _ in range(8)]
    dut = PacketSender([PacketType.ANSWER, PacketType.FRAME])
    got = []

    async def give_answers(ctx):
        for number, answer in enumerate(answers):
            await ctx.tick()
            for _ in range(rng.randrange(60)):
                await ctx.tick()
            await send(ctx, dut.i[0], packet_items(answer), stall=stall, seed=number)

    async def give_frames(ctx):
        for number, frame in enumerate(frames):
            await send(ctx, dut.i[1], packet_items(frame), stall=stall, seed=number)

    async def sink(ctx):
        got.extend(await receive_packets(ctx, dut.o, len(answers) + len(frames), stall=stall))

    simulate(dut, sink, give_answers, give_frames, clocks=20_000)
    left = {PacketType.ANSWER: list(answers), PacketType.FRAME: list(frames)}
    for sequence, packet in enumerate(got):
        kind = PacketType(packet[0])
        assert packet == body(kind, sequence, left[kind].pop(0))
    assert left == {PacketType.ANSWER: [], PacketType.FRAME: []}


def test_an_answer_goes_before_a_frame_that_waits_too():
    dut = PacketSender([PacketType.ANSWER, PacketType.FRAME])
    got = []

    async def give_answer(ctx):
        await send(ctx, dut.i[0], packet_items(b"a"))

    async def give_frames(ctx):
        await send(ctx, dut.i[1], packet_items(b"f") + packet_items(b"g"))

    async def sink(ctx):
        got.extend(await receive_packets(ctx, dut.o, 3))

    simulate(dut, sink, give_answer, give_frames, clocks=1000)
    assert [packet[0] for packet in got] == [PacketType.ANSWER, PacketType.FRAME, PacketType.FRAME]


def test_a_sender_without_inputs_is_refused():
    with pytest.raises(ValueError, match="types is \\(\\)"):
        PacketSender(())


def judged(packets, *, stall=0.0, errors=()):
    """What the receiver makes of ``packets``: commands, number of ``intact`` strobes, damaged count.

    After each packet whose number is in ``errors`` the decoder's error strobe comes instead of its last byte.
    """
    dut = PacketReceiver()
    commands = []
    intact = 0
    damaged = 0

    async def drive(ctx):
        nonlocal damaged
        for number, packet in enumerate(packets):
            items = packet_items(packet)
            if number in errors:
                await send(ctx, dut.i, items[:-1])
                ctx.set(dut.error, 1)
                await ctx.tick()
                ctx.set(dut.error, 0)
            else:
                await send(ctx, dut.i, items)
        for _ in range(100):
            await ctx.tick()
        damaged = ctx.get(dut.damaged)

    async def sink(ctx):
        while True:
            commands.extend(await receive(ctx, dut.command, 1, stall=stall))

    async def count(ctx):
        nonlocal intact
        while True:
            intact += (await ctx.tick().sample(dut.intact))[2]

    simulate(dut, drive, sink, count, clocks=100_000)
    return [(c.sequence, c.write, c.address, c.value, c.refusal) for c in commands], intact, damaged


@pytest.mark.parametrize("stall", [0.0, 0.9])
def test_receiver_gives_commands(stall):
    rng = random.Random(4)
    packets, expected = [], []
    for sequence in range(30):
        write = rng.randrange(2)
        values = {"address": rng.randrange(1 << 16), "value": rng.randrange(1 << 32)}
        packets.append(
            body(PacketType.WRITE if write else PacketType.READ, 0xFFF0 + sequence & 0xFFFF, COMMAND.pack(values))
        )
        expected.append((0xFFF0 + sequence & 0xFFFF, write, values["address"], values["value"], AnswerCode.DONE))
    assert judged(packets, stall=stall) == (expected, len(expected), 0)


def test_a_damaged_packet_costs_only_itself():
    good = body(PacketType.READ, 5, COMMAND.pack({"address": 3, "value": 9}))
    result = (5, 0, 3, 9, AnswerCode.DONE)
    for at in range(len(good)):
        for bit in (0, 7):
            bad = bytearray(good)
            bad[at] ^= 1 << bit
            assert judged([bytes(bad), good]) == ([result], 1, 1)
    assert judged([good[:at] for at in range(1, len(good))] + [good]) == ([result], 1, len(good) - 1)


def test_wrong_lengths_and_types_are_passed_on_as_refused():
    payload = COMMAND.pack({"address": 3, "value": 9})
    packets = [
        body(PacketType.WRITE, 1, payload[:-1]),
        body(PacketType.READ, 2, payload + b"\0"),
        body(PacketType.READ, 3, b""),
        body(PacketType.WRITE, 4, bytes(300)),
        body(0xC0, 5, payload),
        body(0x82, 6, b""),
    ]
    codes = [AnswerCode.MALFORMED] * 4 + [AnswerCode.UNKNOWN_TYPE] * 2
    assert judged(packets) == ([(n, 0, 0, 0, code) for n, code in enumerate(codes, 1)], 0, 0)


def test_the_cards_own_packets_are_not_answered():
    packets = [body(kind, 1, bytes(10)) for kind in (PacketType.FRAME, PacketType.ANSWER, 0x7F)]
    assert judged(packets) == ([], 0, 3)


def test_the_decoders_error_drops_what_was_coming():
    good = body(PacketType.READ, 5, COMMAND.pack({"address": 3, "value": 9}))
    assert judged([good, good, good], errors=[1]) == ([(5, 0, 3, 9, 0)] * 2, 2, 1)


def test_the_count_of_damaged_packets_saturates():
    dut = PacketReceiver()

    async def drive(ctx):
        ctx.set(dut.error, 1)
        for _ in range(0x10010):
            await ctx.tick()
        assert ctx.get(dut.damaged) == 0xFFFF

    simulate(dut, drive, clocks=0x10100)


def test_answers_become_payloads():
    rng = random.Random(5)
    answers = [{field.name: rng.randrange(1 << field.bits) for field in ANSWER.fields} for _ in range(5)]
    dut = AnswerSender()
    got = []

    async def source(ctx):
        await send(ctx, dut.i, answers, stall=0.3)

    async def sink(ctx):
        got.extend(await receive_packets(ctx, dut.o, len(answers), stall=0.3))

    simulate(dut, sink, source, clocks=2000)
    assert got == [ANSWER.pack(answer) for answer in answers]
