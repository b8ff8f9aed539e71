"""Pixels in, one measured row after another out."""

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.reference import measure

from ..camera.monitor import CheckedPixel, Monitor
from ..layouts import CameraErrors, FrameSettings, LutWrite, Rows, Video
from .background import DEFAULT_CELLS
from .choose import Choose
from .fir import Fir
from .isolate import Isolate
from .lookahead import Lookahead
from .peak import Peak
from .pixels import MeasuredPixel, Pixels
from .runs import Runs, connect_fir
from .spread import Spread
from .window import Window

FRAME_END_DELAY = 16
"""Clocks by which ``frame_end`` follows where a result would be: a row that broke the contract by being shorter than
the one before may wait for the divider for up to 9."""


class Vision(wiring.Component):
    """Measures the laser line in every row of every image, as :func:`magtrak.reference.measure` defines it.

    One pixel a clock; it never stalls. A row's record comes :attr:`latency` clocks after its last pixel, and with the
    isolated-pixel filter after the last pixel of the next row, or as if one followed the image in its blank row. Every
    row gives one record, whether a line was found or not. What happens to images that break the camera's contract is
    told by :class:`~gateware.camera.monitor.Monitor`; such rows have ``overflow`` set, the frame its ``errors``.

    Parameters
    ----------
    max_columns : columns that an image may have, 16 to 2048
    max_rows : rows that an image may have, 1 to 2048
    background_cells : see :class:`~gateware.vision.background.Background`

    Members
    -------
    video : images
    background : the present image is a background; from before its first pixel until its end
    subtracted : the background is subtracted from the present image; from 4 clocks after its first pixel on
    settings : in force; they may change in the clock after the first pixel of a frame was taken
    lut : writes to the gate's tables, and the swap, at that same time, which comes with all new settings
    rows : results; ``frame_end`` comes at least one clock after the last row's
    errors, image_rows, image_columns : of the frame that ended, valid at ``rows.frame_end``
    errors_ever : errors of all frames since reset, as they occur
    raw, measured : what snapshots show: pixels of well-formed images before and after the point-wise stages

    Raises
    ------
    ValueError
        A limit is out of range.
    """

    def __init__(self, max_columns: int = 2048, max_rows: int = 2048, background_cells: int = DEFAULT_CELLS) -> None:
        self._pixels = Pixels(background_cells)
        self._monitor = Monitor(max_columns, max_rows)
        self._window = Window(max(max_columns, 16))
        self._peak = Peak(max_columns, self._window.latency)
        self.max_columns = max_columns
        self.max_rows = max_rows
        super().__init__(
            {
                "video": In(Video()),
                "settings": In(FrameSettings),
                "lut": In(LutWrite()),
                "background": In(1),
                "subtracted": Out(1),
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
        return Monitor.latency + Pixels.latency + Isolate.latency + Lookahead.latency + stages + self._peak.latency

    def elaborate(self, platform):
        m = Module()
        m.submodules.monitor = monitor = self._monitor
        m.submodules.pixels = pixels = self._pixels
        m.submodules.isolate = isolate = Isolate(max(self.max_columns, 2))
        m.submodules.lookahead = lookahead = Lookahead()
        m.submodules.fir = fir = Fir()
        m.submodules.runs = runs = Runs()
        m.submodules.choose = choose = Choose()
        m.submodules.spread = spread = Spread()
        m.submodules.window = window = self._window
        m.submodules.peak = peak = self._peak

        for block in (pixels, isolate, lookahead, runs, choose, window, peak):
            m.d.comb += block.settings.eq(self.settings)
        wiring.connect(m, monitor.video, wiring.flipped(self.video))
        wiring.connect(m, pixels.lut, wiring.flipped(self.lut))
        wiring.connect(m, monitor.pixel, pixels.i)
        m.d.comb += [
            pixels.image_end.eq(monitor.frame_end),
            pixels.faulty.eq(monitor.errors.as_value().any()),
            pixels.image_rows.eq(monitor.rows),
            pixels.image_columns.eq(monitor.columns),
            pixels.background.eq(self.background),
            self.subtracted.eq(pixels.subtracted),
        ]
        wiring.connect(m, pixels.o, isolate.i)
        wiring.connect(m, isolate.o, lookahead.i)
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
        column = lookahead.o.p
        m.d.comb += [
            choose.valid.eq(runs.valid),
            choose.image_first.eq(lookahead.o.valid & column.row_first & (column.row == 0)),
            choose.clear.eq(peak.taken),
            runs.place.eq(choose.place),
            window.pixel.p.eq(isolate.o.p),
            window.pixel.valid.eq(isolate.o.valid),
            window.compare.eq(runs.valid),
            window.centre.eq(runs.o.centre),
            window.peak.eq(runs.o.peak),
            window.take.eq(choose.take),
            window.start.eq(peak.taken),
            window.row.eq(spread.o.p.row),
            window.last_column.eq(spread.o.p.last_column),
            peak.end.eq(_strobe_delayed(m, spread.o.valid, Runs.latency + Choose.latency - Spread.latency, "row_end")),
            peak.found.eq(choose.found),
            peak.other_found.eq(choose.other_found),
            peak.gated.eq(spread.o.p),
        ]
        wiring.connect(m, choose.chosen, peak.chosen)
        wiring.connect(m, choose.other, peak.other)
        for name in ("position", "some", "whole"):
            m.d.comb += getattr(peak, f"window_{name}").eq(getattr(window, name))

        # Settings that change while a row is being measured make its record worthless: with the first pixel of an
        # image, while a row of the one before is held or has gone out so lately that its record is not written.
        after_isolate = self.latency - Monitor.latency - Pixels.latency - Isolate.latency
        measuring = _within(m, after_isolate, isolate.o.valid & isolate.o.p.row_last, "measuring")
        begins, disturbed = Signal(), Signal()
        m.d.comb += begins.eq(monitor.pixel.valid & monitor.pixel.p.frame_first)
        with m.If(monitor.frame_gap | (begins & (isolate.holding | measuring))):
            m.d.sync += disturbed.eq(1)
        with m.Elif(peak.o.valid & ~isolate.holding & ~measuring):
            m.d.sync += disturbed.eq(0)
        m.d.comb += [
            self.rows.row.valid.eq(peak.o.valid),
            self.rows.row.p.eq(peak.o.p),
            self.rows.row.p.record.overflow.eq(peak.o.p.record.overflow | disturbed),
            isolate.i_frame_end.eq(_strobe_delayed(m, monitor.frame_end, Pixels.latency, "frame_end_in")),
            self.rows.frame_end.eq(
                _strobe_delayed(m, isolate.o_frame_end, after_isolate + FRAME_END_DELAY, "frame_end_out")
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


def _within(m: Module, clocks: int, event, name: str):
    """Fewer than ``clocks`` clocks have passed since the last ``event``, which itself does not count."""
    left = Signal(range(clocks), name=f"{name}_left")
    with m.If(event):
        m.d.sync += left.eq(clocks - 1)
    with m.Elif(left != 0):
        m.d.sync += left.eq(left - 1)
    return left != 0
