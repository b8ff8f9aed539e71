"""Measures a camera's timing, so that a wrong or unsteady one is seen."""

from amaranth.hdl import DomainRenamer, Module, Signal
from amaranth.lib import data, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out, connect, flipped

from ..crossing.mirror import Mirror
from ..layouts import CameraRow, Video

_PRESCALE_BITS = 3  # camera clocks are counted by 8
_GATE_BITS = 12  # over 4096 clocks of the card
_RATE_BITS = 11

MISSING_CLOCKS = 2 << _GATE_BITS
"""Clocks of the card after which a pixel clock that stopped is missing, at the latest: 0.66 ms at 12.5 MHz."""


class Timing(wiring.Component):
    """Pixel clock, row length and rows of a camera.

    Sizes are those of the last image that ended, modulo 4096 (the Monitor reports what is too large). An image is
    unsteady if its rows differ in length, or if it has other rows than the one before it.

    Parameters
    ----------
    domain : of ``video``; ``row``, ``row_count`` and ``unsteady`` come to ``sync`` a little later where it is another

    Members
    -------
    video : images, in ``domain``; only looked at
    rate : camera clocks in 4096 of ``sync``, divided by 8, or one less; fewer than 4 camera clocks to one of ``sync``
        are counted
    clock_missing : no 8 camera clocks came within :data:`MISSING_CLOCKS`, also until the first have come; a pixel
        clock below ``sync`` / 512 may be none
    row, row_count : of the last image, px
    unsteady : such images, saturating
    """

    def __init__(self, domain: str = "sync") -> None:
        self.domain = domain
        super().__init__(
            {
                "video": In(Video()),
                "rate": Out(_RATE_BITS),
                "clock_missing": Out(1, init=1),
                "row": Out(CameraRow),
                "row_count": Out(12),
                "unsteady": Out(4),
            }
        )

    def elaborate(self, platform):
        m = Module()
        self._clock(m)
        sizes = Sizes()
        m.submodules.sizes = DomainRenamer(self.domain)(sizes)
        connect(m, flipped(self.video), sizes.video)
        seen = sizes.seen
        if self.domain != "sync":
            m.submodules.mirror = mirror = Mirror(_Sizes, self.domain, "sync")
            m.d.comb += mirror.i.eq(seen)
            seen = mirror.o
        m.d.comb += [self.row.eq(seen.row), self.row_count.eq(seen.row_count), self.unsteady.eq(seen.unsteady)]
        return m

    def _clock(self, m: Module) -> None:
        prescaler = Signal(_PRESCALE_BITS)
        slow = Signal()
        before = Signal()
        beat = Signal()
        m.d.camera += prescaler.eq(prescaler + 1)
        m.submodules.synchronizer = FFSynchronizer(prescaler[-1], slow)
        m.d.sync += before.eq(slow)
        m.d.comb += beat.eq(slow & ~before)

        gate = Signal(_GATE_BITS)
        beats = Signal(_RATE_BITS)
        heard = Signal()  # a beat came since the gate opened
        m.d.sync += [gate.eq(gate + 1), beats.eq(beats + beat), heard.eq(heard | beat)]
        with m.If(gate.all()):
            m.d.sync += [self.rate.eq(beats), beats.eq(0), heard.eq(0)]
            m.d.sync += self.clock_missing.eq(~heard & ~beat)
        with m.Elif(beat):
            m.d.sync += self.clock_missing.eq(0)


class _Sizes(data.Struct):
    row: CameraRow
    row_count: 12
    unsteady: 4


class Sizes(wiring.Component):
    """The part of :class:`Timing` that looks at images.

    Lengths are compared for equality in passing, which takes half of what comparing their sizes would.

    Members
    -------
    video : images
    seen : of the last image, and how many were unsteady
    """

    video: In(Video())
    seen: Out(_Sizes)

    def elaborate(self, platform):
        m = Module()
        video, seen = self.video, self.seen
        pixel, valid = video.pixel.p, video.pixel.valid
        length = Signal(12)
        rows = Signal(12)
        shortest = Signal(12)
        longest = Signal(12)
        fresh = Signal(init=1)  # no row of this image yet
        measured = Signal()  # an image was measured
        shorter = Signal()  # this row has not reached the shortest
        longer = Signal()  # it is past the longest
        is_shortest = Signal()
        is_longest = Signal()
        m.d.comb += [is_shortest.eq(length == shortest), is_longest.eq(length == longest)]
        row_over = Signal()
        uneven = Signal()
        other = Signal()
        with m.If(valid & pixel.row_first):
            m.d.sync += [length.eq(1), shorter.eq(1), longer.eq(0)]
        with m.Else():
            with m.If(valid):
                m.d.sync += length.eq(length + 1)
            with m.If(is_shortest):
                m.d.sync += shorter.eq(0)
            with m.If(valid & is_longest):
                m.d.sync += longer.eq(1)
        m.d.sync += row_over.eq(valid & pixel.row_last)
        with m.If(row_over):
            m.d.sync += [fresh.eq(0), uneven.eq(~fresh & (uneven | longer | (shorter & ~is_shortest)))]
            m.d.sync += rows.eq(rows + 1)
            with m.If(fresh | (shorter & ~is_shortest)):
                m.d.sync += shortest.eq(length)
            with m.If(fresh | longer):
                m.d.sync += longest.eq(length)

        # The last row may have ended with the image: three clocks, and all of it is known.
        ended = Signal(3)
        m.d.sync += [ended.eq(ended << 1 | video.frame_end), other.eq((rows != seen.row_count) & measured)]
        with m.If(ended[2] & ~fresh):
            m.d.sync += [
                rows.eq(0),
                fresh.eq(1),
                measured.eq(1),
                seen.row.shortest.eq(shortest),
                seen.row.longest.eq(longest),
                seen.row_count.eq(rows),
            ]
            with m.If((uneven | other) & ~seen.unsteady.all()):
                m.d.sync += seen.unsteady.eq(seen.unsteady + 1)
        return m
