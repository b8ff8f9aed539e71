"""Watches the camera, and lets only well-formed images into the card."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ..layouts import CameraErrors, Video

MIN_BLANKING = 16
MIN_ROW_PERIOD = 48
MIN_FRAME_GAP = 64


class CheckedPixel(data.Struct):
    """A pixel of an image that keeps the contract, whatever the camera did; black where it had to be made up.

    ``fault``: the row broke the contract here, or a row before it in the frame is missing.
    """

    r: 8
    g: 8
    b: 8
    row_first: 1
    row_last: 1
    frame_first: 1
    fault: 1


class Monitor(wiring.Component):
    """Checks the contract of :class:`~gateware.layouts.Video`, and mends what breaks it.

    Whatever comes in, what goes out has this form, so that no other block has to think of the rest:

    - a row begins with ``row_first``, ends with ``row_last`` and has at most ``max_columns`` pixels;
    - :data:`MIN_BLANKING` clocks lie between ``row_last`` and ``row_first``, and :data:`MIN_ROW_PERIOD`
      between one ``row_last`` and the one after the next;
    - a frame has at most ``max_rows`` rows; the first has ``frame_first``, and ``frame_end`` comes with or
      after the last pixel, or at the latest with the first of the next frame.

    How it mends, each time setting the error and ``fault`` on the rows that suffer:

    - a row that starts too early loses its first pixels (its columns then count from the first that is left); a
      row that is over by then is lost, is not counted, and every later row of the frame has ``fault``;
    - a row that did not end, when the next row, the next frame or the frame's end comes, is ended by a black pixel
      (which costs the next row its first pixels) or by the pixel that comes with the frame's end;
    - pixels and rows above the limits are left out; the limit's last pixel has ``row_last``;
    - pixels between rows, and rows between frames, are left out;
    - a frame that did not end when the next one starts is ended.

    Until the first ``frame_first`` after reset everything is ignored: a card may be switched on in the middle of an
    image.

    Parameters
    ----------
    max_columns : 16 to 2048
    max_rows : 1 to 2048
    fast : a stage of registers before it and one before the errors, for a clock above 100 MHz

    Members
    -------
    video : from the camera
    pixel : stream of :class:`CheckedPixel`, always ready
    frame_end : strobe, see above
    frame_gap : strobe, with the first pixel of a frame that came too early: settings may have changed while the
        frame before was still being measured
    errors : of the last frame that ended, from 1 clock after ``frame_end`` (2 if ``fast``) until the next
    rows, columns : of that frame, from 1 clock after ``frame_end`` on; rows counts those that went out, columns is the
        length of the first of them
    errors_ever : every error since reset

    Raises
    ------
    ValueError
        A limit is out of range.
    """

    def __init__(self, max_columns: int = 2048, max_rows: int = 2048, *, fast: bool = False) -> None:
        if not 16 <= max_columns <= 2048:
            raise ValueError(f"max_columns is {max_columns}; 16 to 2048 are possible")
        if not 1 <= max_rows <= 2048:
            raise ValueError(f"max_rows is {max_rows}; 1 to 2048 are possible")
        self.max_columns = max_columns
        self.max_rows = max_rows
        self.fast = fast
        super().__init__(
            {
                "video": In(Video()),
                "pixel": Out(stream.Signature(CheckedPixel, always_ready=True)),
                "frame_end": Out(1),
                "frame_gap": Out(1),
                "errors": Out(CameraErrors),
                "rows": Out(12),
                "columns": Out(12),
                "errors_ever": Out(CameraErrors),
            }
        )

    @property
    def latency(self) -> int:
        """Clocks from ``video`` to ``pixel``."""
        return 2 if self.fast else 1

    def elaborate(self, platform):
        m = Module()
        held = self._register if self.fast else self._wire
        video, came = self.video.pixel.p, self.video.pixel.valid
        i = held(m, video, "pixel")
        valid = held(m, came, "valid")
        frame_end = held(m, self.video.frame_end, "frame_end")
        first = held(m, came & video.row_first, "first")
        begin = held(m, came & video.row_first & video.frame_first, "begin")
        follows = held(m, came & ~video.row_first, "follows")
        # A row that is going out is cut off, moves on, or ends, whatever is left of it.
        cuts = held(m, (came & video.row_first) | (self.video.frame_end & ~came), "cuts")
        moves = held(m, came | self.video.frame_end, "moves")
        stops = held(m, video.row_last | self.video.frame_end, "stops")
        in_frame = Signal()
        seen = Signal()  # a frame has begun since reset
        in_row = Signal()  # the camera is within a row
        sending = Signal()  # a row is going out
        late = Signal()  # the camera's row has not gone out yet: it came too early
        lost = Signal()  # a row of this frame is missing
        fresh = Signal()  # no row of this frame has gone out
        row_count = Signal(12)
        columns = Signal(12, name="columns_out")

        end = Signal()  # the frame ends, by itself or because the next one begins
        m.d.comb += end.eq(in_frame & (frame_end | begin))
        opens = Signal()
        belongs = Signal()
        m.d.comb += [opens.eq(begin | (first & in_frame)), belongs.eq(opens | (follows & in_row))]

        close_frame = self._within(m, MIN_FRAME_GAP, valid & seen, "gap")

        # What goes out.
        o = self.pixel.p
        out_valid = Signal()
        out_last = Signal()
        fault = Signal()
        start = Signal()  # a row goes out from this pixel on
        black = Signal()  # a row has to be ended with a pixel that there is not
        full = Signal()  # the frame has all the rows that it may have
        # A row is going out, or was so lately: as a register, of the time from where the last one ended.
        blocked = Signal()
        flush_left = Signal(range(MIN_BLANKING))
        m.d.sync += blocked.eq(start | sending | o.row_last | (flush_left > 1))
        with m.If(o.row_last):
            m.d.sync += flush_left.eq(MIN_BLANKING - 2)
        with m.Elif(flush_left != 0):
            m.d.sync += flush_left.eq(flush_left - 1)
        # A row that comes too early waits for the period of the one before, while its own has begun.
        period_left = Signal(range(MIN_ROW_PERIOD))
        wait_left = Signal(range(MIN_ROW_PERIOD))
        in_period = Signal()  # period_left != 0, ahead of time
        waits = Signal()  # wait_left != 0, ahead of time
        with m.If(opens):
            m.d.sync += [
                period_left.eq(MIN_ROW_PERIOD - 1),
                in_period.eq(1),
                wait_left.eq(period_left - 1),
                waits.eq(in_period & (period_left != 1)),
            ]
        with m.Else():
            with m.If(in_period):
                m.d.sync += [period_left.eq(period_left - 1), in_period.eq(period_left != 1)]
            with m.If(waits):
                m.d.sync += [wait_left.eq(wait_left - 1), waits.eq(wait_left != 1)]
        # Known a clock later than it could be: no row can end and another start in between.
        reached = Signal()
        room = Signal()  # within a frame that has not reached it
        m.d.sync += [
            reached.eq(row_count == self.max_rows),
            room.eq((begin | (in_frame & ~frame_end)) & (row_count != self.max_rows)),
        ]
        m.d.comb += [
            full.eq(~begin & reached),
            start.eq((((begin | (first & room)) & ~in_period) | (follows & in_row & late & ~waits & room)) & ~blocked),
            black.eq(sending & cuts),
            out_valid.eq(start | (sending & moves)),
        ]
        limit = Signal()  # no more columns than up to this pixel
        finishes = Signal()  # the row that is going out ends
        nearly = Signal()  # one more is the limit
        with m.If(out_valid):
            m.d.sync += nearly.eq(~start & (columns == self.max_columns - 2))
        m.d.comb += [
            limit.eq(~start & nearly),
            finishes.eq(sending & moves & (cuts | nearly | stops)),
            out_last.eq((start & stops) | finishes),
            fault.eq(black | late | (lost & ~begin) | (~i.row_last & out_last)),
        ]
        m.d.sync += [
            self.pixel.valid.eq(out_valid),
            o.r.eq(Mux(black, 0, i.r)),
            o.g.eq(Mux(black, 0, i.g)),
            o.b.eq(Mux(black, 0, i.b)),
            o.row_first.eq(start),
            o.row_last.eq(out_last),
            o.frame_first.eq(start & (fresh | begin)),
            o.fault.eq(fault),
            self.frame_end.eq(end),
            self.frame_gap.eq(begin & close_frame),
        ]

        # The camera's state.
        with m.If(valid):
            m.d.sync += in_row.eq(belongs & ~stops)
        with m.Elif(frame_end):
            m.d.sync += in_row.eq(0)
        over = Signal()  # the camera's row is over
        m.d.comb += over.eq(belongs & stops)
        m.d.sync += sending.eq(Mux(start, ~stops, sending & ~finishes))
        with m.If(out_valid):
            m.d.sync += columns.eq(Mux(start, 1, columns + 1))
        with m.If(opens):
            m.d.sync += late.eq(~start & ~full)
        with m.Elif(start):
            m.d.sync += late.eq(0)
        with m.If(over | frame_end):
            m.d.sync += late.eq(0)
        with m.If(begin):
            m.d.sync += [in_frame.eq(1), seen.eq(1), lost.eq(0), fresh.eq(~start), row_count.eq(start)]
        with m.Else():
            with m.If(start):
                m.d.sync += [fresh.eq(0), row_count.eq(row_count + 1)]
            with m.If(frame_end):
                m.d.sync += in_frame.eq(0)
        with m.If(over & ~start & ((late & ~i.row_first) | (i.row_first & ~full))):
            m.d.sync += lost.eq(1)

        # Errors, a clock later.
        close_end = self._within(m, MIN_BLANKING, valid & i.row_last, "blanking")
        close_start = self._within(m, MIN_ROW_PERIOD, first, "row_period")
        found = Signal(CameraErrors)
        length = Signal(12)
        expected = Signal(12)
        measured = Signal()  # `expected` holds the length of the frame's first row
        row_over = Signal()
        m.d.sync += row_over.eq(over)
        with m.If(belongs):
            m.d.sync += length.eq(Mux(i.row_first, 1, Mux(length == self.max_columns, length, length + 1)))
        m.d.sync += [
            found.blanking.eq(first & seen & close_end),
            found.row_period.eq(first & seen & close_start),
            found.frame_gap.eq(begin & close_frame),
            found.columns.eq(out_valid & limit & ~i.row_last & ~black),
            found.rows.eq(opens & full),
            found.framing.eq(
                (valid & i.frame_first & ~i.row_first & seen)
                | (first & in_row)
                | (valid & seen & ~begin & ~belongs)
                | (frame_end & ~in_frame & ~begin & seen)
                | (frame_end & ((in_row & ~valid) | (valid & belongs & ~i.row_last)))
            ),
        ]
        ended = Signal()
        begun = Signal()
        m.d.sync += [ended.eq(end), begun.eq(begin)]
        bad_length = Signal()
        m.d.comb += bad_length.eq(row_over & measured & ~begun & (length != expected))
        with m.If(row_over & (~measured | begun)):
            m.d.sync += [measured.eq(1), expected.eq(length)]
        with m.If(begun & ~row_over):
            m.d.sync += measured.eq(0)
        rows_before = Signal(12)
        m.d.sync += rows_before.eq(row_count)
        with m.If(ended):
            m.d.sync += [self.rows.eq(Mux(begun, rows_before, row_count)), self.columns.eq(Mux(measured, expected, 0))]
            with m.If(~begun):
                m.d.sync += measured.eq(0)
                with m.If(row_over & ~measured):
                    m.d.sync += self.columns.eq(length)

        now = Signal(CameraErrors)
        m.d.comb += now.eq(held(m, found, "found"))
        m.d.comb += now.row_length.eq(held(m, bad_length, "bad_length"))
        told, told_begun = held(m, ended, "told"), held(m, begun, "told_begun")
        so_far = Signal(CameraErrors)
        m.d.sync += so_far.eq(so_far.as_value() | now.as_value())
        # A frame that the next one cut off lacks its end; the rest of what was found then is the new frame's.
        cut_off = Signal(CameraErrors)
        m.d.comb += cut_off.framing.eq(told & told_begun)
        m.d.sync += self.errors_ever.eq(self.errors_ever.as_value() | now.as_value() | cut_off.as_value())
        with m.If(told):
            with m.If(told_begun):
                m.d.sync += [self.errors.eq(so_far.as_value() | cut_off.as_value()), so_far.eq(now)]
            with m.Else():
                m.d.sync += [self.errors.eq(so_far.as_value() | now.as_value()), so_far.eq(0)]
        return m

    @staticmethod
    def _register(m: Module, value, name: str):
        register = Signal(value.shape(), name=f"{name}_held")
        m.d.sync += register.eq(value)
        return register

    @staticmethod
    def _wire(m: Module, value, name: str):
        wire = Signal(value.shape(), name=f"{name}_here")
        m.d.comb += wire.eq(value)
        return wire

    @staticmethod
    def _within(m: Module, clocks: int, event, name: str):
        """Whether fewer than ``clocks`` clocks have passed since ``event``, which itself does not count."""
        left = Signal(range(clocks), name=f"{name}_left")
        within = Signal(name=f"{name}_within")  # left != 0, ahead of time
        with m.If(event):
            m.d.sync += [left.eq(clocks - 1), within.eq(1)]
        with m.Elif(within):
            m.d.sync += [left.eq(left - 1), within.eq(left != 1)]
        return within
