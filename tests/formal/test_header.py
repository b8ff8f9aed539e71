"""Headers that the link can read are of one image each: for every sequence of inputs, for ever, by induction."""

from amaranth.hdl import Assert, Assume, Cat, Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from gateware.frame.facts import EDGE_BASE, EDGE_WORDS, HEADER_WORDS, STEADY_CLOCKS, WORDS
from gateware.frame.header import _START_WORDS, MAX_EDGES, HeaderStore
from tests.support.formal import Opened, past, prove


class HeaderIsWhole(wiring.Component):
    """When a header is complete, each of its words was written for this image; and none is written after.

    Images begin 112 clocks apart at least, into a bank without a header to be completed: :class:`FramesAreWhole` proves
    the latter. Their motion is known in order, the next one's not before the header is complete. One word is followed,
    any one.

    Members
    -------
    begin, into : an image begins, into this bank, where one can
    end, known, fill : it ends; the motion of the oldest that ended is known; rows of a bank are complete
    place : the word that is followed
    """

    begin: In(1)
    into: In(1)
    end: In(1)
    known: In(1)
    fill: In(2)
    place: In(range(2 * WORDS))

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = Opened(HeaderStore())

        # What each bank waits for, in order, and the clocks since an image began.
        free, begun, ended, known = range(4)
        waits = [Signal(2, name=f"waits{bank}") for bank in range(2)]
        filled, within, last, age = Signal(2), Signal(), Signal(), Signal(7, init=127)
        begin, end, taken = Signal(), Signal(), Signal()
        order = Signal()  # of two banks that ended: the one that did first
        both = (waits[0] == ended) & (waits[1] == ended)
        oldest = Mux(both, order, waits[1] == ended)

        def of(bank):
            return Mux(bank, waits[1], waits[0])

        m.d.comb += [
            begin.eq(self.begin & ~within & (age >= 112) & (of(self.into) == free)),
            end.eq(self.end & within),
            taken.eq(
                self.known & ((waits[0] == ended) | (waits[1] == ended)) & (waits[0] != known) & (waits[1] != known)
            ),
            dut.begin.eq(begin),
            dut.into.eq(self.into),
            dut.take.eq(end),
            dut.ends.eq(last),
            dut.taken.eq(taken),
            dut.filled.eq(filled),
        ]
        m.d.sync += [within.eq((within | begin) & ~end), age.eq(Mux(begin, 1, age + ~age.all()))]
        with m.If(begin):
            m.d.sync += last.eq(self.into)
        with m.If(end):
            m.d.sync += order.eq(Mux(of(~last) == ended, ~last, last))
        for bank in range(2):
            with m.If(begin & (self.into == bank)):
                m.d.sync += [waits[bank].eq(begun), filled[bank].eq(0)]
            with m.Else():
                m.d.sync += filled[bank].eq(filled[bank] | (self.fill[bank] & (waits[bank] != free)))
            with m.If(end & (last == bank)):
                m.d.sync += waits[bank].eq(ended)
            with m.If(taken & (oldest == bank)):
                m.d.sync += waits[bank].eq(known)
            with m.If(dut.complete & (dut.complete_bank == bank)):
                m.d.sync += waits[bank].eq(free)

        # The word that is followed: whether it was written since its bank's image began.
        place, early = Signal.like(self.place), Signal(init=1)
        m.d.sync += [early.eq(0), place.eq(self.place)]
        m.d.comb += Assume(early | (place == self.place))
        bits = len(self.place) - 1
        word, bank = self.place[:bits], self.place[bits]
        writes, address = dut["write__en"], dut["write__addr"]
        hot, at, wanted, step, state = (dut[name] for name in ("hot", "at", "wanted", "step", "fsm_state"))
        started, starting, due, logged, copying = (
            dut[name] for name in ("started", "starting", "due", "logged", "copying")
        )
        passing, of_start = hot[:HEADER_WORDS].any(), dut["of_start"]
        issues = Mux(passing, of_start == wanted, hot.any())
        fresh, fresh_now, there = Signal(), Signal(), Signal()
        m.d.comb += [
            fresh_now.eq(fresh | (writes & (address == self.place))),
            there.eq(fresh_now | (issues & (at == self.place))),
        ]
        m.d.sync += fresh.eq(fresh_now & ~(begin & (self.into == bank)))
        m.d.comb += Assert((writes == past(m, issues)) & (~writes | (address == past(m, at))))
        is_start = Cat(word == number for number in _START_WORDS).any()
        is_edge, edge = word[bits - 1], word[: bits - 1]

        wait, start, edges, header, completes = (state == number for number in range(5))

        # What is to be proved.
        m.d.comb += Assert(~writes | (of(address[bits]) != free))
        with m.If(dut.complete):
            m.d.comb += Assert((of(dut.complete_bank) == known) & filled.bit_select(dut.complete_bank, 1))
            with m.If((bank == dut.complete_bank) & (is_edge | (word < HEADER_WORDS))):
                m.d.comb += Assert(fresh_now)
        with m.If(issues & of_start | start):  # number and settings, of the image that began last
            m.d.comb += Assert((age < STEADY_CLOCKS) & (Mux(start, starting, at[bits]) == last))
        with m.If(issues & ~of_start):  # all else, of the one whose motion is known
            m.d.comb += Assert((at[bits] == copying) & due)

        # What it follows from.
        closing = dut.complete & (dut.complete_bank == bank)
        ours = due & (copying == bank)
        end_of_pass = hot == 1 << (HEADER_WORDS - 1)
        longest = EDGE_WORDS * MAX_EDGES + 2
        m.d.comb += [
            Assert(state < 5),
            Assert(dut["waiting"] == (waits[0] == ended) + (waits[1] == ended)),
            Assert((dut["waiting"] == 0) | (dut["queue"][0] == oldest)),
            Assert(~both | (dut["queue"][1] != oldest)),
            Assert(~within | (of(last) == begun)),
            Assert((waits[0] != begun) | (within & ~last)),
            Assert((waits[1] != begun) | (within & last)),
            Assert(~started | (of(starting) != free)),
            Assert(~start | (of(starting) != free)),
            Assert(~due | (of(copying) == known)),
            Assert(~dut.complete | (wait & ~due & ~hot.any())),
            Assert((waits[0] != known) | (due & ~copying) | (dut.complete & ~dut.complete_bank)),
            Assert((waits[1] != known) | (due & copying) | (dut.complete & dut.complete_bank)),
            Assert(~(edges | header | completes) | due),
            Assert(~edges | ~logged),
            Assert(~(header | completes) | (logged & filled.bit_select(copying, 1))),
            Assert(~logged | due),
            Assert(~(header | completes | edges) | ~(started & (starting == copying))),
            Assert(~dut.complete | ~((started | start) & (starting == dut.complete_bank))),
            Assert(~start | (starting == last)),
            Assert(~started | (starting == last)),
            Assert(~(start & started) | (step == 0)),
            Assert(~(start & ~started) | (step != 0)),
            Assert(~(start | header) | (step < HEADER_WORDS)),
            Assert(~completes | (step == HEADER_WORDS)),
            # A pass: word by word through `hot`.
            Assert((hot & (hot - 1)) == 0),
            Assert(~(start | header | edges) | (step != 0) | ~hot.any()),
            Assert(
                ~wait
                | ~hot.any()
                | (end_of_pass & (at == Cat(Const(HEADER_WORDS - 1, bits), starting)) & wanted & ~started)
                | (
                    hot[HEADER_WORDS + EDGE_WORDS - 1]
                    & due
                    & (at == Cat(Const(EDGE_BASE + EDGE_WORDS * MAX_EDGES - 1, bits), copying))
                )
            ),
            Assert(~completes | (end_of_pass & (at == Cat(Const(HEADER_WORDS - 1, bits), copying)) & ~wanted)),
            Assert(~hot.any() | (of(at[bits]) != free)),
            # A begun image does not wait too long.
            Assert(~started | (age <= Mux(edges | header | completes, step + 1, longest))),
            Assert(~start | (age <= longest + 1 + step)),
            Assert(~(wait & end_of_pass) | (age <= longest + 1 + HEADER_WORDS)),
            # What is written so far.
            Assert(~(is_start & ~is_edge & (of(bank) != free)) | there | ((started | start) & (starting == bank))),
            Assert(~(start & (starting == bank) & is_start & (word < step)) | there),
            Assert(~(header & ours & ~is_edge & ~is_start & (word < step)) | there),
            Assert(~((completes & ours | closing) & ~is_edge & (word < HEADER_WORDS)) | there),
            Assert(~(edges & ours & is_edge & (edge < step)) | there),
            Assert(~((logged & ours | closing) & is_edge) | there),
        ]
        with m.If((start | header) & (step != 0)):
            m.d.comb += [
                Assert(hot == (1 << (step - 1)[:5])[: len(hot)]),
                Assert(wanted == start),
                Assert(at == Cat((step - 1)[:5], 0, Mux(start, starting, copying))),
            ]
        with m.If(edges & (step != 0)):
            m.d.comb += [
                Assert(hot == Mux(step[0], 1 << HEADER_WORDS, 2 << HEADER_WORDS)),
                Assert(at == Cat((step - 1)[:5], 1, copying)),
            ]
        return m


def test_headers_are_never_torn():
    prove(HeaderIsWhole(), "prove", 2)
