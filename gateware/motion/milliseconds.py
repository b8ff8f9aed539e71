"""A strobe every millisecond, at whatever frequency the clock has."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out


class Milliseconds(wiring.Component):
    """Divides the clock by ``clock_hz / 1000``, exactly in the long run, also where that is no whole number.

    Strobes are ``clock_hz // 1000`` or one more clocks apart; the first ones come in the three clocks after reset.
    No divider: 1000 is taken away every clock, and ``clock_hz`` added when there is nothing left.

    Members
    -------
    clock_hz : frequency of the clock, constant in operation, at least 2000
    tick : strobe
    """

    clock_hz: In(32)
    tick: Out(1)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        # One addition a clock, and the sign is the comparison. After `clock_hz` is added, 1000 is taken away twice.
        rest = Signal(signed(34))
        change = Signal(signed(34))
        full = Signal()
        m.d.comb += full.eq((rest < 0) & ~self.tick)
        m.d.sync += [
            self.tick.eq(full),
            rest.eq(rest + change),
            change.eq(self.clock_hz),
        ]
        with m.If(~full):  # but for some bits, as the flip-flop's own set or reset
            m.d.sync += change.eq(Mux(self.tick, -2000, -1000))
        return m
