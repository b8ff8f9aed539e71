"""Whether the angle is inside the sector that may be lit."""

from amaranth.hdl import Cat, Module, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out


class Sector(wiring.Component):
    """Compares the position with a sector, whole turns apart or not.

    Inside is ``low <= position + k * counts_per_turn <= high`` for a k of -1, 0, 1: as the zero is a pass of the
    index, the position lies within a turn of it. Without a pass, nothing is inside.
    Latency :attr:`latency` clocks; throughput one a clock.

    Members
    -------
    position : counts from the zero
    seen : the index has been passed
    counts_per_turn : 0: no turns
    low, high : the sector, both in it
    inside : see above
    """

    position: In(signed(32))
    seen: In(1)
    counts_per_turn: In(24)
    low: In(signed(32))
    high: In(signed(32))
    inside: Out(1)

    latency = 3

    @staticmethod
    def reference(position: int, seen: bool, counts_per_turn: int, low: int, high: int) -> bool:
        """The definition."""
        return seen and any(low <= position + k * counts_per_turn <= high for k in (-1, 0, 1))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        within = []
        for name, turns in (("less", -1), ("same", 0), ("more", 1)):
            moved, above, below = (
                Signal(signed(34), name=name),
                Signal(name=f"{name}_above"),
                Signal(name=f"{name}_below"),
            )
            m.d.sync += [
                moved.eq(self.position + turns * self.counts_per_turn if turns else self.position),
                above.eq(moved >= self.low),
                below.eq(moved <= self.high),
            ]
            within.append(above & below)
        m.d.sync += self.inside.eq(Cat(within).any() & self.seen)
        return m
