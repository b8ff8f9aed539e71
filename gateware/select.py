"""Multiplexers with many inputs."""

from collections.abc import Sequence
from functools import reduce
from operator import or_

from amaranth.hdl import Module, Value, ValueLike
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out


def one_of(values: Sequence[ValueLike], hot: Value) -> Value:
    """The value whose bit of ``hot`` is set; 0 where none is.

    Two thirds of a LUT for each bit that is no constant, if ``hot`` comes straight from registers; else Yosys finds
    out what it depends on and makes twice as much of it, as it does of a ``Switch``.
    """
    listed = [Value.cast(value) for value in values]
    assert len(listed) <= len(hot)
    return reduce(or_, (value & bit.replicate(len(value)) for value, bit in zip(listed, hot, strict=False)))


class Picked(wiring.Component):
    """:func:`one_of` in a register.

    Cells of an ECP5 do it in half as much, of which a board's platform knows: see :meth:`boards.ecp5.Ecp5.get_picked`.
    A platform that has the method ``get_picked(picked)`` returns what takes this component's place.

    Parameters
    ----------
    bits : of a value
    count : of values

    Members
    -------
    i : values
    which : straight from registers, at most one bit is set
    enable : the register moves
    o : the value whose bit of ``which`` was set when it last moved; 0 if none was
    """

    def __init__(self, bits: int, count: int) -> None:
        self.bits = bits
        self.count = count
        super().__init__({"i": In(bits).array(count), "which": In(count), "enable": In(1), "o": Out(bits)})

    def elaborate(self, platform):
        if hasattr(platform, "get_picked"):
            return platform.get_picked(self)
        m = Module()
        with m.If(self.enable):
            m.d.sync += self.o.eq(one_of(self.i, self.which))
        return m
