"""Packets: type, sequence number and CRC around payloads, and what becomes of commands.

The wire format is :mod:`magtrak.protocol`'s; what :class:`PacketSender` adds, ``frame_packet`` adds
before it encodes.
"""

from collections.abc import Sequence

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
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

    Throughput: a byte every two clocks, and ``2 * OVERHEAD + 1`` clocks more a packet.

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
        m.submodules.crc = crc = Crc32(4)

        chosen = Signal(len(self.types))  # a bit each
        sequence = Signal(16)
        carry = Signal(init=1)
        number = Signal(range(CRC.size))  # of the byte within sequence number or CRC
        byte = Signal(8)
        valid = Signal()
        moved = Signal()
        in_crc = Signal()
        last = Signal()  # byte of the payload
        # The lower half of a byte goes to the CRC as it moves, the upper half a clock later, before the next byte.
        later = Signal()
        upper = Signal(4)
        upper_of_crc = Signal()
        m.d.comb += [
            self.o.valid.eq(valid & ~later),
            self.o.payload.data.eq(byte),
            moved.eq(self.o.valid & self.o.ready),
            last.eq(Cat(one & source.payload.last for one, source in zip(chosen, self.i, strict=True)).any()),
            crc.data.eq(Mux(later, upper, byte)),
            crc.valid.eq(moved | later),
            crc.shift.eq(Mux(later, upper_of_crc, in_crc)),
        ]
        m.d.sync += later.eq(moved)
        with m.If(moved):
            m.d.sync += [upper.eq(byte[4:]), upper_of_crc.eq(in_crc)]

        with m.FSM():
            with m.State("Choose"):
                m.d.comb += crc.start.eq(1)  # what is left of the last CRC does not matter
                m.d.sync += [number.eq(0), carry.eq(1), chosen.eq(0)]
                for index, source in reversed(list(enumerate(self.i))):
                    with m.If(source.valid):
                        m.d.sync += chosen.eq(1 << index)
                        m.next = "Type"

            with m.State("Type"):
                m.d.comb += [valid.eq(1), byte.eq(one_of([Const(kind, 8) for kind in self.types], chosen))]
                with m.If(moved):
                    m.next = "Sequence"

            with m.State("Sequence"):
                # It is turned and counted byte by byte as it leaves.
                m.d.comb += [valid.eq(1), byte.eq(sequence)]
                with m.If(moved):
                    counted = Signal(9)
                    m.d.comb += counted.eq(sequence[:8] + carry)
                    m.d.sync += [sequence.eq(Cat(sequence[8:], counted[:8])), carry.eq(counted[8])]
                    m.d.sync += number[0].eq(~number[0])
                    with m.If(number[0]):
                        m.next = "Payload"

            with m.State("Payload"):
                m.d.comb += [
                    valid.eq((chosen & Cat(source.valid for source in self.i)).any()),
                    byte.eq(one_of([source.payload.data for source in self.i], chosen)),
                ]
                for one, source in zip(chosen, self.i, strict=True):
                    m.d.comb += source.ready.eq(one & ~later & self.o.ready)
                with m.If(moved & last):
                    m.next = "CRC"

            with m.State("CRC"):
                m.d.comb += [
                    in_crc.eq(1),
                    valid.eq(1),
                    byte.eq(crc.crc),
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

    Throughput: a byte in 8 clocks, in which it waits at the input. Latency 3 clocks from a packet's last byte.

    Members
    -------
    i : packets; they wait while a command waits
    error : strobe from the decoder: forget the packet that was coming; no byte waits at the input. While a command is
        checked or waits, that packet had no byte to show yet
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
        m.submodules.crc = crc = Crc32(1)

        kept = HEADER.size + protocol.COMMAND.size
        bytes_ = Signal(8 * kept)  # the first one moves down to the lowest place
        size = Signal(range(kept + CRC.size + 2))  # saturating above every length that is right
        bit = Signal(3)  # of the byte at the input
        packet = data.View(data.StructLayout({"type": 8, "sequence": 16, "command": struct(protocol.COMMAND)}), bytes_)
        damaged = Signal()
        known = Signal()
        right = Signal()
        moves = Signal()
        m.d.comb += [
            crc.data.eq(self.i.payload.data.bit_select(bit, 1)),
            known.eq((packet.type == PacketType.READ) | (packet.type == PacketType.WRITE)),
            right.eq(size == kept + CRC.size),
            self.command.payload.sequence.eq(packet.sequence),
            self.command.payload.write.eq(right & (packet.type == PacketType.WRITE)),
            self.command.payload.address.eq(packet.command.address),
            self.command.payload.value.eq(packet.command.value),
            self.command.payload.refusal.eq(
                Mux(
                    known,
                    Mux(right, AnswerCode.DONE.value, AnswerCode.MALFORMED.value),
                    AnswerCode.UNKNOWN_TYPE.value,
                )
            ),
        ]
        with m.If(moves):
            m.d.sync += bytes_.eq(Cat(bytes_[8:], self.i.payload.data))

        with m.FSM():
            with m.State("Collect"):
                m.d.comb += [crc.valid.eq(self.i.valid), self.i.ready.eq(bit.all())]
                with m.If(self.i.valid):
                    m.d.sync += bit.eq(bit + 1)
                    with m.If(bit.all()):
                        m.d.comb += moves.eq(size < kept)
                        with m.If(size < kept + CRC.size + 1):
                            m.d.sync += size.eq(size + 1)
                        with m.If(self.i.payload.last):
                            m.next = "Check"
                with m.If(self.error):
                    m.d.comb += crc.start.eq(1)
                    m.d.sync += size.eq(0)

            with m.State("Check"):
                with m.If(self.error):
                    pass  # is counted first
                with m.Elif(~crc.match | (size < protocol.cobs.OVERHEAD)):
                    m.d.comb += damaged.eq(1)
                    m.next = "Clear"
                with m.Elif(size < kept):  # it is too short, and its first byte not at its place
                    m.d.comb += moves.eq(1)
                    m.d.sync += size.eq(size + 1)
                with m.Elif(packet.type < 0x80):
                    m.d.comb += damaged.eq(1)
                    m.next = "Clear"
                with m.Else():
                    m.d.comb += self.intact.eq(known & right)
                    m.d.sync += self.count.eq(self.count + 1)
                    with m.If(~self.intact):
                        m.d.sync += Value.cast(packet.command).eq(0)
                    m.next = "Command"

            with m.State("Command"):
                m.d.comb += self.command.valid.eq(1)
                with m.If(self.command.ready):
                    m.next = "Clear"

            with m.State("Clear"):
                m.d.comb += crc.start.eq(1)
                m.d.sync += size.eq(0)
                m.next = "Collect"

        with m.If((damaged | self.error) & ~self.damaged.all()):
            m.d.sync += self.damaged.eq(self.damaged + 1)

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
