"""What holds for a whole image, from the card's clock to the pixels'."""

from amaranth.hdl import Cat, DomainRenamer, Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ..arithmetic import delayed
from ..layouts import FrameSettings, LutWrite, Video
from .handover import Handover

DELAY = 16
"""Clocks by which the pixels wait for the answer to their first."""

FASTEST = 4
"""Clocks of the pixels to one of ``sync``, at most, for the answer to come in time: it takes 3 of ``sync`` and 4."""


class _TableWord(data.Struct):
    """A write to the gate's tables, and the parity of the swaps before it."""

    axis: 2
    word: 3
    data: 32
    swaps: 1


class Exchange(wiring.Component):
    """Holds images back until ``sync`` has heard of their first pixel, and takes from it what is to hold for them.

    The first pixel of an image is told to ``sync`` at once (:class:`~gateware.crossing.strobes.Strobes`). There, in the
    clock in which that is heard, the registers bring new settings in force or do not, as they do in a card of one
    clock; commands and images have one order, which is that of ``sync``. Then everything below stands still until the
    first pixel of the next image. The pixels come out :data:`DELAY` clocks late, by when the answer is back, and what
    stands still is copied in the clock of the first: a plain register at each bit, which nothing synchronises because
    nothing moves. Frame and generation that the card sends were read in the same clock of ``sync``, so they tell
    exactly which images have which settings.

    An answer that is late belongs to a pixel clock of more than :data:`FASTEST` times ``sync``, or to an image that
    began within 20 clocks of the last strobe, as no camera that keeps the contract has it. It is taken when it comes,
    and the image is marked ``late``: its rows must not be used.

    Gate tables are written through a :class:`~gateware.crossing.handover.Handover`. Each word knows after how many
    swaps it was written, and waits for a swap that comes to its image only now; none can overtake another, for the
    commit after a word is more than 10 clocks of ``sync`` later, and both come through synchronisers of one length.

    Parameters
    ----------
    domain : of the pixels

    Members
    -------
    i_video, i_frame_first, answered : images let in, the strobe with their first pixels, and whether ``sync`` has heard
        of it; in ``domain``
    i_settings, i_background, i_number, i_generation, i_lut : in ``sync``, as :class:`~gateware.pixel_path.PixelPath`
        has them
    tables_busy : in ``sync``: a word is under way to the tables, and ``i_lut.valid`` must not come
    video : images, in ``domain``
    settings, number, generation, lut.swap : in ``domain``, new in the clock after the image's first pixel
    background : in ``domain``, new in the clock of the image's first pixel
    late : in ``domain``: the image's settings came too late; until two images were in time
    """

    def __init__(self, domain: str) -> None:
        self.domain = domain
        super().__init__(
            {
                "i_video": In(Video()),
                "i_frame_first": In(1),
                "answered": In(1),
                "i_settings": In(FrameSettings),
                "i_background": In(1),
                "i_number": In(32),
                "i_generation": In(16),
                "i_lut": In(LutWrite()),
                "tables_busy": Out(1),
                "video": Out(Video()),
                "settings": Out(FrameSettings),
                "background": Out(1),
                "number": Out(32),
                "generation": Out(16),
                "lut": Out(LutWrite()),
                "late": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        self._delay(m)
        go = self._copy(m)
        self._tables(m, go)
        return m

    def _delay(self, m: Module) -> None:
        strobes = Signal(2 * DELAY)
        i = self.i_video
        o = self.video
        pixel = Signal.like(i.pixel.payload, reset_less=True)
        renamed = Module()  # what has only the domain `sync`
        renamed.d.comb += pixel.eq(delayed(renamed, i.pixel.payload, DELAY, "pixel"))
        m.submodules.delay = DomainRenamer(self.domain)(renamed)
        m.d[self.domain] += strobes.eq(Cat(i.pixel.valid, i.frame_end, strobes))
        m.d.comb += [o.pixel.payload.eq(pixel), Cat(o.pixel.valid, o.frame_end).eq(strobes[-2:])]

    def _copy(self, m: Module) -> Signal:
        """The strobe in which what stands still is copied."""
        pixels = m.d[self.domain]
        line = Signal(DELAY - 1)
        due = Signal()  # the answer is
        passed = Signal()  # the first pixel has come out without
        answers = Signal()
        go = Signal()
        late_now = Signal()
        late_before = Signal()
        exits = due & line[-1]  # in the next clock
        m.d.comb += [answers.eq((exits | passed) & self.answered), self.late.eq(late_now | late_before)]
        pixels += [line.eq(Cat(self.i_frame_first, line)), go.eq(answers)]
        with m.If(exits):
            pixels += [passed.eq(~self.answered), late_now.eq(~self.answered), late_before.eq(late_now)]
        with m.If(answers):
            pixels += [due.eq(0), passed.eq(0), self.background.eq(self.i_background)]
        with m.If(self.i_frame_first):
            pixels += due.eq(1)
        for name in ("settings", "number", "generation"):
            copy = Signal.like(getattr(self, name), name=f"copy_{name}", reset_less=True)
            with m.If(go):
                pixels += copy.eq(getattr(self, f"i_{name}"))
            m.d.comb += getattr(self, name).eq(copy)
        return go

    def _tables(self, m: Module, go: Signal) -> None:
        swaps = Signal()  # parity of the swaps in `sync`
        swapped = Signal()  # of those that have come
        written = Signal.like(self.i_lut.written)
        with m.If(self.i_lut.swap):
            m.d.sync += [swaps.eq(~swaps), written.eq(self.i_lut.written)]
        m.submodules.handover = handover = Handover(_TableWord, "sync", self.domain)
        word, write = handover.i.payload, handover.o.payload
        m.d.comb += [
            handover.i.valid.eq(self.i_lut.valid),
            word.swaps.eq(swaps),
            self.tables_busy.eq(~handover.i.ready),
            handover.o.ready.eq(write.swaps == swapped),
            self.lut.valid.eq(handover.o.valid & handover.o.ready),
            self.lut.swap.eq(go & (swaps != swapped)),
            self.lut.written.eq(written),
        ]
        for name in ("axis", "word", "data"):
            m.d.comb += [word[name].eq(getattr(self.i_lut, name)), getattr(self.lut, name).eq(write[name])]
        with m.If(go):
            m.d[self.domain] += swapped.eq(swaps)
