"""Pixels in, one measured row after another out."""

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.reference import measure

from ..camera.monitor import CheckedPixel, Monitor
from ..features import EVERYTHING, Features
from ..layouts import CameraErrors, FrameSettings, LutWrite, Rows, Video
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
the one before has its record after that one's."""


class Vision(wiring.Component):
    """Measures the laser line in every row of every image, as :func:`magtrak.reference.measure` defines it.

    One pixel a clock; it never stalls. A row's record comes :attr:`latency` clocks after its last pixel, and with the
    isolated-pixel filter after the last pixel of the next row, or as if one followed the image in its blank row. Every
    row gives one record, whether a line was found or not. What happens to images that break the camera's contract is
    told by :class:`~gateware.camera.monitor.Monitor`; such rows have ``overflow`` set, the frame its ``errors``.

    Parameters
    ----------
    features : what is built. Without ``isolate``, ``window`` or ``background_cells`` the settings ``isolate``,
        ``centroid_window`` and ``ambient_mode`` are taken for 0: all gated pixels stay, a centroid is that of the run,
        nothing is subtracted.

    Members
    -------
    video : images
    background : the present image is a background; from before its first pixel until its end
    subtracted : the background is subtracted from the present image; from 5 clocks after its first pixel on
    settings : in force; they may change in the clock after the first pixel of a frame was taken
    lut : writes to the gate's tables, and the swap, at that same time, which comes with all new settings
    rows : results; ``frame_end`` comes at least one clock after the last row's
    errors, image_rows, image_columns : of the frame that ended, valid at ``rows.frame_end``
    errors_ever : errors of all frames since reset, as they occur
    raw, measured : what snapshots show: pixels of well-formed images before and after the point-wise stages

    """

    def __init__(self, features: Features = EVERYTHING) -> None:
        self.features = features
        self._monitor = Monitor(features.max_columns, features.compact_rows, fast=True)
        self._window = Window(features.max_columns)
        self._peak = Peak(features.max_columns, self._window.latency if features.window else 0)
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
        return self._monitor.latency + Pixels.latency + self._isolate_latency + self._measuring_latency

    @property
    def _isolate_latency(self) -> int:
        return Isolate.latency if self.features.isolate else 0

    @property
    def _measuring_latency(self) -> int:
        """Clocks from the last pixel of a row, as it comes to be measured, to its record."""
        return Lookahead.latency + Runs.latency + Choose.latency + self._peak.latency

    def elaborate(self, platform):
        m = Module()
        features = self.features
        m.submodules.monitor = monitor = self._monitor
        m.submodules.pixels = pixels = Pixels(features.background_cells)
        m.submodules.lookahead = lookahead = Lookahead()
        m.submodules.fir = fir = Fir()
        m.submodules.runs = runs = Runs()
        m.submodules.choose = choose = Choose(window=features.window)
        m.submodules.spread = spread = Spread()
        m.submodules.peak = peak = self._peak

        for block in (pixels, lookahead, runs, choose, spread, peak):
            m.d.comb += block.settings.eq(self.settings)
        wiring.connect(m, monitor.video, wiring.flipped(self.video))
        wiring.connect(m, pixels.lut, wiring.flipped(self.lut))
        wiring.connect(m, monitor.pixel, pixels.i)
        m.d.sync += pixels.faulty.eq(monitor.errors.as_value().any())
        m.d.comb += [
            pixels.image_end.eq(monitor.frame_end),
            pixels.image_rows.eq(monitor.rows),
            pixels.image_columns.eq(monitor.columns),
            pixels.background.eq(self.background),
            self.subtracted.eq(pixels.subtracted),
        ]
        frame_end_in = _strobe_delayed(m, monitor.frame_end, Pixels.latency, "frame_end_in")
        pixel, coming = pixels.o, pixels.ahead.valid
        holding = Signal()
        frame_end = frame_end_in
        if features.isolate:
            m.submodules.isolate = isolate = Isolate(features.max_columns)
            wiring.connect(m, pixels.o, isolate.i)
            wiring.connect(m, pixels.ahead, isolate.ahead)
            m.d.comb += [isolate.settings.eq(self.settings), isolate.i_frame_end.eq(frame_end_in)]
            m.d.comb += holding.eq(isolate.holding)
            pixel, coming, frame_end = isolate.o, isolate.coming, isolate.o_frame_end
        wiring.connect(m, pixel, lookahead.i)
        m.d.comb += lookahead.coming.eq(coming)
        wiring.connect(m, lookahead.o, spread.column)
        m.d.comb += [
            runs.column.p.eq(lookahead.o.p),
            runs.column.valid.eq(lookahead.o.valid),
            runs.before.eq(lookahead.before),
            runs.left_edge.eq(lookahead.left_edge),
            runs.right_edge.eq(lookahead.right_edge),
            runs.near_last.eq(lookahead.near_last),
            spread.before.eq(lookahead.before),
            spread.left_edge.eq(lookahead.left_edge),
            spread.right_edge.eq(lookahead.right_edge),
            fir.step.eq(lookahead.step),
            fir.mix.eq(lookahead.mix),
            fir.row_first.eq(lookahead.row_first),
        ]
        connect_fir(m, fir, runs)
        wiring.connect(m, runs.o, choose.run)
        column = lookahead.o.p
        row_ends = _line(m, spread.o.valid, Runs.latency + Choose.latency - Spread.latency, "row_end")
        m.d.comb += [
            choose.valid.eq(runs.valid),
            choose.image_first.eq(lookahead.o.valid & column.row_first & (column.row == 0)),
            choose.clears.eq(row_ends[-2]),
            runs.place.eq(choose.place),
            peak.ends.eq(row_ends[-2]),
            peak.found.eq(choose.found),
            peak.numerator.eq(choose.numerator),
            peak.divisor.eq(choose.divisor),
            peak.other_found.eq(choose.other_found),
            peak.gated.eq(spread.o.p),
        ]
        wiring.connect(m, choose.chosen, peak.chosen)
        wiring.connect(m, choose.other, peak.other)
        if features.window:
            m.submodules.window = window = self._window
            m.d.comb += [
                window.settings.eq(self.settings),
                window.pixel.p.eq(pixel.p),
                window.pixel.valid.eq(pixel.valid),
                window.compare.eq(runs.valid),
                window.centre.eq(runs.o.centre),
                window.peak.eq(runs.o.peak),
                window.take.eq(choose.take),
                window.start.eq(peak.taken),
                window.row.eq(spread.o.p.row),
                window.last_column.eq(spread.o.p.last_column),
            ]
            for name in ("position", "some", "whole"):
                m.d.comb += getattr(peak, f"window_{name}").eq(getattr(window, name))

        # Settings that change while a row is being measured make its record worthless: with the first pixel of an
        # image, while a row of the one before is held or has gone out so lately that its record is not written.
        measuring = _within(m, self._measuring_latency, pixel.valid & pixel.p.row_last, "measuring")
        begins = Signal()
        disturbed = Signal()
        m.d.comb += begins.eq(monitor.pixel.valid & monitor.pixel.p.frame_first)
        with m.If(monitor.frame_gap | (begins & (holding | measuring))):
            m.d.sync += disturbed.eq(1)
        with m.Elif(peak.o.valid & ~holding & ~measuring):
            m.d.sync += disturbed.eq(0)
        m.d.comb += [
            self.rows.row.valid.eq(peak.o.valid),
            self.rows.row.p.eq(peak.o.p),
            self.rows.row.p.record.overflow.eq(peak.o.p.record.overflow | disturbed),
            self.rows.frame_end.eq(
                _strobe_delayed(m, frame_end, self._measuring_latency + FRAME_END_DELAY, "frame_end_out")
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


def _line(m: Module, strobe, clocks: int, name: str):
    line = Signal(clocks, name=f"{name}_line")
    m.d.sync += line.eq((line << 1) | strobe)
    return line


def _strobe_delayed(m: Module, strobe, clocks: int, name: str):
    return _line(m, strobe, clocks, name)[-1]


def _within(m: Module, clocks: int, event, name: str):
    """Fewer than ``clocks`` clocks have passed since the last ``event``, which itself does not count."""
    left = Signal(range(clocks), name=f"{name}_left")
    within = Signal(name=f"{name}_within")  # left != 0, ahead of time
    with m.If(event):
        m.d.sync += [left.eq(clocks - 1), within.eq(1)]
    with m.Elif(within):
        m.d.sync += [left.eq(left - 1), within.eq(left != 1)]
    return within
