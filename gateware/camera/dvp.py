"""The parallel port of small cameras (DVP): a byte a clock, two bytes a pixel, RGB565."""

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ..layouts import Field, Video
from .crossing import Crossing


class Dvp(wiring.Component):
    """Images of a camera with PCLK, HREF, VSYNC and D[7:0]; RGB565.

    PCLK is the clock of the domain ``camera``, and the bus is sampled at its rising edge. A row is a stretch in which
    HREF is high, its first byte the first of a pixel. Channels get their upper bits repeated below them, as
    :func:`sim.quantise.rgb565` has it. How images are crossed to ``sync``, and what becomes of faults: see
    :class:`~gateware.camera.crossing.Crossing`.

    Parameters
    ----------
    high_byte_first : red comes in the first byte of a pixel
    href_low, vsync_low : the signal is active low
    depth : of the FIFO

    Members
    -------
    href, vsync, d : the bus, as registered in ``camera``
    enable : images may begin: the camera is set up
    run : ignored: a camera cannot be held, and images that nobody wants are not let in
    video : images, in ``sync``
    cut, broken : images cut because ``sync`` is too slow; rows with half a pixel; saturating
    """

    def __init__(
        self,
        *,
        high_byte_first: bool = True,
        href_low: bool = False,
        vsync_low: bool = False,
        depth: int = 512,
    ) -> None:
        self.high_byte_first = high_byte_first
        self.href_low = href_low
        self.vsync_low = vsync_low
        self.crossing = Crossing(depth)
        super().__init__(
            {
                "href": In(1, init=href_low),
                "vsync": In(1, init=vsync_low),
                "d": In(8),
                "enable": In(1, init=1),
                "run": In(1),
                "video": Out(Video()),
                "cut": Out(8),
                "broken": Out(8),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.crossing = crossing = self.crossing
        connect(m, crossing.video, flipped(self.video))
        m.d.comb += [crossing.enable.eq(self.enable), self.cut.eq(crossing.cut), self.broken.eq(crossing.broken)]

        sampled = crossing.i
        href = self.href ^ self.href_low
        second = Signal()  # the next byte is a pixel's second
        first = Signal(8)
        low, high = (self.d, first) if self.high_byte_first else (first, self.d)
        m.d.camera += first.eq(self.d)
        colour = Cat(low, high)
        red, green, blue = colour[11:], colour[5:11], colour[:5]
        m.d.camera += [
            second.eq(href & ~second),
            sampled.row.eq(href),
            sampled.valid.eq(href & second),
            sampled.broken.eq(~href & second),
            sampled.r.eq(Cat(red[2:], red)),
            sampled.g.eq(Cat(green[4:], green)),
            sampled.b.eq(Cat(blue[2:], blue)),
            sampled.vertical.eq(self.vsync ^ self.vsync_low),
        ]
        m.d.comb += sampled.field.eq(Field.PROGRESSIVE)
        return m
