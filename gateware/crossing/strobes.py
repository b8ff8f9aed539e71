"""What happens to images, told across the clocks in order."""

from amaranth.hdl import Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ..layouts import Field
from .handover import Handover


class Happening(data.Struct):
    """What came together; an ``end`` before all else."""

    end: 1
    first: 1
    row: 1
    refused: 1
    field: Field


class Strobes(wiring.Component):
    """Carries the strobes of :class:`~gateware.frame.admission.Admission` to ``sync``, and tells when it is heard.

    Latency of ``row_first`` and ``frame_first``, and so the error of all stamps taken by them: a clock of the pixels,
    then more than 1 and up to 2 of ``sync``; the phase of the clocks decides. The mean is a clock of the pixels and 1.5
    of ``sync``, the jitter half a clock of ``sync`` to either side: at 148.5 and 60 MHz 32 ns +- 8 ns. ``frame_end``
    and ``refused`` take a clock of the pixels longer. A first pixel that comes right after the end of a cut-off image
    is a clock of ``sync`` later.

    What comes while the strobe before is still under way (up to 3 clocks of ``sync`` and 4 of the pixels) waits for it,
    and what waits is told at once. With a camera that keeps the contract nothing waits, for rows are 48 clocks apart;
    of one that does not, several rows or refused images within that time are told as one.

    Parameters
    ----------
    domain : of the pixels

    Members
    -------
    i_frame_first, i_row_first, i_frame_end, i_refused, i_field : as they come, in ``domain``
    answered : in ``domain``: no ``i_frame_first`` is under way, nor comes in this clock; where one was, ``sync`` has
        acted on it, and what it made of it stands still
    frame_first, row_first, frame_end, refused : strobes in ``sync``
    field : of the image, from its ``frame_first`` until the next
    """

    def __init__(self, domain: str) -> None:
        self.domain = domain
        super().__init__(
            {
                "i_frame_first": In(1),
                "i_row_first": In(1),
                "i_frame_end": In(1),
                "i_refused": In(1),
                "i_field": In(Field),
                "answered": Out(1),
                "frame_first": Out(1),
                "row_first": Out(1),
                "frame_end": Out(1),
                "refused": Out(1),
                "field": Out(Field),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.handover = handover = Handover(Happening, self.domain, "sync")
        pixels = m.d[self.domain]

        # An image's end waits for a clock: the next one may begin in it, and both are told in one.
        told = handover.i.payload
        waits = Signal(Happening)
        under_way = Signal()  # a first pixel is
        m.d.comb += [
            told.end.eq(waits.end),
            told.first.eq(self.i_frame_first | waits.first),
            told.row.eq(self.i_row_first | waits.row),
            told.refused.eq(waits.refused & ~told.first),  # each counts an image
            told.field.eq(self.i_field),
            handover.i.valid.eq(told.end | told.first | told.row | told.refused),
            self.answered.eq(~told.first & (~under_way | handover.i.ready)),
        ]
        with m.If(handover.i.ready):
            pixels += [waits.end.eq(0), waits.first.eq(0), waits.row.eq(0)]
            pixels += waits.refused.eq(waits.refused & told.first)
            pixels += under_way.eq(told.first)
        with m.Else():
            pixels += [waits.first.eq(told.first), waits.row.eq(told.row)]
        with m.If(self.i_frame_end):
            pixels += waits.end.eq(1)
        with m.If(self.i_refused):
            pixels += waits.refused.eq(1)

        heard = Signal()
        what = handover.o.payload
        ended = Signal()  # the end of these two was a clock ago
        both = what.end & what.first
        m.d.comb += [
            handover.o.ready.eq(~both | ended),
            heard.eq(handover.o.valid & handover.o.ready),
            self.frame_first.eq(heard & what.first),
            self.row_first.eq(heard & what.row),
            self.refused.eq(heard & what.refused),
            self.frame_end.eq(handover.o.valid & what.end & ~ended),
        ]
        m.d.sync += ended.eq(handover.o.valid & both & ~ended)
        with m.If(self.frame_first):
            m.d.sync += self.field.eq(what.field)
        return m
