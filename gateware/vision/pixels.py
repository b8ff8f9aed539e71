"""What is measured of each pixel on its own: gate, weight and place."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ..arithmetic import delayed
from ..camera.monitor import CheckedPixel
from ..features import DEFAULT_CELLS
from ..layouts import FrameSettings, LutWrite
from .background import Background
from .gate import Gate
from .hls import HLS
from .weight import Weight


class MeasuredPixel(data.Struct):
    """A pixel after the point-wise stages. Outside the region of interest ``weight`` and ``gate`` are 0."""

    mix: 8
    weight: 8
    gate: 1
    saturated: 1
    row_first: 1
    row_last: 1
    frame_first: 1
    fault: 1


class Region(wiring.Component):
    """Whether a pixel is in the region of interest. Counts rows and columns by the flags of the pixels.

    Members
    -------
    settings : ``column_first`` to ``column_last`` and ``row_first`` to ``row_last``, ends included, are used
    valid, row_first, frame_first : of the pixel
    column, row : place of the pixel of a clock ago
    inside : of the pixel of :attr:`latency` clocks ago
    """

    settings: In(FrameSettings)
    valid: In(1)
    row_first: In(1)
    frame_first: In(1)
    column: Out(12)
    row: Out(12)
    inside: Out(1)

    latency = 3
    """Count, compare, join. It starts with the bound that is equal and stops after the other, as is enough where rows
    and columns come in order."""

    def elaborate(self, platform):
        m = Module()
        column, row = self.column, self.row
        row_begins = Signal()
        frame_begins = Signal()
        m.d.comb += [row_begins.eq(self.valid & self.row_first), frame_begins.eq(row_begins & self.frame_first)]
        # (A reset that does not wait for a clock enable costs nothing.)
        with m.If(row_begins):
            m.d.sync += column.eq(0)
        with m.Elif(self.valid):
            m.d.sync += column.eq(column + 1)
        with m.If(frame_begins):
            m.d.sync += row.eq(0)
        with m.Elif(row_begins):
            m.d.sync += row.eq(row + 1)
        valid, row_first, frame_first = self.valid, self.row_first, self.frame_first
        for clock in range(2):
            held = [Signal(name=f"{name}_{clock + 1}") for name in ("valid", "row_first", "frame_first")]
            m.d.sync += [
                register.eq(value) for register, value in zip(held, (valid, row_first, frame_first), strict=True)
            ]
            valid, row_first, frame_first = held
        in_columns = self._span(m, column, "column", valid, row_first)
        in_rows = self._span(m, row, "row", valid & row_first, frame_first)
        rows_hold = Signal()
        with m.If(valid):
            with m.If(row_first):
                m.d.sync += rows_hold.eq(in_rows)
            m.d.sync += self.inside.eq(in_columns & Mux(row_first, in_rows, rows_hold))
        return m

    def _span(self, m: Module, place, name: str, step, begins):
        """Whether the place of a clock ago, which counts with ``step`` and starts anew with ``begins``, is within the
        bounds of its ``name``.
        """
        at_first, at_last = Signal(name=f"{name}_at_first"), Signal(name=f"{name}_at_last")
        started, passed = Signal(name=f"{name}_started"), Signal(name=f"{name}_passed")
        starts, goes = Signal(name=f"{name}_starts"), Signal(name=f"{name}_goes")
        m.d.sync += [
            at_first.eq(place == self.settings[f"{name}_first"]),
            at_last.eq(place == self.settings[f"{name}_last"]),
        ]
        m.d.comb += [starts.eq((started & ~begins) | at_first), goes.eq(passed & ~begins)]
        with m.If(step):
            m.d.sync += [started.eq(starts), passed.eq(goes | at_last)]
        return starts & ~goes


class Pixels(wiring.Component):
    """The stages that know one pixel at a time, latency-matched into one stream.

    While a background is subtracted, only what is left above the floor is gated: the colour of things that the laser
    does not light tells nothing.

    Parameters
    ----------
    background_cells : see :class:`~gateware.vision.background.Background`; 0: there is none, nothing is subtracted

    Members
    -------
    settings : the weight's mix and floor, the region, and whether a background is subtracted
    lut : writes to the gate's tables; ``swap`` comes with new settings
    i : stream of :class:`~gateware.camera.monitor.CheckedPixel`, always ready
    image_end, faulty, image_rows, image_columns : of the image, as :class:`~gateware.camera.monitor.Monitor` has them
    background : the image is a background
    subtracted : the background is subtracted from the image
    o : stream of :class:`MeasuredPixel`, always ready, :attr:`latency` clocks later
    ahead : ``o`` as it will be in the next clock; of this only ``valid`` and the flags of row and image
    """

    def __init__(self, background_cells: int = DEFAULT_CELLS) -> None:
        self.background_cells = background_cells
        super().__init__(
            {
                "settings": In(FrameSettings),
                "lut": In(LutWrite()),
                "i": In(stream.Signature(CheckedPixel, always_ready=True)),
                "image_end": In(1),
                "faulty": In(1),
                "image_rows": In(12),
                "image_columns": In(12),
                "background": In(1),
                "subtracted": Out(1),
                "o": Out(stream.Signature(MeasuredPixel, always_ready=True)),
                "ahead": Out(stream.Signature(MeasuredPixel, always_ready=True)),
            }
        )

    latency = HLS.latency + Gate.latency
    """Clocks from ``i`` to ``o``: the colour path is the longest."""

    def elaborate(self, platform):
        m = Module()
        m.submodules.hls = hls = HLS()
        m.submodules.gate = gate = Gate()
        m.submodules.weight = weight = Weight()
        m.submodules.region = region = Region()
        wiring.connect(m, gate.lut, wiring.flipped(self.lut))
        i, o = self.i.p, self.o.p
        m.d.comb += [
            hls.r.eq(i.r),
            hls.g.eq(i.g),
            hls.b.eq(i.b),
            gate.i.eq(hls.o),
            weight.settings.eq(self.settings),
            weight.r.eq(i.r),
            weight.g.eq(i.g),
            weight.b.eq(i.b),
            region.settings.eq(self.settings),
            region.valid.eq(self.i.valid),
            region.row_first.eq(i.row_first),
            region.frame_first.eq(i.frame_first),
        ]
        if self.background_cells:
            m.submodules.background = background = Background(self.background_cells)
            m.d.comb += [
                background.settings.eq(self.settings),
                background.settings_change.eq(self.lut.swap),
                background.valid.eq(self.i.valid),
                background.row_first.eq(i.row_first),
                background.frame_first.eq(i.frame_first),
                background.column.eq(region.column),
                background.row.eq(region.row),
                background.mix.eq(weight.raw),
                background.take.eq(self.background),
                weight.background.eq(background.value),
                self.subtracted.eq(background.subtracting),
            ]
            for name in ("image_end", "faulty", "image_rows", "image_columns"):
                m.d.comb += getattr(background, name).eq(getattr(self, name))
        clocks = self.latency - 1
        inside = delayed(m, region.inside, clocks - region.latency, "inside")
        brightness = [
            delayed(m, getattr(weight, name), clocks - weight.latency, name) for name in ("mix", "weight", "saturated")
        ]
        # Whether it may be gated, before its colour is known.
        early = clocks - 1
        inside_early = delayed(m, region.inside, early - region.latency, "inside_early")
        weight_early = delayed(m, weight.weight, early - weight.latency, "weight_early")
        m.d.sync += [
            gate.may.eq(inside_early & (~self.subtracted | weight_early.any())),
            o.mix.eq(brightness[0]),
            o.weight.eq(Mux(inside, brightness[1], 0)),
            o.saturated.eq(brightness[2]),
        ]
        m.d.comb += o.gate.eq(gate.o)
        for name in ("row_first", "row_last", "frame_first", "fault"):
            m.d.comb += self.ahead.p[name].eq(delayed(m, i[name], clocks, name))
            m.d.sync += o[name].eq(self.ahead.p[name])
        valid = self.i.valid
        for clock in range(clocks):  # with a reset, unlike the data
            register = Signal(name=f"valid_{clock + 1}")
            m.d.sync += register.eq(valid)
            valid = register
        m.d.comb += self.ahead.valid.eq(valid)
        m.d.sync += self.o.valid.eq(valid)
        return m
