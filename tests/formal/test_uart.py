"""The receiver takes what the transmitter sends, for all bytes, phases and clock ratios within the tolerance."""

from fractions import Fraction

import pytest
from amaranth.hdl import Assert, Assume, Cat, Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from gateware.link.uart import _PHASE_BITS, UartReceiver, _step
from tests.support.formal import ProofError, prove

FRACTION = 16  # bits of the sender's time, in its clocks


class ReceivesWhatIsSent(wiring.Component):
    """Bytes without a pause, from an idle line to the receiver's output.

    ``ratio`` (the sender's clocks per clock of the receiver), ``offset`` (its phase) and ``data`` are free. The
    sender is :class:`~gateware.link.uart.UartTransmitter`'s arithmetic: bits change in the clocks in which its own
    phase wraps, and the phase begins anew with each byte.

    Parameters
    ----------
    clocks_per_bit : nominal, on both sides
    percent : how far the two clocks are apart at most
    count : of bytes
    """

    def __init__(self, clocks_per_bit: Fraction, percent: Fraction, count: int) -> None:
        self.clock_hz = round(clocks_per_bit * 1_000_000)
        self.spread = int(percent / 100 * (1 << FRACTION))
        self.count = count
        self.depth = int(clocks_per_bit * 10 * count) + 14  # the slowest sender has the last byte's middle behind it
        super().__init__({"ratio": In(FRACTION + 1), "offset": In(FRACTION), "data": In(8 * count)})

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = UartReceiver(self.clock_hz, 1_000_000)
        m.d.comb += dut.o.ready.eq(1)

        first = Signal(init=1)
        ratio, time, sent = Signal(FRACTION + 1), Signal(FRACTION), Signal(8 * self.count)
        m.d.sync += first.eq(0)
        with m.If(first):
            m.d.sync += [ratio.eq(self.ratio), time.eq(self.offset), sent.eq(self.data)]
            m.d.comb += [
                Assume(self.ratio >= (1 << FRACTION) - self.spread),
                Assume(self.ratio <= (1 << FRACTION) + self.spread),
            ]

        # The sender's clocks in this clock of the receiver, 0 to 2, and its phase.
        following = Signal(FRACTION + 2)
        ticks = following[FRACTION:]
        step = _step(self.clock_hz, 1_000_000, 1)
        phase, bit = Signal(_PHASE_BITS), Signal(range(10 * self.count + 2))
        later = Signal(_PHASE_BITS + 1)
        m.d.comb += [following.eq(time + ratio), later.eq(phase + (ticks * step)[: _PHASE_BITS + 1])]
        levels = Cat(*(Cat(Const(0, 1), sent.word_select(n, 8), Const(1, 1)) for n in range(self.count)))
        stop = Signal()
        m.d.comb += stop.eq(Cat(bit == 10 * n + 9 for n in range(self.count)).any())
        idle = Signal(range(6), init=5)  # long enough for the receiver to know
        m.d.sync += idle.eq(idle - (idle != 0))
        m.d.comb += dut.rx.eq(1)
        with m.If(~first & (idle == 0)):
            m.d.sync += time.eq(following)
            with m.If(bit < 10 * self.count):
                m.d.comb += dut.rx.eq(levels.bit_select(bit, 1))
                m.d.sync += phase.eq(later)
                with m.If(later[-1]):
                    m.d.sync += bit.eq(bit + 1)
                    with m.If(stop):
                        # Of two clocks that this clock holds, the second may be the new byte's.
                        second = (ticks == 2) & ((phase + step) >> _PHASE_BITS != 0)
                        m.d.sync += phase.eq(Mux(second, step, 0))

        came = Signal(range(self.count + 1))
        clocks = Signal(range(self.depth + 1))
        m.d.sync += clocks.eq(clocks + 1)
        with m.If(dut.o.valid):
            m.d.sync += came.eq(came + 1)
            m.d.comb += [Assert(dut.o.payload == sent.word_select(came, 8)), Assert(came != self.count)]
        m.d.comb += Assert(dut.errors == 0)
        with m.If(clocks == self.depth):
            m.d.comb += Assert(came == self.count)
        return m


@pytest.mark.parametrize(
    ("clocks_per_bit", "percent", "count"),
    [("4", "1.3", 2), ("25/6", "1.3", 1), ("8", "3.3", 1)],
)
def test_every_byte_arrives(clocks_per_bit, percent, count):
    component = ReceivesWhatIsSent(Fraction(clocks_per_bit), Fraction(percent), count)
    prove(component, "bmc", component.depth + 1, timeout_s=900)


def test_the_proof_can_fail():
    component = ReceivesWhatIsSent(Fraction(4), Fraction(8), 1)
    with pytest.raises(ProofError):
        prove(component, "bmc", component.depth + 1, timeout_s=900)
