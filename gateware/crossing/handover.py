"""From one clock to another, a word now and then."""

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out


class Handover(wiring.Component):
    """A stream across two clocks of any ratio and phase: one word at a time, held still until it was taken.

    Why it is safe: ``request`` and ``taken``, one bit each, are all that passes through synchronisers of two stages. A
    bit that is caught while it changes shows a clock sooner or later, and no more than that. The word is written in
    the clock in which ``request`` changes, is looked at only once that was seen two edges of ``o_domain`` later, and
    is not written again before ``taken`` came back. So its wires have a whole clock of ``o_domain`` to settle: the
    longest path between the domains has to be shorter than that, which :func:`boards.build.check` sees to.

    Latency from ``i`` to ``o``: a clock of ``i_domain``, then more than 1 and up to 2 of ``o_domain``. Throughput: a
    word in 4 clocks of ``i_domain`` and 3 of ``o_domain`` at the least. Nothing is lost and nothing comes twice; while
    one of the clocks stands, what is under way waits.

    Both domains are reset together, or neither is.

    Parameters
    ----------
    shape : of a word
    i_domain, o_domain : names of the clock domains

    Members
    -------
    i : stream in ``i_domain``; ``ready``: the word before has been taken
    o : stream in ``o_domain``; its payload is not to be looked at unless it is ``valid``
    """

    def __init__(self, shape, i_domain: str, o_domain: str) -> None:
        self.i_domain = i_domain
        self.o_domain = o_domain
        super().__init__({"i": In(stream.Signature(shape)), "o": Out(stream.Signature(shape))})

    def elaborate(self, platform):
        m = Module()
        here, there = m.d[self.i_domain], m.d[self.o_domain]
        request = Signal()
        requested = Signal()
        taken = Signal()
        returned = Signal()
        word = Signal.like(self.i.payload, reset_less=True)
        m.submodules.forth = FFSynchronizer(request, requested, o_domain=self.o_domain)
        m.submodules.back = FFSynchronizer(taken, returned, o_domain=self.i_domain)
        m.d.comb += [
            self.i.ready.eq(request == returned),
            self.o.valid.eq(requested != taken),
            self.o.payload.eq(word),
        ]
        with m.If(self.i.valid & self.i.ready):
            here += [word.eq(self.i.payload), request.eq(~request)]
        with m.If(self.o.valid & self.o.ready):
            there += taken.eq(requested)
        return m
