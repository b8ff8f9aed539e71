"""The dividers are exact, proved for every dividend and divisor of small widths."""

import pytest
from amaranth.hdl import Assert, Assume, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from gateware.arithmetic import SerialDivider
from tests.support.formal import prove


def possible(dut, dividend, divisor):
    return (divisor != 0) & (dividend < (divisor << dut.quotient_bits))


def exact(dividend, divisor, quotient):
    """Whether the quotient is right, by the definition and not by another division."""
    return (quotient * divisor <= dividend) & (dividend < (quotient + 1) * divisor)


class SerialIsExact(wiring.Component):
    """Divisions that start at any time, also while one is under way."""

    def __init__(self, divisor_bits: int, quotient_bits: int, bits_per_clock: int) -> None:
        self.dut = SerialDivider(divisor_bits, quotient_bits, bits_per_clock)
        super().__init__({"start": In(1), "dividend": In(divisor_bits + quotient_bits), "divisor": In(divisor_bits)})

    def elaborate(self, platform):
        m = Module()
        m.submodules.dut = dut = self.dut
        m.d.comb += [
            dut.start.eq(self.start),
            dut.dividend.eq(self.dividend),
            dut.divisor.eq(self.divisor),
            Assume(possible(dut, self.dividend, self.divisor)),
        ]
        dividend, divisor = Signal.like(self.dividend), Signal.like(self.divisor)
        age = Signal(range(dut.latency + 2), init=dut.latency + 1)  # clocks since the start
        with m.If(self.start):
            m.d.sync += [dividend.eq(self.dividend), divisor.eq(self.divisor), age.eq(1)]
        with m.Elif(age <= dut.latency):
            m.d.sync += age.eq(age + 1)
        m.d.comb += [
            Assert(dut.done == (age == dut.latency)),
            Assert(dut.busy == (age < dut.latency)),
            Assert(~dut.done | exact(dividend, divisor, dut.quotient)),
        ]
        return m


@pytest.mark.parametrize(("quotient_bits", "bits_per_clock"), [(3, 1), (5, 2)])
def test_serial_divider_is_exact(quotient_bits, bits_per_clock):
    """Two whole divisions from reset on, and whatever cuts them off."""
    dut = SerialDivider(3, quotient_bits, bits_per_clock)
    prove(SerialIsExact(3, quotient_bits, bits_per_clock), "bmc", 2 * dut.latency + 3)
