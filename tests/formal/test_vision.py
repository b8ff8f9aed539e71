"""Runs are where they should be, on every row of a bounded length; no sum overflows in an image of the stated size.

``prove``: for ever, by induction. ``bmc``: for every sequence of the stated length from reset on.
"""

from amaranth.hdl import Assert, Assume, C, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from gateware.vision.runs import Runs
from gateware.vision.spread import Spread
from tests.support.formal import Opened, prove

COLUMNS = 2048


class RunsAreWhereTheyShouldBe(wiring.Component):
    """Every row of ``columns`` columns: one run after another, none twice, none left out.

    By what a run is, and not by how it is found: it begins at a lit column with no lit one in the ``bridge + 1`` before
    it, ends at one with none in as many after it, and a row has as many runs as beginnings.
    """

    weight: In(2)

    def __init__(self, columns: int, bridge: int) -> None:
        self.columns = columns
        self.bridge = bridge
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = Runs()
        column, rest = Signal(range(self.columns + 1)), Signal(range(Runs.latency + 1))
        m.d.comb += dut.settings.run_bridge.eq(self.bridge)

        # Rows: each at least `latency` clocks after the one before.
        i = dut.column.p
        takes, ends = Signal(), Signal()
        m.d.comb += [
            takes.eq(rest == 0),
            ends.eq(column == self.columns - 1),
            dut.column.valid.eq(takes),
            dut.before.eq(column - 1),
            i.column.eq(column),
            i.row_first.eq(column == 0),
            i.row_last.eq(ends),
            i.weight.eq(self.weight),
            i.lit.eq(self.weight.any()),
        ]
        row = [Signal(2, name=f"column_{at}") for at in range(self.columns)]
        with m.If(takes):
            m.d.sync += column.eq(Mux(ends, 0, column + 1))
            with m.If(ends):
                m.d.sync += rest.eq(Runs.latency)
            for at, pixel in enumerate(row):
                with m.If(column == at):
                    m.d.sync += pixel.eq(self.weight)
                with m.Elif(column == 0):
                    m.d.sync += pixel.eq(0)
        with m.If(rest != 0):
            m.d.sync += rest.eq(rest - 1)

        # What has to come out.
        lit = [pixel.any() for pixel in row]
        begins, finishes = Signal(self.columns), Signal(self.columns)
        for at in range(self.columns):
            behind = [lit[at - k] for k in range(1, min(at, self.bridge + 1) + 1)]
            ahead = [lit[at + k] for k in range(1, min(self.columns - 1 - at, self.bridge + 1) + 1)]
            m.d.comb += [
                begins[at].eq(lit[at] & ~_any(behind)),
                finishes[at].eq(lit[at] & ~_any(ahead)),
            ]
        count, seen, after = Signal(range(self.columns + 1)), Signal(range(self.columns + 1)), Signal(4)
        m.d.comb += count.eq(sum(begins))
        o = dut.o
        inside = [(at >= o.first) & (at <= o.last) for at in range(self.columns)]
        with m.If(dut.valid):
            m.d.comb += [
                Assert(o.first <= o.last),
                Assert(o.first >= after),
                Assert(begins.bit_select(o.first, 1)),
                Assert(finishes.bit_select(o.last, 1)),
                Assert(o.width == o.last - o.first + 1),
                Assert(o.sum == sum(Mux(own, pixel, 0) for own, pixel in zip(inside, row, strict=True))),
                Assert(~_any([own & (pixel > o.peak) for own, pixel in zip(inside, row, strict=True)])),
                Assert(_any([own & (pixel == o.peak) for own, pixel in zip(inside, row, strict=True)])),
            ]
            # No other run begins or ends within it.
            for at in range(self.columns):
                m.d.comb += Assert(~inside[at] | ((~begins[at] | (at == o.first)) & (~finishes[at] | (at == o.last))))
            m.d.sync += [seen.eq(seen + 1), after.eq(o.last + 1)]
        # All of them are out `latency` clocks after the row's last column.
        with m.If(rest == 1):
            m.d.comb += Assert(seen + dut.valid == count)
            m.d.sync += [seen.eq(0), after.eq(0)]
        return m


def _any(bits):
    found = C(0, 1)
    for bit in bits:
        found = found | bit
    return found


