"""All that looks at every pixel, in the card's clock or in one of its own."""

from amaranth.hdl import Cat, DomainRenamer, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.wiring import In, Out, connect, flipped

from .crossing.exchange import FASTEST, Exchange
from .crossing.pictures import Pictures
from .crossing.results import Results
from .crossing.strobes import Strobes
from .features import EVERYTHING, Features
from .frame.admission import SHORTEST_CLOCKS, Admission
from .frame.facts import VisionFacts
from .frame.snapshot import Snapshot
from .layouts import CameraErrors, Field, FrameSettings, LutWrite, NowSettings, Packets, Rows, Video
from .vision.gated import GatedVision
from .vision.vision import Vision

SHORTEST_PIXELS = FASTEST * (SHORTEST_CLOCKS + 4)
"""Clocks from the first pixel of an image to its end at least, where they have a domain of their own: as many of
``sync``, and 4 for the phase of the clocks."""

_RUN_CLOCKS = 6  # more than a first pixel takes to its strobe

_MEMBERS = {
    "video": In(Video()),
    "run": In(1),
    "source_run": Out(1),
    "settings": In(FrameSettings),
    "lut": In(LutWrite()),
    "tables_busy": Out(1),
    "background": In(1),
    "wanted": Out(1),
    "frame_first": Out(1),
    "row_first": Out(1),
    "frame_end": Out(1),
    "refused": Out(1),
    "field": Out(Field),
    "subtracted": Out(1),
    "rows": Out(Rows()),
    "vision": Out(VisionFacts),
    "errors_ever": Out(CameraErrors),
    "now": In(NowSettings),
    "number": In(32),
    "generation": In(16),
    "snapshot": Out(Packets),
    "snapshot_busy": Out(1),
}


class PixelPath(wiring.Component):
    """Lets images in, measures them, and takes snapshots of them, all in ``sync``.

    Parameters
    ----------
    features : what is built

    Members
    -------
    video : images
    run : images are wanted
    source_run : the same, for the source of the images
    settings : of scope ``FRAME``, in force; new in the clock after ``frame_first``
    lut : writes to the gate tables; ``swap`` in the clock of ``frame_first``
    tables_busy : ``lut.valid`` must not come
    background : the present image is a background; steady from a clock after ``frame_first`` to ``frame_end``
    wanted : images may still come that began while ``run`` was set
    frame_first, row_first, frame_end, refused, field : as of :class:`~gateware.frame.admission.Admission`
    subtracted : the background is subtracted from the present image, as of ``frame_end``
    rows, vision : results; ``vision`` as of ``rows.frame_end``
    errors_ever : errors of all frames since reset, as they occur
    now : settings of scope ``NOW``; those of the snapshot are used
    number, generation : of the image that began last; new in the clock after ``frame_first``
    snapshot, snapshot_busy : as of :class:`~gateware.frame.snapshot.Snapshot`
    """

    def __init__(self, features: Features = EVERYTHING) -> None:
        self.features = features
        super().__init__(_MEMBERS)

    def elaborate(self, platform):
        m = Module()
        m.submodules.admission = admission = Admission(close_images=self.features.close_images)
        m.submodules.vision = vision = Vision(self.features) if self.features.runs else GatedVision(self.features)
        connect(m, flipped(self.video), admission.i)
        connect(m, admission.video, vision.video)
        connect(m, vision.rows, flipped(self.rows))
        connect(m, flipped(self.lut), vision.lut)
        m.d.comb += [
            admission.run.eq(self.run),
            self.source_run.eq(self.run),
            self.wanted.eq(self.run),
            vision.settings.eq(self.settings),
            self.vision.errors.eq(vision.errors),
            self.vision.columns.eq(vision.image_columns),
            self.errors_ever.eq(vision.errors_ever),
        ]
        if self.features.runs:
            m.d.comb += [vision.background.eq(self.background), self.subtracted.eq(vision.subtracted)]
        for name in ("frame_first", "row_first", "frame_end", "refused", "field"):
            m.d.comb += getattr(self, name).eq(getattr(admission, name))
        if self.features.snapshot:
            m.submodules.snapshot = snapshot = Snapshot()
            connect(m, vision.raw, snapshot.raw)
            connect(m, vision.measured, snapshot.measured)
            connect(m, snapshot.o, flipped(self.snapshot))
            m.d.comb += [
                snapshot.settings.eq(self.now),
                snapshot.frame.eq(self.number),
                snapshot.generation.eq(self.generation),
                self.snapshot_busy.eq(snapshot.busy),
            ]
        return m


