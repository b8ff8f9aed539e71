"""Pixels in, one measured row after another out."""

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.reference import measure

from ..camera.monitor import CheckedPixel, Monitor
from ..layouts import CameraErrors, FrameSettings, LutWrite, Rows, Video
from .choose import Choose
from .fir import Fir
from .lookahead import Lookahead
from .peak import Peak
from .pixels import MeasuredPixel, Pixels
from .runs import Runs, connect_fir
from .spread import Spread

FRAME_END_DELAY = 16
"""Clocks by which ``frame_end`` follows where a result would be: a row that broke the contract by being shorter than
the one before may wait for the divider for up to 9."""


class Vision(wiring.Component):
    """Measures the laser line in every row of every image, as :func:`magtrak.reference.measure` defines it.

    One pixel a clock; it never stalls. A row's record comes :attr:`latency` clocks after its last pixel. Every row
    gives one record, whether a line was found or not. What happens to images that break the camera's contract is told
    by :class:`~gateware.camera.monitor.Monitor`; such rows have ``overflow`` set, the frame its ``errors``.

    Parameters
    ----------
    max_columns : columns that an image may have, 16 to 2048
    max_rows : rows that an image may have, 1 to 2048

    Members
    -------
    video : images
    settings : in force; they may change in the clock after the first pixel of a frame was taken
    lut : writes to the gate's tables, and the swap, at that same time
    rows : results; ``frame_end`` comes at least one clock after the last row's
    errors, image_rows, image_columns : of the frame that ended, valid at ``rows.frame_end``
    errors_ever : errors of all frames since reset, as they occur
    raw, measured : what snapshots show: pixels of well-formed images before and after the point-wise stages

    Raises
    ------
    ValueError
        A limit is out of range.
    """

    def __init__(self, max_columns: int = 2048, max_rows: int = 2048) -> None:
        self._monitor = Monitor(max_columns, max_rows)
        self._peak = Peak(max_columns)
        self.max_columns = max_columns
        self.max_rows = max_rows
        super().__init__(
            {
                "video": In(Video()),
                "settings": In(FrameSettings),
                "lut": In(LutWrite()),
                "rows": Out(Rows()),
                "errors": Out(CameraErrors),
                "image_rows": Out(12),
                "image_columns": Out(12),
                "errors_ever": Out(CameraErrors),
                "raw": Out(stream.Signature(CheckedPixel, always_ready=True)),
                "measured": Out(stream.Signature(MeasuredPixel, always_ready=True)),
            }
        )

    reference = staticmethod(measure)

    @property
    def latency(self) -> int:
        """Clocks from the last pixel of a row to its record; the contract of the camera kept."""
        stages = Runs.latency + Choose.latency
        return Monitor.latency + Pixels.latency + Lookahead.latency + stages + self._peak.latency

    def elaborate(self, platform):
        m = Module()
        m.submodules.monitor = monitor = self._monitor
        m.submodules.pixels = pixels = Pixels()
        m.submodules.lookahead = lookahead = Lookahead()
        m.submodules.fir = fir = Fir()
        m.submodules.runs = runs = Runs()
        m.submodules.choose = choose = Choose()
        m.submodules.spread = spread = Spread()
        m.submodules.peak = peak = self._peak

        for block in (pixels, lookahead, runs, choose, peak):
            m.d.comb += block.settings.eq(self.settings)
        wiring.connect(m, monitor.video, wiring.flipped(self.video))
        wiring.connect(m, pixels.lut, wiring.flipped(self.lut))
        wiring.connect(m, monitor.pixel, pixels.i)
        wiring.connect(m, pixels.o, lookahead.i)
        wiring.connect(m, lookahead.o, spread.column)
        m.d.comb += [
            runs.column.p.eq(lookahead.o.p),
            runs.column.valid.eq(lookahead.o.valid),
            fir.step.eq(lookahead.step),
            fir.mix.eq(lookahead.mix),
            fir.row_first.eq(lookahead.row_first),
        ]
        connect_fir(m, fir, runs)
        wiring.connect(m, runs.o, choose.run)
        end = _strobe_delayed(m, spread.o.valid, Runs.latency + Choose.latency - Spread.latency, "row_end")
        m.d.comb += [peak.end.eq(end), peak.chosen.eq(choose.o), peak.gated.eq(spread.o.p), choose.clear.eq(peak.taken)]

        # Settings that change while a row is being measured make its record worthless.
        disturbed = Signal()
        with m.If(monitor.frame_gap):
            m.d.sync += disturbed.eq(1)
        with m.Elif(peak.o.valid):
            m.d.sync += disturbed.eq(0)
        m.d.comb += [
            self.rows.row.valid.eq(peak.o.valid),
            self.rows.row.p.eq(peak.o.p),
            self.rows.row.p.record.overflow.eq(peak.o.p.record.overflow | disturbed),
            self.rows.frame_end.eq(
                _strobe_delayed(m, monitor.frame_end, self.latency - Monitor.latency + FRAME_END_DELAY, "frame_end")
            ),
            self.errors.eq(monitor.errors),
            self.image_rows.eq(monitor.rows),
            self.image_columns.eq(monitor.columns),
            self.errors_ever.eq(monitor.errors_ever),
            self.raw.valid.eq(monitor.pixel.valid),
            self.raw.p.eq(monitor.pixel.p),
            self.measured.valid.eq(pixels.o.valid),
            self.measured.p.eq(pixels.o.p),
        ]
        return m


def _strobe_delayed(m: Module, strobe, clocks: int, name: str):
    line = Signal(clocks, name=f"{name}_line")
    m.d.sync += line.eq((line << 1) | strobe)
    return line[-1]
