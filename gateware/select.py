"""Multiplexers with many inputs."""

from collections.abc import Sequence
from functools import reduce
from operator import or_

from amaranth.hdl import Value, ValueLike


def one_of(values: Sequence[ValueLike], hot: Value) -> Value:
    """The value whose bit of ``hot`` is set; 0 where none is.

    Two thirds of a LUT for each bit that is no constant, if ``hot`` comes straight from registers; else Yosys finds
    out what it depends on and makes twice as much of it, as it does of a ``Switch``.
    """
    listed = [Value.cast(value) for value in values]
    assert len(listed) <= len(hot)
    return reduce(or_, (value & bit.replicate(len(value)) for value, bit in zip(listed, hot, strict=False)))
