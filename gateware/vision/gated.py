"""Pixels in, the mean column of the gated ones of each row out: what the paper measures, and a small card."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak.reference import measure
from magtrak.reference.fir import FRACTION

from ..arithmetic import SerialDivider, delayed
from ..camera.monitor import MIN_BLANKING, Monitor
from ..features import Features
from ..layouts import CameraErrors, FrameSettings, LutWrite, Rows, Video
from .block_gate import BlockGate

FRACTION_BITS = (FRACTION - 1).bit_length()


class GatedVision(wiring.Component):
    """Measures the gated pixels of every row, as :func:`magtrak.reference.measure` does where nothing is lit.

    It stands in the place of :class:`~gateware.vision.vision.Vision` where ``features.runs`` is not built: ``detector``
    is taken for ``BINARY`` and ``floor`` for 255, which no mix exceeds, so that there are no runs. Without them a row
    has its position, ``width`` and ``gated`` of the gated pixels, and the flags ``cut`` and ``ambiguous``; all else is
    0. Weights, the settings of the runs but for ``run_gated`` and ``run_width_max``, ``choice`` and ``ambiguous_ratio``
    make no difference then.

    One pixel a clock; it never stalls. A row's record comes :attr:`latency` clocks after its last pixel. Images that
    break the camera's contract are mended by :class:`~gateware.camera.monitor.Monitor`; such rows have ``overflow``
    set, the frame its ``errors``. A row that ends while the one before is divided is not measured: its record comes
    after that one's, and has only ``overflow``.

    Parameters
    ----------
    features : ``max_columns`` and ``max_rows`` count

    Members
    -------
    video : images
    settings : in force; they may change in the clock after the first pixel of a frame was taken
    lut : writes to the gate's tables, as :class:`~gateware.vision.block_gate.BlockGate` takes them; ``swap`` comes with
        the first pixel of a frame
    rows : results; ``frame_end`` comes at least one clock after the last row's
    errors, image_columns : of the frame that ended, valid at ``rows.frame_end``
    image_rows : as well
    errors_ever : errors of all frames since reset, as they occur
    """

    def __init__(self, features: Features) -> None:
        self.features = features
        self._column_bits = features.max_columns.bit_length()
        self._monitor = Monitor(features.max_columns, features.compact_rows)
        self._divider = SerialDivider(self._column_bits, (features.max_columns - 1).bit_length() + FRACTION_BITS)
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
            }
        )

    reference = staticmethod(measure)

    @property
    def latency(self) -> int:
        """Clocks from the last pixel of a row to its record; the contract of the camera kept."""
        return self._monitor.latency + BlockGate.latency + 1 + self._divider.latency + 1

    def elaborate(self, platform):
        m = Module()
        features, settings = self.features, self.settings
        m.submodules.monitor = monitor = self._monitor
        m.submodules.gate = gate = BlockGate()
        m.submodules.divider = divider = self._divider
        wiring.connect(m, monitor.video, wiring.flipped(self.video))
        wiring.connect(m, gate.lut, wiring.flipped(self.lut))
        m.d.comb += [getattr(gate, name).eq(monitor.pixel.p[name]) for name in "rgb"]

        # Flags go along with the colour; `sooner` are those of the clock before.
        names = ("row_first", "row_last", "frame_first", "fault")
        flags = Cat(monitor.pixel.valid, *(monitor.pixel.p[name] for name in names))
        sooner = delayed(m, flags, BlockGate.latency - 1, "flags")
        valid, row_first, row_last, _, fault = delayed(m, sooner, 1, "flags_held")

        # Place, and whether it is within the region. A column is past the first or the last one of the region for the
        # rest of the row; whether it is either is told anyway.
        column = Signal(self._column_bits)
        row = Signal(12)
        with m.If(valid):
            m.d.sync += column.eq(Mux(row_last, 0, column + 1))
        with m.If(sooner[0] & sooner[1]):
            m.d.sync += row.eq(Mux(sooner[3], 0, row + 1))
        at_first = Signal()
        at_last = Signal()
        begun = Signal()
        past = Signal()
        m.d.comb += [at_first.eq(column == settings.column_first), at_last.eq(column == settings.column_last)]
        with m.If(valid):
            m.d.sync += [begun.eq((begun | at_first) & ~row_last), past.eq((past | at_last) & ~row_last)]
        gated = Signal()
        m.d.comb += gated.eq(
            valid & gate.o & ((begun | at_first) & ~past) & (row >= settings.row_first) & (row <= settings.row_last)
        )

        # Add up. A clock after its last pixel the row is taken and all begins anew: no row follows so soon.
        total, width, since = (Signal(self._column_bits, name=name) for name in ("total", "width", "since"))
        columns = Signal((features.max_columns * (features.max_columns - 1) // 2).bit_length())
        longer = Signal(self._column_bits)
        some = Signal()
        faulty = Signal()
        end = Signal()
        left = Signal()  # the first gated pixel is at the border
        left_now = Signal()
        cut = Signal()  # it or the last one is
        m.d.comb += [longer.eq(since + 1), left_now.eq(Mux(some, left, row_first | at_first))]
        m.d.sync += end.eq(valid & row_last)
        with m.If(end):
            m.d.sync += [one.eq(0) for one in (total, since, columns, some, faulty)]
        with m.If(valid):
            m.d.sync += faulty.eq(faulty | fault)
            with m.If(some | gated):
                m.d.sync += since.eq(longer)
        with m.If(gated):
            m.d.sync += [
                some.eq(1),
                total.eq(total + 1),
                columns.eq(columns + column),
                width.eq(longer),
                left.eq(left_now),
                cut.eq(left_now | row_last | at_last),
            ]

        # Divide. Of a row that ends meanwhile only the number is told, which is still the present one then.
        result, record = self.rows.row.p, self.rows.row.p.record
        busy = Signal()
        late = Signal()
        enough = Signal()
        broken = Signal()
        disturbed = Signal()  # settings have changed before the record was there
        told = Signal()
        lost = Signal()
        m.d.comb += [
            divider.start.eq(end & ~busy),
            divider.dividend.eq(columns << FRACTION_BITS),
            divider.divisor.eq(total),
            lost.eq(late & ~busy),
            told.eq(divider.done | lost),
        ]
        with m.If(divider.start):
            m.d.sync += [
                busy.eq(1),
                result.row.eq(row),
                record.width.eq(width),
                record.gated.eq(total),
                record.cut.eq(cut),
                record.ambiguous.eq(width > settings.run_width_max),
                enough.eq(some & (total >= settings.run_gated)),
                broken.eq(faulty),
            ]
        with m.Elif(end):
            m.d.sync += late.eq(1)
        with m.If(divider.done):
            m.d.sync += [
                busy.eq(0),
                record.valid.eq(enough),
                record.position.eq(divider.quotient[1:] + divider.quotient[0]),  # rounded half up
            ]
        with m.If(lost):
            m.d.sync += [late.eq(0), result.row.eq(row)]
        with m.If(lost | (divider.done & ~enough)):
            m.d.sync += [record[name].eq(0) for name in ("valid", "position", "width", "gated", "cut", "ambiguous")]
        with m.If(told):
            m.d.sync += record.overflow.eq(broken | disturbed | lost)
        m.d.sync += self.rows.row.valid.eq(told)
        with m.If(monitor.frame_gap):
            m.d.sync += disturbed.eq(1)
        with m.Elif(told):
            m.d.sync += disturbed.eq(0)

        # The end of an image follows its last record, and comes before the next one's first: an image that the next one
        # ends had its last pixel MIN_BLANKING clocks sooner. Two may end in a row where both break the contract.
        wait = Signal(range(self.latency + 2))
        again = Signal()
        cut_off = monitor.pixel.valid & monitor.pixel.p.frame_first
        with m.If(wait != 0):
            m.d.sync += wait.eq(wait - 1)
        with m.If(monitor.frame_end & (wait > 1)):
            m.d.sync += again.eq(1)
        with m.Elif((monitor.frame_end | again) & (wait <= 1)):
            m.d.sync += [wait.eq(Mux(cut_off, self.latency - MIN_BLANKING // 2, self.latency + 1)), again.eq(0)]
        m.d.comb += [
            self.rows.frame_end.eq(wait == 1),
            self.errors.eq(monitor.errors),
            self.image_rows.eq(monitor.rows),
            self.image_columns.eq(monitor.columns),
            self.errors_ever.eq(monitor.errors_ever),
        ]
        return m
