"""Rows and their images' errors, from the pixels' clock to the card's."""

from amaranth.hdl import Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ..frame.facts import VisionFacts
from ..layouts import RowResult, Rows
from .handover import Handover

WRITING_CLOCKS = 8
"""That :class:`~gateware.frame.rows.RowStore` takes for a row, and some."""


class _Word(data.Struct):
    """A row, or with ``end`` what is known of its image."""

    row: RowResult
    end: 1
    vision: VisionFacts


class Results(wiring.Component):
    """Carries the results of :class:`~gateware.vision.vision.Vision` to ``sync``, one at a time.

    The image's end comes :data:`WRITING_CLOCKS` of ``sync`` after its last row at least.

    None is ever lost: rows are at least 32 clocks apart, and one is taken after at most 3 clocks of ``sync`` and 4 of
    the pixels, so the pixels' clock may be up to nine times that of ``sync``. Should one be lost all the same, its
    image has the error ``rows``: rows of it are missing. The image's end waits until its last row was taken.

    Latency: a clock of the pixels, then more than 1 and up to 2 of ``sync``; the image's end takes a clock of the
    pixels longer. In ``sync`` rows may be as close as these 32 clocks of the pixels are.

    Parameters
    ----------
    domain : of the pixels

    Members
    -------
    i, i_vision : results, in ``domain``; ``i_vision`` as of ``i.frame_end``
    o, vision : the same in ``sync``, ``vision`` as of ``o.frame_end``
    """

    def __init__(self, domain: str) -> None:
        self.domain = domain
        super().__init__({"i": In(Rows()), "i_vision": In(VisionFacts), "o": Out(Rows()), "vision": Out(VisionFacts)})

    def elaborate(self, platform):
        m = Module()
        m.submodules.handover = handover = Handover(_Word, self.domain, "sync")
        pixels = m.d[self.domain]
        ended = Signal()
        vision = Signal(VisionFacts, reset_less=True)
        lost = Signal()
        word, row = handover.i.payload, self.i.row
        m.d.comb += [
            handover.i.valid.eq(row.valid | ended),
            word.row.eq(row.payload),
            word.end.eq(~row.valid),
            word.vision.eq(vision),
            word.vision.errors.rows.eq(vision.errors.rows | lost),
        ]
        with m.If(row.valid):
            with m.If(~handover.i.ready):
                pixels += lost.eq(1)
        with m.Elif(ended & handover.i.ready):
            pixels += [ended.eq(0), lost.eq(0)]
        with m.If(self.i.frame_end):
            pixels += [ended.eq(1), vision.eq(self.i_vision)]

        word = handover.o.payload
        writing = Signal(range(WRITING_CLOCKS + 1))
        with m.If(self.o.row.valid):
            m.d.sync += writing.eq(WRITING_CLOCKS)
        with m.Elif(writing != 0):
            m.d.sync += writing.eq(writing - 1)
        m.d.comb += [
            handover.o.ready.eq(~word.end | (writing == 0)),
            self.o.row.valid.eq(handover.o.valid & ~word.end),
            self.o.row.payload.eq(word.row),
            self.o.frame_end.eq(handover.o.valid & word.end & (writing == 0)),
            self.vision.eq(word.vision),
        ]
        return m
