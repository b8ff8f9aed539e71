"""When there is time for a piece of a snapshot."""

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

TICK = 256
"""Clocks of one unit of time here."""

PIECE_BYTES = 2 * TICK
"""More than any piece takes on the line: 375 bytes of payload, 7 around it, 3 of COBS."""

_TICKS_BITS = 16
_OVERDUE_BIT = 12
OVERDUE_CLOCKS = TICK << _OVERDUE_BIT


class Gap(wiring.Component):
    """Says whether a piece fits between this frame and the next, so that the next comes no later for it.

    The gaps from the end of a frame to the beginning of the next are measured, and the shorter one of the last two is
    expected again: cameras have a rhythm, and where an image was dropped only one gap is long. How long a piece takes is told by the last byte that went out behind another. A line that is full
    has no gap, and no piece goes; one on which no frame has come for twice the gap, and for 2**20 clocks, is free.

    Members
    -------
    frame, frame_last : a byte of a frame waits; strobe: a frame's last byte was taken
    waits, moved : a byte for the line waits; strobe: it was taken
    open : a piece may begin
    """

    frame: In(1)
    frame_last: In(1)
    waits: In(1)
    moved: In(1)
    open: Out(1)

    def elaborate(self, platform):
        m = Module()

        # Clocks from one byte to the next, where it waited all the time.
        since, byte_clocks = Signal(12, init=1), Signal(12, init=0xFFF)
        steady = Signal()
        m.d.sync += steady.eq((steady | self.moved) & self.waits)
        with m.If(self.moved):
            m.d.sync += since.eq(1)
            with m.If(steady):
                m.d.sync += byte_clocks.eq(since)
        with m.Elif(~since.all()):
            m.d.sync += since.eq(since + 1)

        # Ticks since the last frame was out, and how many there were between the two before.
        tick = Signal(range(TICK))
        elapsed, gap, before = Signal(_TICKS_BITS), Signal(_TICKS_BITS), Signal(_TICKS_BITS)
        within = Signal()  # a frame
        m.d.sync += tick.eq(tick + 1)
        with m.If(self.frame_last):
            m.d.sync += [within.eq(0), elapsed.eq(0)]
        with m.Elif(self.frame & ~within):
            m.d.sync += [within.eq(1), gap.eq(elapsed), before.eq(gap)]
        with m.Elif((tick == 0) & ~elapsed.all()):
            m.d.sync += elapsed.eq(elapsed + 1)

        # A piece takes byte_clocks * PIECE_BYTES / TICK ticks; two more because both times are rounded.
        end, overdue = Signal(_TICKS_BITS + 1), Signal()
        m.d.sync += [
            end.eq(elapsed + (byte_clocks * (PIECE_BYTES // TICK)) + 2),
            overdue.eq((elapsed[1:] > gap) & elapsed[_OVERDUE_BIT:].any()),
            self.open.eq(~self.frame & ~within & (((end <= gap) & (end <= before)) | overdue)),
        ]
        return m
