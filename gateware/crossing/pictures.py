"""A snapshot that is taken in the pixels' clock, and told and sent in the card's."""

from amaranth.hdl import Cat, DomainRenamer, Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out, connect, flipped

from ..camera.monitor import CheckedPixel
from ..frame.snapshot import Snapshot
from ..layouts import NowSettings, Packet, Packets
from ..vision.pixels import MeasuredPixel
from .handover import Handover

_SETTINGS = data.StructLayout({name: field.shape for name, field in NowSettings if name.startswith("snapshot")})


class Pictures(wiring.Component):
    """A :class:`~gateware.frame.snapshot.Snapshot` in the domain of the pixels; loses nothing that it does not.

    Its settings go there when ``settings.snapshot`` has changed, all at once. Its bytes come one by one, each in about
    4 clocks of ``sync`` and 4 of the pixels: faster than any link but USB with high speed, which then waits for them.
    ``busy`` is set from the change of ``settings.snapshot`` on.

    Parameters
    ----------
    domain : of the pixels

    Members
    -------
    raw, measured, frame, generation : as of :class:`~gateware.frame.snapshot.Snapshot`, in ``domain``
    settings, busy, o : the same in ``sync``
    """

    def __init__(self, domain: str) -> None:
        self.domain = domain
        super().__init__(
            {
                "raw": In(stream.Signature(CheckedPixel, always_ready=True)),
                "measured": In(stream.Signature(MeasuredPixel, always_ready=True)),
                "frame": In(32),
                "generation": In(16),
                "settings": In(NowSettings),
                "busy": Out(1),
                "o": Out(Packets),
            }
        )

    def elaborate(self, platform):
        m = Module()
        snapshot = Snapshot()
        m.submodules.snapshot = DomainRenamer(self.domain)(snapshot)
        m.submodules.asked = asked = Handover(_SETTINGS, "sync", self.domain)
        m.submodules.bytes = bytes_ = Handover(Packet, self.domain, "sync")
        connect(m, flipped(self.raw), snapshot.raw)
        connect(m, flipped(self.measured), snapshot.measured)
        connect(m, snapshot.o, bytes_.i)
        connect(m, bytes_.o, flipped(self.o))

        number = Signal.like(self.settings.snapshot)
        differs = Signal()
        taking = Signal()
        m.submodules.synchronizer = FFSynchronizer(snapshot.busy, taking)
        m.d.comb += [
            differs.eq(self.settings.snapshot != number),
            asked.i.valid.eq(differs),
            self.busy.eq(differs | ~asked.i.ready | taking),
            snapshot.frame.eq(self.frame),
            snapshot.generation.eq(self.generation),
        ]
        with m.If(asked.i.ready):
            m.d.sync += number.eq(self.settings.snapshot)

        # Called taken only when `busy` tells of it, which then is seen in `sync` as early as that.
        pixels = m.d[self.domain]
        settings = Signal(_SETTINGS)
        since = Signal(3)
        with m.If(asked.o.valid):
            pixels += settings.eq(asked.o.payload)
        m.d.comb += asked.o.ready.eq(since[-1])
        pixels += since.eq(Cat(asked.o.valid, since) & ~asked.o.ready.replicate(len(since)))
        for name in _SETTINGS.members:
            m.d.comb += [
                asked.i.payload[name].eq(self.settings[name]),
                snapshot.settings[name].eq(settings[name]),
            ]
        return m
