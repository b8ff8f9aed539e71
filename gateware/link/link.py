"""Both ends of the byte stream: commands in, packets out."""

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from magtrak.protocol import ANSWER, PacketType

from ..layouts import Bytes, Packets
from .cobs import CobsDecoder, CobsEncoder
from .fifo import PacketFifo
from .gap import Gap
from .packet import Answer, AnswerSender, Command, PacketReceiver, PacketSender

ANSWERS = 64
"""For so many there is room while a frame is sent, or for more: a host may write all settings and tables at once."""


class Link(wiring.Component):
    """Commands out of bytes; frames and answers into bytes.

    Answers go before frames, these before snapshots; each waits for the end of the packet that is being sent. When
    there is no room for more of them, commands wait too, and then bytes. A piece of a snapshot begins only where it
    fits between two frames, as :class:`~gateware.link.gap.Gap` has it.

    Members
    -------
    rx, tx : bytes from and to the host
    command : intact commands
    answer : their answers
    frame, snapshot : payloads of frames and of pieces of snapshots
    intact, damaged, count : as in :class:`~gateware.link.packet.PacketReceiver`
    """

    rx: In(Bytes)
    tx: Out(Bytes)
    command: Out(stream.Signature(Command))
    answer: In(stream.Signature(Answer))
    frame: In(Packets)
    snapshot: In(Packets)
    intact: Out(1)
    damaged: Out(16)
    count: Out(16)

    def elaborate(self, platform):
        m = Module()
        m.submodules.decoder = decoder = CobsDecoder()
        m.submodules.receiver = receiver = PacketReceiver()
        m.submodules.answer_sender = answer_sender = AnswerSender()
        m.submodules.answers = answers = PacketFifo(1 << (ANSWERS * ANSWER.size).bit_length())
        m.submodules.sender = sender = PacketSender([PacketType.ANSWER, PacketType.FRAME, PacketType.SNAPSHOT])
        m.submodules.encoder = encoder = CobsEncoder()

        m.submodules.gap = gap = Gap()
        admitted = Signal()  # a piece, from its beginning to its end
        with m.If(self.snapshot.valid & self.snapshot.ready & self.snapshot.payload.last):
            m.d.sync += admitted.eq(0)
        with m.Elif(self.snapshot.valid & gap.open):
            m.d.sync += admitted.eq(1)

        connect(m, flipped(self.rx), decoder.i)
        connect(m, decoder.o, receiver.i)
        connect(m, receiver.command, flipped(self.command))
        connect(m, flipped(self.answer), answer_sender.i)
        connect(m, answer_sender.o, answers.i)
        connect(m, answers.o, sender.i[0])
        connect(m, flipped(self.frame), sender.i[1])
        connect(m, sender.o, encoder.i)
        connect(m, encoder.o, flipped(self.tx))
        m.d.comb += [
            sender.i[2].payload.eq(self.snapshot.payload),
            sender.i[2].valid.eq(self.snapshot.valid & admitted),
            self.snapshot.ready.eq(sender.i[2].ready & admitted),
            gap.frame.eq(self.frame.valid),
            gap.frame_last.eq(self.frame.valid & self.frame.ready & self.frame.payload.last),
            gap.waits.eq(self.tx.valid),
            gap.moved.eq(self.tx.valid & self.tx.ready),
            receiver.error.eq(decoder.error),
            self.intact.eq(receiver.intact),
            self.damaged.eq(receiver.damaged),
            self.count.eq(receiver.count),
        ]
        return m
