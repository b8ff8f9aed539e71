"""Which images are taken without the laser."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak import reference
from magtrak.protocol import AmbientMode, Phase
from magtrak.reference.ambient import DARK, DARKENING, LIT

from ..layouts import FrameSettings


class Alternation(wiring.Component):
    """Goes on with each image that ends: :class:`magtrak.reference.Alternation` is the definition.

    The laser is switched a clock after ``frame_end``, in the gap between two images, and only ever off: ``laser``
    permits, and does not ask for light. In ``AmbientMode.OFF``, after reset and while no images are wanted it permits
    always: what comes next begins with a measured image.

    Members
    -------
    settings : ``ambient_mode`` and ``ambient_measured`` are used, at ``frame_end``
    run : images are wanted
    frame_first, frame_end : strobes: an image begins, is over
    subtracted : the background is subtracted from the present image
    laser : the laser may shine
    background : the present image is a background; from a clock after the ``frame_end`` before it
    phase : a :class:`magtrak.protocol.Phase`, of the present image
    """

    settings: In(FrameSettings)
    run: In(1)
    frame_first: In(1)
    frame_end: In(1)
    subtracted: In(1)
    laser: Out(1)
    background: Out(1)
    phase: Out(2)

    reference = reference.Alternation

    def elaborate(self, platform):
        m = Module()
        mode = self.settings.ambient_mode
        state = Signal(2, init=LIT)
        left = Signal(8)
        again = Signal()
        m.d.comb += again.eq((state == LIT) & (left != 0))
        following = Mux(mode == AmbientMode.SKIP, state + 1, Mux(state == DARK, LIT, DARK))[:2]
        within = Signal()  # an image
        m.d.sync += within.eq((within | self.frame_first) & ~self.frame_end)
        with m.If(~self.run & ~within & ~self.frame_first):
            m.d.sync += [state.eq(LIT), left.eq(0)]
        with m.Elif(self.frame_end):
            with m.If(mode == AmbientMode.OFF):
                m.d.sync += [state.eq(LIT), left.eq(0)]
            with m.Elif(again):
                m.d.sync += left.eq(left - 1)
            with m.Else():
                # Set long before it is used: only a measured image looks at it.
                m.d.sync += [state.eq(following), left.eq(self.settings.ambient_measured - 1)]

        unlit = Signal()
        m.d.comb += [
            unlit.eq((state == DARKENING) | (state == DARK)),
            self.laser.eq(~unlit),
            self.background.eq(state == DARK),
        ]
        with m.If(state == DARK):
            m.d.comb += self.phase.eq(Phase.BACKGROUND)
        with m.Elif(state != LIT):
            m.d.comb += self.phase.eq(Phase.SKIPPED)
        with m.Elif((mode != AmbientMode.OFF) & ~self.subtracted):
            m.d.comb += self.phase.eq(Phase.UNSUBTRACTED)
        with m.Else():
            m.d.comb += self.phase.eq(Phase.MEASURED)
        return m
