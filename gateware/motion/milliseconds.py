"""A strobe every millisecond, at whatever frequency the clock has."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out


class Milliseconds(wiring.Component):
    """Divides the clock by ``clock_hz / 1000``, exactly in the long run, also where that is no whole number.

    Strobes are ``clock_hz // 1000`` or one more clocks apart; the first ones come in the three clocks after reset.
    No divider: 1000 is added every clock, and ``clock_hz`` taken away when it is reached.

    Members
    -------
    clock_hz : frequency of the clock, constant in operation, at least 2000
    tick : strobe
    """

    clock_hz: In(32)
    tick: Out(1)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        # Kept below zero until the millisecond is full: the sign is the comparison, and one addition a clock is all.
        rest, full = Signal(signed(34)), Signal(signed(34))
        m.d.sync += [
            full.eq(1000 - self.clock_hz),
            rest.eq(rest + Mux(rest >= 0, full, 1000)),
            self.tick.eq(rest >= 0),
        ]
        return m
