"""Packets: type, sequence number and CRC around payloads, and what becomes of commands.

The wire format is :mod:`magtrak.protocol`'s; what :class:`PacketSender` adds, ``frame_packet`` adds
before it encodes.
"""

from collections.abc import Sequence

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak import protocol
from magtrak.protocol import AnswerCode, PacketType
from magtrak.protocol.cobs import CRC, HEADER

from ..layouts import Packets, struct
from ..select import one_of
from .crc import Crc32

Answer = struct(protocol.ANSWER)


class Command(data.Struct):
    """An intact command.

    ``refusal`` is ``AnswerCode.DONE`` where type and length are right; else the code to answer with,
    and ``write``, ``address`` and ``value`` are 0.
    """

    sequence: 16
    write: 1
    address: 16
    value: 32
    refusal: 8


class PacketSender(wiring.Component):
    """Makes one stream of packets of several streams of payloads.

    Whole packets alternate with nothing else in between; when several payloads wait, the first in
    ``types`` goes first. The sequence number counts the packets of all types together.

    Throughput: a byte a clock, and ``OVERHEAD + 1`` clocks more a packet.

    Parameters
    ----------
    types : packet type of each input

    Members
    -------
    i : array of payload streams, each payload of at least one byte
    o : packets, ready to be encoded

    Raises
    ------
    ValueError
        There is no input.
    """

    def __init__(self, types: Sequence[PacketType]) -> None:
        self.types = tuple(types)
        if not self.types:
            raise ValueError(f"types is {types!r}; a sender needs at least one")
        super().__init__({"i": In(Packets).array(len(self.types)), "o": Out(Packets)})

    def elaborate(self, platform):
        m = Module()
        m.submodules.crc = crc = Crc32()

        chosen = Signal(range(len(self.types)))
        sequence = Signal(16)
        number = Signal(range(CRC.size))  # of the byte within sequence number or CRC
        payload = Signal(self.o.payload.shape())
        valid = Signal()
        moved = Signal()
        m.d.comb += [
            moved.eq(self.o.valid & self.o.ready),
            crc.data.eq(self.o.payload.data),
        ]
        with m.Switch(chosen):
            for index, source in enumerate(self.i):
                with m.Case(index):
                    m.d.comb += [payload.eq(source.payload), valid.eq(source.valid)]

        with m.FSM():
            with m.State("Choose"):
                m.d.comb += crc.start.eq(1)
                m.d.sync += number.eq(0)
                for index, source in reversed(list(enumerate(self.i))):
                    with m.If(source.valid):
                        m.d.sync += chosen.eq(index)
                        m.next = "Type"

            with m.State("Type"):
                m.d.comb += self.o.valid.eq(1)
                with m.Switch(chosen):
                    for index, kind in enumerate(self.types):
                        with m.Case(index):
                            m.d.comb += self.o.payload.data.eq(kind)
                m.d.comb += crc.valid.eq(moved)
                with m.If(moved):
                    m.next = "Sequence"

            with m.State("Sequence"):
                m.d.comb += [
                    self.o.valid.eq(1),
                    self.o.payload.data.eq(sequence.word_select(number[0], 8)),
                    crc.valid.eq(moved),
                ]
                with m.If(moved):
                    m.d.sync += number[0].eq(~number[0])
                    with m.If(number[0]):
                        m.d.sync += sequence.eq(sequence + 1)
                        m.next = "Payload"

            with m.State("Payload"):
                m.d.comb += [
                    self.o.valid.eq(valid),
                    self.o.payload.data.eq(payload.data),
                    crc.valid.eq(moved),
                ]
                for index, source in enumerate(self.i):
                    m.d.comb += source.ready.eq((chosen == index) & self.o.ready)
                with m.If(moved & payload.last):
                    m.next = "CRC"

            with m.State("CRC"):
                m.d.comb += [
                    self.o.valid.eq(1),
                    self.o.payload.data.eq(crc.crc.word_select(number, 8)),
                    self.o.payload.last.eq(number == CRC.size - 1),
                ]
                with m.If(moved):
                    m.d.sync += number.eq(number + 1)
                    with m.If(self.o.payload.last):
                        m.next = "Choose"

        return m


