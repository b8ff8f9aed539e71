"""The isolated-pixel filter: a pixel of the gate stays only among others."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.reference import isolate

from ..arithmetic import delayed
from ..camera.monitor import MIN_BLANKING, MIN_ROW_PERIOD
from ..layouts import FrameSettings
from ..memory import BlockRam
from .pixels import MeasuredPixel


class HeldPixel(data.Struct):
    """A pixel of the row that is held; ``above``: the pixel over it is gated."""

    mix: 8
    weight: 8
    gate: 1
    above: 1
    saturated: 1
    fault: 1
    row_last: 1


class Isolate(wiring.Component):
    """Takes a pixel from the gate if fewer than ``isolate`` of its eight neighbours are gated.

    With ``isolate`` 0 everything passes, :attr:`latency` clocks later. Otherwise a row is held until the next one comes
    in, as :func:`magtrak.reference.isolate` says for whole images: its pixel x goes out 2 clocks after pixel x + 1 of
    the next row came in, its last pixel 3 clocks after that row's last. The last row of an image follows
    by itself, a pixel a clock, from ``i_frame_end`` on or as soon as the blanking is over, while the next image may
    begin. The setting in force in the clock after the first pixel of an image holds for all of it.

    In and out, images have the form that :class:`~gateware.camera.monitor.Monitor` gives them, with one limit: a row
    goes out with its first pixel at the second pixel of the next row, so that gaps between those two move the
    start of a row, though not its end. Nothing of one image gets into another. Where rows are of different
    length:

    - a row ends where the next one ends, if that is shorter: its last pixel has ``fault``; pixels above or
      below which a row has none count as not gated;
    - an image's last row ends with ``fault`` where the next image's first row ends, if it has not gone out by then.

    After ``isolate`` was set to 0, images that begin before the one before has gone out are still held by a row, and
    nothing is taken from their gate. Up to 7 images without rows whose end comes in the meantime are remembered.

    Parameters
    ----------
    max_columns : pixels that a row may have, 2 to 2048

    Members
    -------
    settings : ``isolate`` is used
    i : stream of :class:`~gateware.vision.pixels.MeasuredPixel`, always ready
    ahead : ``i`` as it is in the next clock; of this only ``valid`` and the flags of row and image are used
    i_frame_end : strobe, with or after the last pixel of an image, or with the first one of the next
    o : stream of :class:`~gateware.vision.pixels.MeasuredPixel`, always ready
    coming : ``o.valid`` as it will be in the next clock
    holding : a whole row has not gone out yet
    o_frame_end : strobe; :attr:`latency` clocks after ``i_frame_end`` with ``isolate`` 0, otherwise in the clock after
        the last pixel

    Raises
    ------
    ValueError
        The limit is out of range.
    """

    def __init__(self, max_columns: int = 2048) -> None:
        if not 2 <= max_columns <= 2048:
            raise ValueError(f"max_columns is {max_columns}; 2 to 2048 are possible")
        self.max_columns = max_columns
        super().__init__(
            {
                "settings": In(FrameSettings),
                "i": In(stream.Signature(MeasuredPixel, always_ready=True)),
                "ahead": In(stream.Signature(MeasuredPixel, always_ready=True)),
                "i_frame_end": In(1),
                "o": Out(stream.Signature(MeasuredPixel, always_ready=True)),
                "coming": Out(1),
                "o_frame_end": Out(1),
                "holding": Out(1),
            }
        )

    reference = staticmethod(isolate)

    latency = 3
    """Clocks from ``i`` to ``o``; with the filter on, from the last pixel of the next row."""

    def elaborate(self, platform):
        m = Module()
        i, valid = self.i.p, self.i.valid
        first = Signal()
        frame_first = Signal()
        last = Signal()
        follows = Signal()
        ahead, comes = self.ahead.p, self.ahead.valid
        m.d.sync += [
            first.eq(comes & ahead.row_first),
            frame_first.eq(comes & ahead.row_first & ahead.frame_first),
            follows.eq(comes & ahead.row_first & ~ahead.frame_first),
            last.eq(comes & ahead.row_last),
        ]

        direct = Signal(init=1)  # the image passes, it is not held
        held = Signal()  # a whole row waits to go out
        ending = Signal()  # it is the last of its image
        flushing = Signal()  # it goes out by itself
        active = Signal()  # it goes out as the next one comes in

        # The time that a camera would leave between rows, for the row that goes out by itself.
        rest = Signal(range(MIN_ROW_PERIOD))
        ready = Signal(init=1)
        flush = Signal()
        flushed = Signal()
        with m.If(first | flush):
            m.d.sync += [rest.eq(MIN_ROW_PERIOD - 1), ready.eq(0)]
        with m.Elif((last | flushed) & (rest < MIN_BLANKING)):
            m.d.sync += [rest.eq(MIN_BLANKING - 1), ready.eq(0)]
        with m.Elif(~ready):
            m.d.sync += [rest.eq(rest - 1), ready.eq(rest == 1)]

        # What happens: a step brings a column of three pixels into view, and the pixel before it goes out.
        begins, opens, step_row, extra, goes, step = (Signal() for _ in range(6))
        m.d.comb += [
            goes.eq(extra | flushing),
            begins.eq(follows & held),
            # Ahead of the next image's pixels, which take the place of what has been read.
            flush.eq(held & ((~follows & (self.i_frame_end | ending) & ready) | frame_first)),
            opens.eq(begins | flush),
            step_row.eq(begins | (valid & active)),
            step.eq((valid & active) | goes | (held & (first | ((self.i_frame_end | ending) & ready)))),
        ]
        m.d.sync += extra.eq(step_row & last)
        with m.If(opens):
            m.d.sync += held.eq(0)
        with m.If(step_row):
            m.d.sync += active.eq(~last)

        # The column at hand, and the pixel of it that goes out with the next step.
        word = Signal(HeldPixel)
        here = Signal(HeldPixel, reset_less=True)
        here_first = Signal()
        here_valid = Signal()
        present = Signal()
        cut = Signal()
        ends = Signal()
        next_ended = Signal()
        m.d.sync += next_ended.eq(last)
        m.d.comb += [
            cut.eq(extra | (flushing & next_ended)),
            ends.eq(here.row_last | cut),
            present.eq(opens | (here_valid & ~ends)),
            flushed.eq(flushing & ends),
        ]
        with m.If(step):
            m.d.sync += [here.eq(word), here_first.eq(opens), here_valid.eq(present)]
        with m.If(flush):
            m.d.sync += flushing.eq(1)
        with m.Elif(flushed):
            m.d.sync += flushing.eq(0)

        # Gated pixels of the column, and of the two before it.
        column = Signal(2)
        column_before = Signal(2)
        before = Signal(3)
        above = Signal()  # of the row that comes in
        m.d.comb += above.eq(present & word.gate)
        with m.If(step):
            m.d.sync += [
                column.eq((step_row & i.gate) + above + (present & word.above)),
                column_before.eq(Mux(opens, 0, column)),
                before.eq(column + column_before),
            ]

        # Out.
        there = Signal(HeldPixel, reset_less=True)
        there_valid = Signal()
        there_first = Signal()
        there_top = Signal()
        there_last = Signal()
        there_fault = Signal()
        need = Signal(4)
        need_now = Signal(4)
        top = Signal()  # the row that came in last is an image's first
        top_now = Signal()  # the one that goes out is
        with m.If(first):
            m.d.sync += top.eq(i.frame_first)
        with m.If(opens):
            m.d.sync += [top_now.eq(top), need_now.eq(need)]
        m.d.sync += [
            there.eq(here),
            there_valid.eq(step & here_valid & ~opens),
            there_first.eq(here_first),
            there_top.eq(top_now & here_first),
            there_last.eq(ends),
            there_fault.eq(here.fault | (cut & ~here.row_last)),
        ]
        stays = Signal()
        m.d.comb += stays.eq(column + before > need_now)  # the pixel counts in its own square

        # What comes in, two clocks ago, when it is known whether its image is held.
        late = delayed(m, i, 2, "pixel")
        late_above = delayed(m, above & step_row, 2, "above")
        valid_1 = Signal()
        valid_2 = Signal()
        first_1 = Signal()
        m.d.sync += [valid_1.eq(valid), valid_2.eq(valid_1), first_1.eq(first)]
        o = self.o.p
        m.d.comb += self.coming.eq(Mux(direct, valid_2, there_valid))
        m.d.sync += self.o.valid.eq(self.coming)
        with m.If(direct):
            m.d.sync += o.eq(late)
        with m.Else():
            m.d.sync += [
                o.mix.eq(there.mix),
                o.weight.eq(there.weight),
                o.gate.eq(there.gate & stays),
                o.saturated.eq(there.saturated),
                o.row_first.eq(there_first),
                o.row_last.eq(there_last),
                o.frame_first.eq(there_top),
                o.fault.eq(there_fault),
            ]

        # The setting of an image, known a clock after its first pixel.
        quiet = Signal()
        begun = Signal()
        m.d.sync += [begun.eq(frame_first), quiet.eq(direct | (~held & ~flushing & ready))]
        with m.If(begun):
            m.d.sync += [need.eq(self.settings.isolate), direct.eq(quiet & (self.settings.isolate == 0))]

        # The row: written when its image is known to be held; read two columns ahead, for the memory's own register.
        # A column is never read in the clock in which it is written.
        m.submodules.memory = memory = BlockRam(HeldPixel, self.max_columns, registered=True)
        write, read = memory.write, memory.read
        fetch = Signal()
        fetch_at = Signal(range(self.max_columns))
        at = Signal(range(self.max_columns))
        priming = Signal()  # two more are read
        primed = Signal()
        with m.If(first_1):
            m.d.sync += at.eq(0)
        with m.Elif(valid_1):
            m.d.sync += at.eq(at + 1)
        m.d.comb += [write.addr.eq(at), write.en.eq(valid_2 & ~direct), write.data.above.eq(late_above)]
        for name in ("mix", "weight", "gate", "saturated", "fault", "row_last"):
            m.d.comb += write.data[name].eq(late[name])
        m.d.comb += [read.addr.eq(fetch_at), read.en.eq(fetch), word.eq(read.data), fetch.eq(step | priming)]
        m.d.sync += [priming.eq(priming & ~primed), primed.eq(priming)]
        with m.If(fetch):
            m.d.sync += fetch_at.eq(fetch_at + 1)
        with m.If(write.en & late.row_last):
            m.d.sync += [held.eq(1), priming.eq(1), primed.eq(0), fetch_at.eq(0)]

        # The end of the image.
        has_rows = Signal()
        ended = Signal()
        flush_before = Signal()
        owed = Signal(3)
        passes = Signal(2)
        waits = Signal()
        done = Signal(2)
        m.d.sync += [
            ended.eq(self.i_frame_end),
            flush_before.eq(flush),
            done.eq(Cat(flushed, done)),
            passes.eq(ended & direct),
        ]
        pays = Signal()
        owes = Signal()
        with m.If(ended):
            m.d.sync += has_rows.eq(begun)
            with m.If(~direct & has_rows & ~flush_before):
                m.d.sync += ending.eq(1)
        with m.Elif(valid_1):
            m.d.sync += has_rows.eq(1)
        with m.If(flush):
            m.d.sync += ending.eq(0)
        # Ends of images without rows wait for the one before, but not for one after.
        m.d.comb += [owes.eq(ended & ~direct & ~has_rows), pays.eq(owed.any() & ~waits)]
        with m.If(done[1]):
            m.d.sync += waits.eq(0)
        with m.Elif(~owed.any()):
            m.d.sync += waits.eq(ending | flushing | done.any())
        with m.If(owes & ~pays & ~owed.all()):
            m.d.sync += owed.eq(owed + 1)
        with m.Elif(pays & ~owes):
            m.d.sync += owed.eq(owed - 1)
        m.d.comb += self.holding.eq(held | flushing)
        m.d.sync += self.o_frame_end.eq(passes | done[1] | pays)
        return m
