"""When there is time for a piece of a snapshot."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

TICK = 256
"""Clocks of one unit of time here."""

PIECE_BYTES = 2 * TICK
"""More than any piece takes on the line: 375 bytes of payload, 7 around it, 3 of COBS."""

_TICKS_BITS = 16
_BYTE_BITS = 12
_OVERDUE_BIT = 12
OVERDUE_CLOCKS = TICK << _OVERDUE_BIT


class Gap(wiring.Component):
    """Says whether a piece fits between this frame and the next, so that the next comes no later for it.

    The gaps from the end of a frame to the beginning of the next are measured, and the shorter one of the last two is
    expected again: cameras have a rhythm, and where an image was dropped only one gap is long. How long a piece takes
    is told by the last byte that went out behind another. A line that is full has no gap, and no piece goes; one on
    which no frame has come for twice the gap, and for 2**20 clocks, is free.

    All this is decided once in :data:`TICK` clocks, bit by bit, the lowest first.

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

        # Clocks from one byte to the next, where it waited all the time, and one more.
        since = Signal(_BYTE_BITS, init=2)
        byte_clocks = Signal(_BYTE_BITS, init=(1 << _BYTE_BITS) - 1)
        steady = Signal()
        m.d.sync += steady.eq((steady | self.moved) & self.waits)
        with m.If(self.moved):
            m.d.sync += since.eq(2)
            with m.If(steady):
                m.d.sync += byte_clocks.eq(since)
        with m.Elif(~since.all()):
            m.d.sync += since.eq(since + 1)

        # Frames: what happened since the last turn, and what of it this turn knows.
        tick = Signal(range(TICK))
        turns = Signal()
        first = Signal()
        end = Signal()
        place = tick[: (_TICKS_BITS - 1).bit_length()]
        m.d.comb += [turns.eq(tick[len(place) :] == 0), first.eq(place == 0), end.eq(turns & place.all())]
        within = Signal()
        began = Signal()
        over = Signal()
        storing = Signal()
        clearing = Signal()
        m.d.sync += tick.eq(tick + 1)
        with m.If(~turns):
            m.d.sync += [storing.eq(began), clearing.eq(over)]
        with m.If(self.frame & ~within):
            m.d.sync += [within.eq(1), began.eq(1)]
        with m.Elif(end & storing):
            m.d.sync += began.eq(0)
        with m.If(self.frame_last):
            m.d.sync += [within.eq(0), over.eq(1)]
        with m.Elif(end & clearing):
            m.d.sync += over.eq(0)

        # Ticks since the last frame was out, and how many there were between the two before. In a turn each bit of them
        # is at the lowest place once.
        elapsed = Signal(_TICKS_BITS)
        gap = Signal(_TICKS_BITS)
        before = Signal(_TICKS_BITS)
        counted = Signal()
        stored = Signal()
        stored_before = Signal()
        carry = Signal()  # of the bits so far: they are counted up
        full = Signal()  # they are all set
        m.d.comb += [
            counted.eq((elapsed[0] ^ carry) & ~clearing),
            stored.eq(Mux(storing, elapsed[0], gap[0])),
            stored_before.eq(Mux(storing, gap[0], before[0])),
        ]
        with m.If(turns):
            m.d.sync += [
                elapsed.eq(Cat(elapsed[1:], counted)),
                gap.eq(Cat(gap[1:], stored)),
                before.eq(Cat(before[1:], stored_before)),
                carry.eq(elapsed[0] & carry),
                full.eq((full | first) & counted),
            ]
        with m.Else():
            m.d.sync += carry.eq(~full)

        # A piece takes byte_clocks * PIECE_BYTES / TICK ticks; two more because both times are rounded.
        assert PIECE_BYTES == 2 * TICK
        above = Signal()
        piece = Signal()
        summed = Signal(2)
        fits = Signal()
        fits_before = Signal()
        early = Signal()
        long_ = Signal()
        m.d.comb += [
            piece.eq(Cat(0, byte_clocks, Const(0, _TICKS_BITS - 1 - _BYTE_BITS)).bit_select(place, 1)),
            summed.eq(counted + piece + (above & ~first)),
        ]
        half = elapsed[1] & ~clearing & ~place.all()

        def at_most(one, other, so_far):
            """Whether ``one`` is not above ``other``, by these bits and the verdict on the lower ones."""
            return Mux(one == other, so_far | first, other)

        with m.If(turns):
            m.d.sync += [
                above.eq(summed[1]),
                fits.eq(at_most(summed[0], stored, fits)),
                fits_before.eq(at_most(summed[0], stored_before, fits_before)),
                early.eq(at_most(half, stored, early)),
                long_.eq((long_ & ~first) | (counted & (place >= _OVERDUE_BIT))),
            ]
        idle = ~self.frame & ~within & ~turns & ~over
        m.d.sync += self.open.eq(idle & ((fits & fits_before & ~above) | (long_ & ~early)))
        return m
