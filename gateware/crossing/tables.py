"""Writes to the gate's tables one at a time, for they go to another clock."""

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import LUT_WORDS, AnswerCode

from ..link.packet import Command
from ..register_map import TABLES

PATIENCE_BITS = 13
"""2 ** 13 clocks: 0.14 ms at 60 MHz; a pixel clock of a thousandth of the card's is in time."""


class TableGuard(wiring.Component):
    """Holds back a command that writes to a gate table while the write before it is under way to the pixels' clock.

    With a clock that runs this takes a few clocks, and all other commands pass at once. A clock that stands still for
    2 ** ``patience_bits`` clocks holds up no longer: the command is refused with ``AnswerCode.NO_CLOCK``. The write
    before it is kept, and comes to its table when the clock goes on: what was answered with ``DONE`` is done.

    Parameters
    ----------
    patience_bits : see above

    Members
    -------
    i, o : commands
    busy : a write is under way; from 8 clocks after ``o`` took it at the latest, which is before it takes another
    """

    def __init__(self, patience_bits: int = PATIENCE_BITS) -> None:
        self.patience_bits = patience_bits
        super().__init__(
            {"i": In(stream.Signature(Command)), "o": Out(stream.Signature(Command)), "busy": In(1)},
        )

    def elaborate(self, platform):
        m = Module()
        command = self.i.payload
        concerned = Signal()
        waits = Signal()
        bits = (LUT_WORDS - 1).bit_length()
        bases = [table.address >> bits for table in TABLES]
        m.d.comb += [
            concerned.eq(command.write & self.busy & (command.refusal == AnswerCode.DONE)),
            waits.eq(self.i.valid & concerned & (command.address >> bits).matches(*bases)),
        ]
        # What is refused has to stay so until it is taken, even if the clock comes back.
        waited = Signal(self.patience_bits)
        refused = Signal()
        m.d.comb += [
            self.o.valid.eq(self.i.valid & (~waits | refused)),
            self.i.ready.eq(self.o.ready & (~waits | refused)),
            self.o.payload.eq(command),
        ]
        with m.If(refused):
            m.d.comb += self.o.payload.refusal.eq(AnswerCode.NO_CLOCK)
        with m.If(self.o.valid & self.o.ready):
            m.d.sync += [refused.eq(0), waited.eq(0)]
        with m.Elif(~waits):
            m.d.sync += waited.eq(0)
        with m.Elif(~refused):
            m.d.sync += [waited.eq(waited + 1), refused.eq(waited.all())]
        return m
