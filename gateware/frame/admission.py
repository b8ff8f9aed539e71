"""Lets whole images in while they are wanted."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..layouts import Field, Video

SHORTEST_CLOCKS = 112
"""Clocks from the first pixel of an image to ``frame_end`` at least: one row and a blank row of the contract."""

APART_CLOCKS = 480
"""Clocks from an image's ``frame_end`` to the next image at least, where ``close_images`` are left out: the longest
glitch filter, and then 200 to complete the header."""


class Admission(wiring.Component):
    """Passes images on, from the first one that begins while ``run`` is set to the last that began so.

    The strobes keep an order whatever the camera does: to every ``frame_first`` belongs one
    ``frame_end``, at least ``shortest`` clocks later and before the next ``frame_first``. An image that
    ends sooner has its strobe later; one that begins before that strobe is refused; one that never ends
    is over when the next begins. The video itself is passed on as it comes, for its faults to be seen where
    they are counted.

    Latency one clock, from pixels to ``video`` and to the strobes alike.

    Parameters
    ----------
    shortest : clocks from the first pixel of an image to ``frame_end`` at least, :data:`SHORTEST_CLOCKS` or more
    close_images : an image may begin as soon as the one before has had its strobe. Without it, one that begins sooner
        than :data:`APART_CLOCKS` after that strobe, or before it, is refused as well, and rows after an image's end
        have no ``row_first``: what motion latched for an image then stays so for that long.

    Members
    -------
    i : images from the source
    run : images are wanted
    video : images let in
    frame_first, row_first : strobes, in the clock in which ``video`` has the first pixel of an image, of a row
    frame_end : strobe
    field : of the image let in, from ``frame_first`` to ``frame_end``
    refused : strobe: an image began too early, and is left out
    """

    def __init__(self, shortest: int = SHORTEST_CLOCKS, *, close_images: bool = True) -> None:
        self.shortest = shortest
        self.close_images = close_images
        super().__init__(
            {
                "i": In(Video()),
                "run": In(1),
                "video": Out(Video()),
                "frame_first": Out(1),
                "row_first": Out(1),
                "frame_end": Out(1),
                "field": Out(Field),
                "refused": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        pixel = self.i.pixel
        passing = Signal()
        open_ = Signal()  # frame_end is to come
        over = Signal()  # the image has ended, however early
        left = Signal(range(max(self.shortest, 0 if self.close_images else APART_CLOCKS) + 1))
        rested = Signal(init=1)  # left == 0, ahead of time

        begins = Signal()
        let_in = Signal()
        passes = Signal()
        ends = Signal()
        within = 1 if self.close_images else begins | ~over
        m.d.comb += [
            begins.eq(pixel.valid & pixel.payload.row_first & pixel.payload.frame_first),
            # In the clock of `frame_end` the next image may be on its way: it comes out a clock later.
            let_in.eq(begins & self.run & ((~open_ | rested) if self.close_images else (~open_ & rested))),
            passes.eq(Mux(begins, let_in, passing)),
            ends.eq((over | begins) & open_ & rested),
            self.frame_end.eq(ends),
        ]
        m.d.sync += [
            self.video.pixel.valid.eq(pixel.valid & passes),
            self.video.pixel.payload.eq(pixel.payload),
            self.video.field.eq(self.i.field),
            # An image that is cut off by one that does not come in must be closed for it.
            self.video.frame_end.eq((self.i.frame_end & passes) | (begins & passing & ~let_in & ~over)),
            self.frame_first.eq(let_in),
            self.row_first.eq(pixel.valid & pixel.payload.row_first & passes & within),
            self.refused.eq(begins & self.run & ~let_in),
        ]
        with m.If(begins):
            m.d.sync += passing.eq(let_in)
        with m.If(~rested):
            m.d.sync += [left.eq(left - 1), rested.eq(left == 1)]
        with m.If(ends):
            m.d.sync += open_.eq(0)
            if not self.close_images:
                m.d.sync += [left.eq(APART_CLOCKS), rested.eq(0)]
        with m.If((self.i.frame_end & passing) | begins):
            m.d.sync += over.eq(1)
        with m.If(let_in):
            m.d.sync += [self.field.eq(self.i.field), open_.eq(1), over.eq(self.i.frame_end)]
            m.d.sync += [left.eq(self.shortest), rested.eq(0)]
        return m
