"""What the monitor lets through keeps its contract, whatever comes in, for ever."""

from amaranth.hdl import Assert, Cover, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from gateware.camera.monitor import MIN_BLANKING, MIN_ROW_PERIOD, Monitor
from tests.support.formal import Opened, prove


class KeepsTheContract(wiring.Component):
    """Every input may change in every clock: pixels, flags, ends of frames in any order.

    Rows begin and end, are no longer than allowed and far enough apart; frames begin, end, and have no more rows than
    allowed.
    """

    valid: In(1)
    row_first: In(1)
    row_last: In(1)
    frame_first: In(1)
    frame_end: In(1)

    def __init__(self, max_columns: int, max_rows: int) -> None:
        self.max_columns = max_columns
        self.max_rows = max_rows
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        dut = Monitor(self.max_columns, self.max_rows)
        m.submodules.dut = inner = Opened(dut)
        m.d.comb += [dut.video.pixel.valid.eq(self.valid), dut.video.frame_end.eq(self.frame_end)]
        for name in ("row_first", "row_last", "frame_first"):
            m.d.comb += dut.video.pixel.p[name].eq(getattr(self, name))
        o, valid = dut.pixel.p, dut.pixel.valid

        # What went out so far, and (`then_`) with what goes out now.
        in_row, then_in_row = Signal(), Signal()
        length, then_length = Signal(13), Signal(13)
        is_open, then_open = Signal(), Signal()  # a frame has begun and not ended
        rows, then_rows = Signal(13), Signal(13)
        # An end that comes with a frame's first pixel is that of the frame before, unless the camera said it is over.
        whole = Signal()
        m.d.sync += whole.eq(self.frame_end & ~(self.valid & self.row_first & self.frame_first))
        m.d.comb += [
            then_in_row.eq(Mux(valid, ~o.row_last, in_row)),
            then_length.eq(Mux(valid, Mux(o.row_first, 1, length + 1), length)),
            then_open.eq((valid & o.frame_first & ~(dut.frame_end & whole)) | (is_open & ~dut.frame_end)),
            then_rows.eq(Mux(valid & o.row_first, Mux(o.frame_first, 1, rows + 1), rows)),
        ]
        m.d.sync += [in_row.eq(then_in_row), length.eq(then_length), is_open.eq(then_open), rows.eq(then_rows)]
        # Clocks since the last row_last, and since the one before that.
        since, then_since = _age(m, valid & o.row_last, "since")
        earlier, then_earlier = Signal.like(since, init=MIN_ROW_PERIOD), Signal.like(since)
        m.d.comb += then_earlier.eq(_older(Mux(valid & o.row_last, since, earlier)))
        m.d.sync += earlier.eq(then_earlier)

        with m.If(valid):
            m.d.comb += [
                Assert(o.row_first == ~in_row),
                Assert(then_length <= self.max_columns),
                Assert(~o.frame_first | o.row_first),
                Assert(then_rows <= self.max_rows),
                # A row belongs to a frame, and a frame has ended when the next one begins.
                Assert(~o.row_first | o.frame_first | is_open),
                Assert(~o.frame_first | ~is_open | dut.frame_end),
            ]
            with m.If(o.row_first):
                m.d.comb += [Assert(since >= MIN_BLANKING), Assert(earlier >= MIN_ROW_PERIOD)]
        with m.If(dut.frame_end):
            m.d.comb += Assert(~Mux(valid & o.frame_first, in_row, then_in_row))
        self._inductive(m, inner, dut, then_in_row, then_length, then_open, then_rows, then_since, then_earlier)
        return m

    def _inductive(self, m, inner, dut, in_row, length, is_open, rows, since, earlier):
        """What the monitor's own registers hold, in terms of what went out."""
        # Clocks since the camera's last row began, and the row before it.
        camera_row = Signal()
        m.d.comb += camera_row.eq(self.valid & self.row_first & (self.frame_first | inner["in_frame"]))
        begun, _ = _age(m, camera_row, "begun")
        before = Signal.like(begun, init=MIN_ROW_PERIOD)
        m.d.sync += before.eq(_older(Mux(camera_row, begun, before)))
        sending, late = inner["sending"], inner["late"]
        m.d.comb += [
            Assert(sending == in_row),
            Assert(~sending | (inner["columns_out"] == length)),
            Assert(~sending | (length < self.max_columns)),
            Assert(~sending | (inner["nearly"] == (length == self.max_columns - 1))),
            Assert(~inner["in_row"] | inner["in_frame"]),
            Assert(~sending | (inner["in_frame"] & ~inner["fresh"])),
            Assert(~(sending & late)),
            Assert(is_open == (inner["in_frame"] & ~inner["fresh"])),
            Assert(~is_open | (inner["row_count"] == rows)),
            Assert(~inner["in_frame"] | is_open | (inner["row_count"] == 0)),
            Assert(inner["row_count"] <= self.max_rows),
            Assert((inner["row_count"] != self.max_rows) | inner["reached"] | sending | (since < MIN_BLANKING)),
            Assert((inner["row_count"] != self.max_rows) | ~inner["room"] | sending | (since < MIN_BLANKING)),
            Assert(~inner["room"] | inner["in_frame"]),
            Assert(~sending | (since >= MIN_BLANKING)),
            Assert(inner["blocked"] == (sending | (since < MIN_BLANKING))),
            Assert(inner["flush_left"] == Mux((since > 1) & (since < MIN_BLANKING), MIN_BLANKING - since, 0)),
            Assert(dut.pixel.p.row_last == (since == 1)),
            Assert(inner["in_period"] == (begun < MIN_ROW_PERIOD)),
            Assert(inner["period_left"] == MIN_ROW_PERIOD - begun),
            Assert(~late | (inner["waits"] == (before < MIN_ROW_PERIOD))),
            Assert(~(late & inner["waits"]) | (inner["wait_left"] == MIN_ROW_PERIOD - before)),
            # A camera's row begins at the earliest where the row that goes out before it ends.
            Assert(~sending | (begun <= since)),
            Assert(sending | (begun <= earlier)),
            Assert(sending | ~late | ((begun <= since) & (before <= earlier))),
        ]


class SeesRows(KeepsTheContract):
    """The contract is not kept by letting nothing through."""

    def _inductive(self, m, inner, dut, in_row, length, is_open, rows, since, earlier):
        m.d.comb += Cover(dut.frame_end & (rows == 1) & dut.pixel.valid & dut.pixel.p.row_last & (length == 3))


def _age(m: Module, event, name: str):
    """Clocks since an event, at most ``MIN_ROW_PERIOD``: as a register, and with what happens now."""
    age = Signal(range(MIN_ROW_PERIOD + 1), init=MIN_ROW_PERIOD, name=name)
    now = Signal.like(age, name=f"then_{name}")
    m.d.comb += now.eq(Mux(event, 1, _older(age)))
    m.d.sync += age.eq(now)
    return age, now


def _older(age):
    return Mux(age >= MIN_ROW_PERIOD, MIN_ROW_PERIOD, age + 1)


def test_whatever_comes_in_what_goes_out_keeps_the_contract():
    prove(KeepsTheContract(16, 3), "prove", 3)
    prove(KeepsTheContract(2048, 2048), "prove", 3)


def test_images_do_pass():
    prove(SeesRows(16, 3), "cover", 8)
