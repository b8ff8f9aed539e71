"""Holds pixels back, so that a row is measured with the columns ahead in view."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.reference.fir import REACH

from ..arithmetic import delayed
from ..layouts import FrameSettings
from .pixels import MeasuredPixel

LOOKAHEAD = 15
"""Columns that are known beyond the one being measured: the greatest ``run_reach``."""


class Column(data.Struct):
    """A pixel where runs are measured.

    ``ahead`` counts the gated pixels of the row up to ``run_reach`` columns after it, ``behind`` those more than
    ``run_reach`` columns before it: the gated pixels within reach of a run are ``ahead`` at its last column less
    ``behind`` at its first. It has at most 64 bits: a simulation would move wider ones word by word.
    """

    column: 12
    row: 12
    weight: 8
    lit: 1
    gate: 1
    saturated: 1
    row_first: 1
    row_last: 1
    fault: 1
    ahead: 12
    behind: 12


class Lookahead(wiring.Component):
    """Delays pixels by :data:`LOOKAHEAD` columns and counts gated pixels ahead and behind.

    Pixels may come with gaps. After the last one of a row the delay is flushed with as many blank columns, one a clock;
    the next row must leave that time, and :class:`~gateware.camera.monitor.Monitor` sees to it.

    Members
    -------
    settings : ``run_reach``, ``column_first`` and ``column_last`` are used
    i : stream of :class:`~gateware.vision.pixels.MeasuredPixel`, always ready
    coming : ``i.valid`` as it will be in the next clock
    step, mix, row_first : the filter's input: a new column, its mix (a blank repeats the last), whether it begins a
        row; the column stands at ``mix`` from the clock after its step on, until the next step
    before : number of the column before it, modulo 4096
    left_edge, right_edge : of the column: the row or the region of interest begins, ends with it
    near_last : fewer than :data:`~magtrak.reference.fir.REACH` columns follow it in the row
    o : stream of :class:`Column`, always ready; :attr:`latency` clocks after the pixel where columns come one a clock
    """

    settings: In(FrameSettings)
    i: In(stream.Signature(MeasuredPixel, always_ready=True))
    coming: In(1)
    step: Out(1)
    mix: Out(8)
    row_first: Out(1)
    before: Out(12)
    left_edge: Out(1)
    right_edge: Out(1)
    near_last: Out(1)
    o: Out(stream.Signature(Column, always_ready=True))

    latency = LOOKAHEAD + 1
    """Clocks from the pixel to its column, where columns come one a clock."""

    def elaborate(self, platform):
        m = Module()
        i = self.i.p
        blanks = Signal(range(LOOKAHEAD + 1))  # left to insert
        blanking = Signal()  # blanks != 0, ahead of time
        blanks_next = Signal()
        m.d.comb += blanks_next.eq(Mux(self.i.valid, i.row_last, blanking & (blanks != 1)))
        with m.If(self.i.valid):
            m.d.sync += blanks.eq(Mux(i.row_last, LOOKAHEAD, 0))
        with m.Elif(blanking):
            m.d.sync += blanks.eq(blanks - 1)
        # A register of its own, for it has a hundred enables to drive.
        m.d.sync += [blanking.eq(blanks_next), self.step.eq(self.coming | blanks_next)]

        # Place p of each line holds what entered p steps ago; column x stands at place LOOKAHEAD.
        flags = ("gate", "saturated", "row_first", "row_last", "frame_first", "fault")
        entering = {name: self.i.valid & i[name] for name in flags}
        entering |= {"pixel": self.i.valid, "lit": self.i.valid & i.weight.any()}
        lines = {}
        for name, value in entering.items():
            places = 2 * LOOKAHEAD if name == "gate" else LOOKAHEAD + 1
            lines[name] = line = Signal(places, name=f"{name}_line")
            with m.If(self.step):
                m.d.sync += line.eq(Cat(value, line))
        weight = Signal(8, reset_less=True)
        weights = [weight]
        with m.If(self.step):
            m.d.sync += weight.eq(i.weight)
            for place in range(1, LOOKAHEAD + 1):
                next_weight = Signal(8, name=f"weight_{place}", reset_less=True)
                m.d.sync += next_weight.eq(weights[-1])
                weights.append(next_weight)
        with m.If(self.i.valid):
            m.d.sync += self.mix.eq(i.mix)
        m.d.comb += self.row_first.eq(lines["row_first"][0])

        # What stands at LOOKAHEAD - 1 now and at LOOKAHEAD after the step; the counters take it in the same step.
        entry = LOOKAHEAD - 1
        reach = self.settings.run_reach
        # (A reset that does not wait for a clock enable costs nothing.)
        row_comes = Signal()  # with the next step it enters
        row_enters = Signal()
        frame_enters = Signal()
        leaves = Signal()
        column = Signal(12)
        row = Signal(12)
        ahead = Signal(12)
        behind = Signal(12)
        # Both gates are picked a step ahead, but for the one that just enters, which the greatest reach needs. That one
        # picks nothing ahead: a smaller reach may be in force at the next step, in another image.
        gates = Cat(entering["gate"], lines["gate"])
        ahead_pick = Signal()
        behind_pick = Signal()
        ahead_gate = Signal()
        with m.If(self.step):
            m.d.sync += [
                ahead_pick.eq(Cat(reversed(gates[:LOOKAHEAD])).bit_select(reach, 1)),  # 0 for the greatest
                behind_pick.eq(gates[LOOKAHEAD:].bit_select(reach, 1)),
            ]
        m.d.comb += [
            row_comes.eq(self.step & lines["row_first"][entry - 1]),
            row_enters.eq(self.step & lines["row_first"][entry]),
            frame_enters.eq(row_enters & lines["frame_first"][entry]),
            leaves.eq(self.step & lines["row_last"][LOOKAHEAD]),
            ahead_gate.eq(Mux(reach == LOOKAHEAD, entering["gate"], ahead_pick)),
        ]
        # The column that follows, so that what the edges are is known with the column.
        following = Signal(12)
        at_first = Signal()
        at_last = Signal()
        with m.If(row_comes):
            m.d.sync += following.eq(0)
        with m.Elif(self.step):
            m.d.sync += following.eq(following + 1)
        with m.If(row_enters):
            m.d.sync += [self.before.eq(~0), behind.eq(0)]
        with m.Elif(self.step):
            m.d.sync += [self.before.eq(column), behind.eq(behind + behind_pick)]
        with m.If(self.step):
            m.d.sync += [
                column.eq(following),
                at_first.eq(following == self.settings.column_first),
                at_last.eq(following == self.settings.column_last),
            ]
        # Behind a row's last column all is blank, so the count starts anew before the next row is in view.
        with m.If(leaves):
            m.d.sync += ahead.eq(ahead_gate)
        with m.Elif(self.step):
            m.d.sync += ahead.eq(ahead + ahead_gate)
        with m.If(frame_enters):
            m.d.sync += row.eq(0)
        with m.Elif(row_enters):
            m.d.sync += row.eq(row + 1)
        stepped = delayed(m, self.step, 1, "stepped")

        o = self.o.p
        m.d.comb += [
            self.o.valid.eq(stepped & lines["pixel"][LOOKAHEAD]),
            o.column.eq(column),
            o.row.eq(row),
            o.weight.eq(weights[LOOKAHEAD]),
            o.ahead.eq(ahead),
            o.behind.eq(behind),
            self.left_edge.eq(o.row_first | at_first),
            self.right_edge.eq(o.row_last | at_last),
            self.near_last.eq(lines["row_last"][LOOKAHEAD - REACH + 1 : LOOKAHEAD + 1].any()),
        ]
        for name in ("lit", "gate", "saturated", "row_first", "row_last", "fault"):
            m.d.comb += o[name].eq(lines[name][LOOKAHEAD])
        return m
