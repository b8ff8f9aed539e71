"""Runs are where they should be, on every row of a bounded length; sums do not overflow in any image of the stated size.

``prove``: for ever, by induction. ``bmc``: for every sequence of the stated length from reset on.
"""

from amaranth.hdl import Array, Assert, Assume, C, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from gateware.vision.runs import Runs
from gateware.vision.spread import Spread
from tests.support.formal import Opened, past, prove

COLUMNS = 2048
WEIGHT = 255


class RunsAreWhereTheyShouldBe(wiring.Component):
    """Every row of up to ``columns`` columns, with pauses anywhere: one run after another, none twice, none left out.

    By what a run is, and not by how it is found: it begins at a lit column with no lit one in the ``bridge + 1`` before
    it, ends at one with none in as many after it, and a row has as many runs as beginnings.
    """

    valid: In(1)
    weight: In(3)
    last: In(1)
    bridge: In(4)

    def __init__(self, columns: int) -> None:
        self.columns = columns
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = Runs()
        column, rest = Signal(range(self.columns + 1)), Signal(range(Runs.latency + 1))
        started = Signal()
        bridge = Signal(4)
        m.d.sync += [started.eq(1), bridge.eq(self.bridge)]
        m.d.comb += [Assume(~started | (self.bridge == bridge)), dut.settings.run_bridge.eq(self.bridge)]

        # Rows: each at least `latency` clocks after the one before.
        i = dut.column.p
        takes, ends = Signal(), Signal()
        m.d.comb += [
            takes.eq(self.valid & (rest == 0)),
            ends.eq(self.last | (column == self.columns - 1)),
            dut.column.valid.eq(takes),
            i.column.eq(column),
            i.row_first.eq(column == 0),
            i.row_last.eq(ends),
            i.weight.eq(self.weight),
            i.lit.eq(self.weight.any()),
        ]
        row = [Signal(3, name=f"column_{at}") for at in range(self.columns)]
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
            behind = [lit[at - k] & (k <= bridge + 1) for k in range(1, at + 1)]
            ahead = [lit[at + k] & (k <= bridge + 1) for k in range(1, self.columns - at)]
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
                Assert(
                    o.moment
                    == sum(Mux(own, pixel * (o.last - at)[:4], 0) for at, (own, pixel) in _numbered(inside, row))
                ),
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


def _numbered(inside, row):
    return enumerate(zip(inside, row, strict=True))


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
        pending = inner["starts"] | inner["extends"]

        # Each column adds at most one weight to the sum, and to the moment at most all weights that a row may have.
        most = COLUMNS * WEIGHT
        for value, each in ((total, WEIGHT), (clipped, 1), (swept, most), (moment, most)):
            assert each * COLUMNS < 1 << len(value), "the register is too narrow"
            m.d.comb += [
                Assert(value <= each * COLUMNS),
                Assert(~inner["extends"] | (value <= each * at)),
                Assert(~is_open | pending | inner["passes"] | (value <= each * column)),
                Assert(~inner["passes"] | (value <= each * at)),
            ]
        m.d.comb += [
            Assert(at < COLUMNS),
            Assert((column == 0) | (at == column - 1)),
            Assert(~is_open | (column != 0)),
            Assert(~(inner["starts"] & inner["extends"])),
        ]
        return m


class SpreadDoesNotOverflow(RowsOfTheStatedSize):
    """Number and sum of the columns of gated pixels."""

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = Spread()
        column = self.feed(m, dut)
        done = Signal(12)  # columns of the row that are in the sums
        with m.If(self.valid):
            m.d.sync += done.eq(column + 1)
        # The sum of all columns before `done`: done * (done - 1) / 2, from two small tables, for the solver's sake.
        low, high = done[:6], done[6:]
        halves = Array(C(k * (k - 1) // 2, 12) for k in range(64))
        triangle = Signal(22)
        m.d.comb += triangle.eq((halves[high] << 12) + high * (64 * 63 // 2) + halves[low] + ((high * low) << 6))
        assert COLUMNS * (COLUMNS - 1) // 2 < 1 << len(dut.o.p.columns)
        m.d.comb += [
            Assert(done <= COLUMNS),
            Assert((column == 0) | (done == column)),
            Assert(dut.o.p.total <= done),
            Assert(dut.o.p.columns <= triangle),
            Assert(triangle <= COLUMNS * (COLUMNS - 1) // 2),
        ]
        return m


def test_runs_are_where_they_should_be():
    prove(RunsAreWhereTheyShouldBe(5), "bmc", 18)


def test_sums_of_runs_do_not_overflow():
    prove(RunsDoNotOverflow(), "prove", 2)


def test_sums_of_gated_columns_do_not_overflow():
    prove(SpreadDoesNotOverflow(), "prove", 2)
