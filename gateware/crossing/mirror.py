"""A value that changes at times, shown on the other side of the clocks."""

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .handover import Handover


class Mirror(wiring.Component):
    """Shows in ``o_domain`` what ``i`` is in ``i_domain``, again and again, by a
    :class:`~gateware.crossing.handover.Handover`.

    ``o`` is always a value that ``i`` had, never a mix of two, and after a change of ``i`` the new one is there within
    7 clocks of ``i_domain`` and 5 of ``o_domain``. What lasts shorter may not be seen. Where a clock stands still ``o``
    stays.

    Parameters
    ----------
    shape : of the value
    i_domain, o_domain : names of the clock domains

    Members
    -------
    i : in ``i_domain``
    o : in ``o_domain``
    """

    def __init__(self, shape, i_domain: str, o_domain: str) -> None:
        self.shape = shape
        self.i_domain = i_domain
        self.o_domain = o_domain
        super().__init__({"i": In(shape), "o": Out(shape)})

    def elaborate(self, platform):
        m = Module()
        m.submodules.handover = handover = Handover(self.shape, self.i_domain, self.o_domain)
        shown = Signal.like(self.o)
        m.d.comb += [
            handover.i.valid.eq(1),
            handover.i.payload.eq(self.i),
            handover.o.ready.eq(1),
            self.o.eq(shown),
        ]
        with m.If(handover.o.valid):
            m.d[self.o_domain] += shown.eq(handover.o.payload)
        return m