class ClockedPixelPath(wiring.Component):
    """A :class:`PixelPath` whose ``video`` comes in a clock domain of its own, and is measured in it.

    All other members are in ``sync`` and mean the same, but ``source_run``, which is in ``domain``. What differs:

    - The pixels' clock may be up to :data:`~gateware.crossing.exchange.FASTEST` times ``sync``; it has no lower bound.
    - Strobes come later than the pixels, as :class:`~gateware.crossing.strobes.Strobes` has it, and rows as
      :class:`~gateware.crossing.results.Results` has it, of pixels that :class:`~gateware.crossing.exchange.Exchange`
      has held back by 16 clocks.
    - From an image's first pixel to the next image's there are :data:`SHORTEST_PIXELS` clocks at least; an image that
      comes sooner is refused. So ``sync`` has the clocks between ``frame_first`` and ``frame_end`` that it relies on.
    - In an image that :class:`~gateware.crossing.exchange.Exchange` calls ``late``, each row has ``overflow`` and the
      image ``framing``.

    While the clock stands still, nothing comes: no strobes, no rows, no bytes. Nothing in ``sync`` waits for it, but
    one write to a gate table (see :class:`~gateware.crossing.tables.TableGuard`), a snapshot, and images that are to
    come. When it goes on so does the rest, and what the camera did meanwhile shows in its errors.

    Single bits that mean something by themselves pass through two registers: ``run``, ``errors_ever``, and
    ``subtracted``, which changes in the first pixels of an image and is looked at hundreds of clocks later.

    Parameters
    ----------
    features : as of :class:`PixelPath`
    domain : name of the domain of ``video``

    Raises
    ------
    ValueError
        The card is built without ``runs``: a small one, which is measured in ``sync``.
    """

    def __init__(self, features: Features, domain: str) -> None:
        if not features.runs:
            raise ValueError("a card without runs has no clock of its own for the pixels: leave it in sync")
        self.features = features
        self.domain = domain
        super().__init__(_MEMBERS)

    def elaborate(self, platform):
        m = Module()
        inside = DomainRenamer(self.domain)
        admission, vision = Admission(SHORTEST_PIXELS), Vision(self.features)
        m.submodules.admission = inside(admission)
        m.submodules.vision = inside(vision)
        m.submodules.strobes = strobes = Strobes(self.domain)
        m.submodules.exchange = exchange = Exchange(self.domain)
        m.submodules.results = results = Results(self.domain)
        connect(m, flipped(self.video), admission.i)
        connect(m, admission.video, exchange.i_video)
        connect(m, exchange.video, vision.video)
        connect(m, exchange.lut, vision.lut)
        connect(m, flipped(self.lut), exchange.i_lut)
        connect(m, results.o, flipped(self.rows))
        self._run(m, admission)
        m.submodules.errors = FFSynchronizer(vision.errors_ever.as_value(), self.errors_ever.as_value())
        m.submodules.subtracted = FFSynchronizer(vision.subtracted, self.subtracted)
        for name in ("frame_first", "row_first", "frame_end", "refused", "field"):
            m.d.comb += [
                getattr(strobes, f"i_{name}").eq(getattr(admission, name)),
                getattr(self, name).eq(getattr(strobes, name)),
            ]
        for name in ("settings", "background", "number", "generation"):
            m.d.comb += getattr(exchange, f"i_{name}").eq(getattr(self, name))
        row = results.i.row
        m.d.comb += [
            exchange.i_frame_first.eq(admission.frame_first),
            exchange.answered.eq(strobes.answered),
            self.tables_busy.eq(exchange.tables_busy),
            vision.settings.eq(exchange.settings),
            vision.background.eq(exchange.background),
            row.valid.eq(vision.rows.row.valid),
            row.payload.eq(vision.rows.row.payload),
            row.payload.record.overflow.eq(vision.rows.row.payload.record.overflow | exchange.late),
            results.i.frame_end.eq(vision.rows.frame_end),
            results.i_vision.errors.eq(vision.errors),
            results.i_vision.errors.framing.eq(vision.errors.framing | exchange.late),
            results.i_vision.columns.eq(vision.image_columns),
            self.vision.eq(results.vision),
        ]
        if self.features.snapshot:
            m.submodules.pictures = pictures = Pictures(self.domain)
            connect(m, vision.raw, pictures.raw)
            connect(m, vision.measured, pictures.measured)
            connect(m, pictures.o, flipped(self.snapshot))
            m.d.comb += [
                pictures.frame.eq(exchange.number),
                pictures.generation.eq(exchange.generation),
                pictures.settings.eq(self.now),
                self.snapshot_busy.eq(pictures.busy),
            ]
        return m

    def _run(self, m: Module, admission: Admission) -> None:
        """``run`` there and back; it comes back after the strobes of the last image that it let in."""
        back = Signal(_RUN_CLOCKS)
        still = Signal()
        m.submodules.run_there = FFSynchronizer(self.run, admission.run, o_domain=self.domain)
        m.submodules.run_back = FFSynchronizer(back[-1], still)
        m.d[self.domain] += back.eq(Cat(admission.run, back))
        m.d.comb += [self.source_run.eq(admission.run), self.wanted.eq(self.run | still)]