class PacketReceiver(wiring.Component):
    """Finds the commands among the packets.

    A packet whose CRC is wrong, that is too short, or whose type is not one of a command (0x80 and
    above) is damaged: counted, and not answered. The last of these keeps a card whose own packets
    come back to it from answering itself for ever. An intact command of unknown type or of the wrong length is
    passed on with its refusal.

    Latency: 2 clocks from a packet's last byte.

    Members
    -------
    i : packets; the receiver takes a byte a clock, and waits while a command waits
    error : strobe from the decoder: forget the packet that was coming. While a command is checked or waits, that
        packet had no byte to show yet
    command : intact commands
    intact : strobe for each one that is not refused
    damaged : packets that were damaged, or that the decoder reported; stays at 65535
    count : intact commands, refused ones too, modulo 65536
    """

    i: In(Packets)
    error: In(1)
    command: Out(stream.Signature(Command))
    intact: Out(1)
    damaged: Out(16)
    count: Out(16)

    def elaborate(self, platform):
        m = Module()
        m.submodules.crc = crc = Crc32()

        kept = HEADER.size + protocol.COMMAND.size
        bytes_ = Signal(8 * kept)
        size = Signal(range(kept + CRC.size + 2))  # saturating above every length that is right
        packet = data.View(data.StructLayout({"type": 8, "sequence": 16, "command": struct(protocol.COMMAND)}), bytes_)
        damaged = Signal()
        known = Signal()
        right = Signal()
        m.d.comb += [
            crc.data.eq(self.i.payload.data),
            known.eq((packet.type == PacketType.READ) | (packet.type == PacketType.WRITE)),
            right.eq(size == kept + CRC.size),
            self.command.payload.sequence.eq(packet.sequence),
        ]
        with m.If(known & right):
            m.d.comb += [
                self.command.payload.refusal.eq(AnswerCode.DONE),
                self.command.payload.write.eq(packet.type == PacketType.WRITE),
                self.command.payload.address.eq(packet.command.address),
                self.command.payload.value.eq(packet.command.value),
            ]
        with m.Else():
            m.d.comb += self.command.payload.refusal.eq(
                Mux(known, AnswerCode.MALFORMED.value, AnswerCode.UNKNOWN_TYPE.value)
            )

        with m.FSM():
            with m.State("Collect"):
                m.d.comb += [self.i.ready.eq(1), crc.valid.eq(self.i.valid)]
                with m.If(self.i.valid):
                    with m.If(size < kept):
                        m.d.sync += bytes_.word_select(size, 8).eq(self.i.payload.data)
                    with m.If(size < kept + CRC.size + 1):
                        m.d.sync += size.eq(size + 1)
                    with m.If(self.i.payload.last):
                        m.next = "Check"
                with m.If(self.error):
                    m.d.comb += [crc.start.eq(1), crc.valid.eq(0)]
                    m.d.sync += size.eq(0)
                    m.next = "Collect"

            with m.State("Check"):
                with m.If(crc.match & (size >= protocol.cobs.OVERHEAD) & (packet.type >= 0x80)):
                    m.d.comb += self.intact.eq(known & right)
                    m.d.sync += self.count.eq(self.count + 1)
                    m.next = "Command"
                with m.Else():
                    m.d.comb += damaged.eq(1)
                    m.next = "Clear"

            with m.State("Command"):
                m.d.comb += self.command.valid.eq(1)
                with m.If(self.command.ready):
                    m.next = "Clear"

            with m.State("Clear"):
                m.d.comb += crc.start.eq(1)
                m.d.sync += size.eq(0)
                m.next = "Collect"

        count = Signal(17)
        m.d.comb += count.eq(self.damaged + (damaged + self.error))
        m.d.sync += self.damaged.eq(Mux(count[-1], 0xFFFF, count))

        return m


class AnswerSender(wiring.Component):
    """Answers as payloads.

    An answer stays at the input until its last byte is taken.

    Throughput: a byte a clock, and 1 clock more for each answer. Latency 1 clock.

    Members
    -------
    i : answers
    o : payloads of ``PacketType.ANSWER``
    """

    i: In(stream.Signature(Answer))
    o: Out(Packets)

    def elaborate(self, platform):
        m = Module()
        answer = Value.cast(self.i.payload)
        hot = Signal(protocol.ANSWER.size)  # which byte is next; none between two answers
        m.d.comb += [
            self.o.valid.eq(hot.any()),
            self.o.payload.data.eq(one_of([answer.word_select(at, 8) for at in range(len(hot))], hot)),
            self.o.payload.last.eq(hot[-1]),
            self.i.ready.eq(hot[-1] & self.o.ready),
        ]
        with m.If(hot.any()):
            with m.If(self.o.ready):
                m.d.sync += hot.eq(hot << 1)
        with m.Elif(self.i.valid):
            m.d.sync += hot.eq(1)
        return m
