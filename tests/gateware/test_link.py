"""Bytes in, bytes out: the link with a register file behind it, against the protocol package."""

import random

from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from gateware.layouts import Bytes, Packets
from gateware.link.link import ANSWERS, Link
from gateware.registers import RegisterFile
from magtrak import protocol
from magtrak.protocol import ANSWER, COMMAND, AnswerCode, Deframer, Packet, PacketType
from tests.support.simulation import simulate
from tests.support.streams import packet_items, send


class Station(wiring.Component):
    """A link whose commands are executed."""

    rx: In(Bytes)
    tx: Out(Bytes)
    frame: In(Packets)

    def elaborate(self, platform):
        m = Module()
        m.submodules.link = link = Link()
        m.submodules.registers = registers = RegisterFile(64, 64)
        connect(m, flipped(self.rx), link.rx)
        connect(m, flipped(self.frame), link.frame)
        connect(m, link.tx, flipped(self.tx))
        connect(m, link.command, registers.command)
        connect(m, registers.answer, link.answer)
        m.d.comb += [registers.status.damaged_commands.eq(link.damaged), registers.write.ready.eq(1)]
        return m


def run(wire, count, *, frames=(), stall=0.0, hold=0, clocks=60_000):
    """Packets that come back, ``count`` of them, when the host does not read for the first ``hold`` clocks."""
    dut = Station()
    deframer = Deframer()
    packets = []

    async def source(ctx):
        await send(ctx, dut.rx, wire, stall=stall)

    async def frame_source(ctx):
        for frame in frames:
            await send(ctx, dut.frame, packet_items(frame))

    async def sink(ctx):
        rng = random.Random(1)
        clock = 0
        while len(packets) < count:
            ctx.set(dut.tx.ready, clock >= hold and rng.random() >= stall)
            _, _, valid, ready, byte = await ctx.tick().sample(dut.tx.valid, dut.tx.ready, dut.tx.payload)
            if valid and ready:
                packets.extend(deframer.feed(bytes([byte])))
            clock += 1

    simulate(dut, sink, source, frame_source, clocks=clocks)
    assert deframer.damaged == 0
    assert [packet.sequence for packet in packets] == list(range(count))
    return packets


def read(sequence, name):
    payload = COMMAND.pack({"address": protocol.register(name).address, "value": 0})
    return protocol.frame_packet(Packet(PacketType.READ, sequence, payload))


def test_every_intact_command_is_answered_in_order_and_damaged_ones_are_counted():
    rng = random.Random(8)
    wire = bytearray()
    intact = []
    for sequence in range(40):
        packet = bytearray(read(sequence, "version"))
        if rng.random() < 0.4:
            at = rng.randrange(len(packet) - 1)
            packet[at] = packet[at] % 255 + 1  # another value, and no delimiter
        else:
            intact.append(sequence)
        wire += packet
    wire += read(99, "damaged_commands")
    *answers, last = [ANSWER.unpack(packet.payload) for packet in run(bytes(wire), len(intact) + 1, stall=0.2)]
    assert [answer["to"] for answer in answers] == intact
    assert {answer["value"] for answer in answers} == {protocol.VERSION}
    assert (last["to"], last["value"]) == (99, 40 - len(intact))


def test_short_rubbish_right_behind_a_command_is_counted():
    wire = b"".join(read(sequence, "version") + b"\x05\0\x01\0" for sequence in range(8))
    *_, last = [ANSWER.unpack(packet.payload) for packet in run(wire + read(99, "damaged_commands"), 9)]
    assert last["value"] == 16


def test_commands_of_unknown_type_or_wrong_length_are_answered():
    wire = protocol.frame_packet(Packet(0xEE, 3, b"abc")) + protocol.frame_packet(Packet(PacketType.WRITE, 4, b"abc"))
    answers = [ANSWER.unpack(packet.payload) for packet in run(wire, 2)]
    assert answers == [
        {"to": 3, "code": AnswerCode.UNKNOWN_TYPE, "address": 0, "value": 0},
        {"to": 4, "code": AnswerCode.MALFORMED, "address": 0, "value": 0},
    ]


def test_many_commands_may_wait_for_a_host_that_does_not_read():
    count = 2 * ANSWERS
    wire = b"".join(read(sequence, "magic") for sequence in range(count))
    answers = [ANSWER.unpack(packet.payload) for packet in run(wire, count, hold=4000)]
    assert [answer["to"] for answer in answers] == list(range(count))
    assert {answer["value"] for answer in answers} == {protocol.MAGIC}


def test_answers_go_between_frames_and_not_into_them():
    rng = random.Random(9)
    frames = [bytes(rng.choice([0, rng.randrange(256)]) for _ in range(rng.randrange(200, 600))) for _ in range(6)]
    wire = b"".join(read(sequence, "magic") for sequence in range(20))
    packets = run(wire, 26, frames=frames, stall=0.5)
    assert [packet.payload for packet in packets if packet.type == PacketType.FRAME] == frames
    kinds = [packet.type for packet in packets]
    assert kinds.index(PacketType.ANSWER) < len(kinds) - 20, "answers waited for all frames"
