"""The whole card without clocks, pins and link."""

from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .layouts import Bytes, Video


class Core(wiring.Component):
    """Pixels, encoder and commands in; motor, laser and packets out.

    Parameters
    ----------
    max_columns : columns that an image may have, 32 to 2048
    max_rows : rows of an image that are stored, a power of two from 2 to 2048

    Members
    -------
    video : images; see :class:`~gateware.layouts.Video` for the source's contract
    encoder_a, encoder_b, index, interlock : pins, asynchronous
    pwm, direction, brake : motor driver
    laser, lamp : laser enable and its warning lamp; low at reset
    clock_hz : frequency of the ``sync`` domain, constant
    rx, tx : bytes from and to the host
    run : the host wants images; a source that can be held waits for it
    """

    def __init__(self, max_columns: int = 2048, max_rows: int = 2048) -> None:
        if not 32 <= max_columns <= 2048:
            raise ValueError(f"max_columns is {max_columns}; 32 to 2048 are possible")
        if max_rows not in [1 << n for n in range(1, 12)]:
            raise ValueError(f"max_rows is {max_rows}; powers of two from 2 to 2048 are possible")
        self.max_columns = max_columns
        self.max_rows = max_rows
        super().__init__(
            {
                "video": In(Video()),
                "encoder_a": In(1),
                "encoder_b": In(1),
                "index": In(1),
                "interlock": In(1),
                "pwm": Out(1),
                "direction": Out(1),
                "brake": Out(1),
                "laser": Out(1),
                "lamp": Out(1),
                "clock_hz": In(32),
                "rx": In(Bytes),
                "tx": Out(Bytes),
                "run": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.d.sync += self.run.eq(0)
        return m