class RowsOfTheStatedSize(wiring.Component):
    """Rows of up to 2048 columns, one column after another, with pauses anywhere, of any content."""

    valid: In(1)
    last: In(1)
    weight: In(8)
    lit: In(1)
    gate: In(1)
    saturated: In(1)
    bridge: In(4)

    def feed(self, m: Module, dut) -> Signal:
        """Drives the columns; returns the column that comes next, 0 between rows."""
        column = Signal(12)
        ends = self.last | (column == COLUMNS - 1)
        with m.If(self.valid):
            m.d.sync += column.eq(Mux(ends, 0, column + 1))
        i = dut.column.p
        m.d.comb += [
            dut.column.valid.eq(self.valid),
            i.column.eq(column),
            i.row_first.eq(column == 0),
            i.row_last.eq(ends),
            Assert(column < COLUMNS),
        ]
        for name in ("weight", "lit", "gate", "saturated"):
            m.d.comb += i[name].eq(getattr(self, name))
        return column


class RunsDoNotOverflow(RowsOfTheStatedSize):
    """Sum, moment and counts of a run stay below what their registers hold, settings changing as they like."""

    def elaborate(self, platform):
        m = Module()
        dut = Runs()
        m.submodules.dut = inner = Opened(dut)
        column = self.feed(m, dut)
        m.d.comb += dut.settings.run_bridge.eq(self.bridge)
        total, swept, moment = inner["run__sum"], inner["swept"], inner["run__moment"]
        clipped, at, is_open = inner["run__clipped"], inner["at"], inner["is_open"]
        adding = inner["extends"] | inner["passes"]
        pending = inner["starts"] | adding

        # Each column so far adds less than 256 to the sum, each but the first less than 2**19 to the moment.
        for value, bound in (
            (total, lambda columns: columns << 8),
            (clipped, lambda columns: columns),
            (swept, lambda columns: (columns - 1) << 19),
            (moment, lambda columns: (columns - 1) << 19),
        ):
            assert bound(COLUMNS) < 1 << len(value), "the register is too narrow"
            m.d.comb += [
                Assert(value <= bound(COLUMNS)),
                Assert(~adding | (value <= bound(at))),
                Assert(~is_open | pending | (value <= bound(column))),
            ]
        m.d.comb += [
            Assert(at < COLUMNS),
            Assert((column == 0) | (at == column - 1)),
            Assert(~is_open | (column != 0)),
            Assert(~adding | (at != 0)),
            Assert(~(inner["starts"] & adding)),
        ]
        return m


class SpreadDoesNotOverflow(RowsOfTheStatedSize):
    """Number and sum of the columns of gated pixels."""

    def elaborate(self, platform):
        m = Module()
        dut = Spread()
        m.submodules.dut = inner = Opened(dut)
        fed = self.feed(m, dut)
        # What was fed a clock ago is added.
        column, adds, ends = Signal.like(fed), Signal(), Signal()
        m.d.sync += [column.eq(fed), adds.eq(self.valid), ends.eq(self.valid & dut.column.p.row_last)]
        over = Signal()
        m.d.sync += over.eq(ends)
        m.d.comb += Assume(~((over | ends) & self.valid))
        done = Signal(12)  # columns of the row that are in the sums
        with m.If(adds):
            m.d.sync += done.eq(column + 1)
        # The sum of all columns before `done`: done * (done - 1) / 2, in halves of six bits, for the solver's sake.
        low, high = done[:6], done[6:]
        triangle = Signal(22)
        m.d.comb += triangle.eq((_pairs(high) << 12) + high * (64 * 63 // 2) + _pairs(low) + ((high * low) << 6))
        assert 1 << len(dut.o.p.numerator) > COLUMNS * (COLUMNS - 1) // 2
        m.d.comb += [
            Assert(done <= COLUMNS),
            Assert((column == 0) | (done == column)),
            Assert(over == inner["over"]),
            Assert(ends == inner["ends"]),
            Assert(~(over & adds)),
            Assert(~inner["gated"] | adds),
            Assert(~adds | (inner["column"] == column)),
            Assert(fed == Mux(ends, 0, column + adds)),
            Assert((column != 0) | over | (inner["total"] == 0)),
            Assert((column != 0) | over | (inner["columns"] == 0)),
            Assert(inner["total"] <= done),
            Assert(inner["columns"] <= triangle),
            Assert(triangle <= COLUMNS * (COLUMNS - 1) // 2),
        ]
        return m


def _pairs(amount):
    return ((amount * (amount - 1)) >> 1)[:12]


def test_runs_are_where_they_should_be():
    columns = 6
    for bridge in (0, 1, 2):
        prove(RunsAreWhereTheyShouldBe(columns, bridge), "bmc", columns + Runs.latency + 2)


def test_sums_of_runs_do_not_overflow():
    prove(RunsDoNotOverflow(), "prove", 2)


def test_sums_of_gated_columns_do_not_overflow():
    prove(SpreadDoesNotOverflow(), "prove", 2)
