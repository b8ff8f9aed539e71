"""Parallel video: a pixel a clock, 8 bits a channel, with syncs and data enable; DVI receivers and video converters."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import enum, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ..layouts import Field, Video
from .crossing import Crossing
from .forming import Direct

_LINE_BITS = 13  # a line has fewer than 8192 clocks


class Interlace(enum.Enum):
    """How a field is told."""

    NONE = 0  # all images are whole
    PHASE = 1  # by where in a line the vertical sync comes: CEA-861
    PIN = 2  # by a signal of its own


class Rgb(wiring.Component):
    """Images of a source with pixel clock, HS, VS, DE and 24 data lines.

    The pixel clock is that of the domain ``camera``. Pixels are those under DE, which falls between rows. Crossing to
    ``sync`` and faults: see :class:`~gateware.camera.crossing.Crossing`; with ``own_clock`` nothing crosses, see
    :class:`~gateware.camera.forming.Direct`.

    Interlaced pictures come as two images, ``field`` EVEN with rows 0, 2, ... and ODD with rows 1, 3, .... By
    ``PHASE``, a field whose vertical sync begins with a line (within a quarter of it) is ``at_line``, one whose
    vertical sync begins in the middle of a line is the other. By ``PIN``, the field pin is looked at with the image's
    first pixel; high means ODD, unless ``field_invert``.

    Parameters
    ----------
    hs_low, vs_low, de_low : the signal is active low
    interlace : see above
    at_line : EVEN where the field with the upper row has its vertical sync at a line's begin (1080i), else ODD
    field_invert : high means EVEN
    depth : of the FIFO
    own_clock : ``video`` and ``broken`` stay in ``camera``, ``cut`` is 0

    Members
    -------
    hs, vs, de, field_pin, r, g, b : the bus, as registered in ``camera``
    run, video, cut, broken : as in :class:`~gateware.camera.dvp.Dvp`

    Raises
    ------
    ValueError
        ``at_line`` is no field of an interlaced picture.
    """

    def __init__(
        self,
        *,
        hs_low: bool = False,
        vs_low: bool = False,
        de_low: bool = False,
        interlace: Interlace = Interlace.NONE,
        at_line: Field = Field.EVEN,
        field_invert: bool = False,
        depth: int = 512,
        own_clock: bool = False,
    ) -> None:
        if at_line not in (Field.EVEN, Field.ODD):
            raise ValueError(f"at_line is {at_line}; Field.EVEN and Field.ODD are possible")
        self.hs_low = hs_low
        self.vs_low = vs_low
        self.de_low = de_low
        self.interlace = interlace
        self.at_line = at_line
        self.field_invert = field_invert
        self.own_clock = own_clock
        self.crossing = Direct() if own_clock else Crossing(depth)
        super().__init__(
            {
                "hs": In(1, init=hs_low),
                "vs": In(1, init=vs_low),
                "de": In(1, init=de_low),
                "field_pin": In(1),
                "r": In(8),
                "g": In(8),
                "b": In(8),
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
        m.d.comb += self.broken.eq(crossing.broken)
        if isinstance(crossing, Crossing):
            m.d.comb += self.cut.eq(crossing.cut)

        sampled = crossing.i
        de, vs = self.de ^ self.de_low, self.vs ^ self.vs_low
        m.d.camera += [sampled.row.eq(de), sampled.valid.eq(de), sampled.vertical.eq(vs)]
        for name in ("r", "g", "b"):
            m.d.camera += getattr(sampled, name).eq(getattr(self, name))

        if self.interlace is Interlace.NONE:
            m.d.comb += sampled.field.eq(Field.PROGRESSIVE)
        elif self.interlace is Interlace.PIN:
            m.d.camera += sampled.field.eq(Mux(self.field_pin ^ self.field_invert, Field.ODD, Field.EVEN))
        else:
            other = Field.ODD if self.at_line is Field.EVEN else Field.EVEN
            m.d.camera += sampled.field.eq(Mux(self._in_the_middle(m, vs), other, self.at_line))
        return m

    def _in_the_middle(self, m: Module, vs) -> Signal:
        """Whether the vertical sync last came on in the two middle quarters of a line."""
        hs = self.hs ^ self.hs_low
        hs_before = Signal()
        vs_before = Signal()
        at = Signal(_LINE_BITS)  # clocks since the line began
        line = Signal(_LINE_BITS)  # of a whole line
        m.d.camera += [hs_before.eq(hs), vs_before.eq(vs)]
        with m.If(hs & ~hs_before):
            m.d.camera += [at.eq(1), line.eq(at)]
        with m.Elif(~at.all()):
            m.d.camera += at.eq(at + 1)
        middle = Signal()
        with m.If(vs & ~vs_before):
            # Both begin in one clock: `at` still counts the line before, and is its length.
            m.d.camera += middle.eq(((at << 2) > line) & ((at << 2) < line + (line << 1)))
        return middle
