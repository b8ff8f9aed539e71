"""The card on a board: the core with its pins, its clock and its link."""

from typing import Protocol

from amaranth.hdl import Elaboratable, Module, Signal
from amaranth.lib import io
from amaranth.lib.wiring import connect

from .core import Core
from .link.uart import UartReceiver, UartTransmitter

_PINS = {
    "encoder": {"a": "encoder_a", "b": "encoder_b", "index": "index"},
    "interlock": {"closed": "interlock"},
    "motor": {"pwm": "pwm", "direction": "direction", "brake": "brake"},
    "laser": {"enable": "laser", "lamp": "lamp"},
}
"""Resources that a board must have, and the members of the core that their subsignals are."""


class Source(Protocol):
    """A component with the members ``video: Out(Video())`` and ``run: In(1)``."""

    video: object
    run: Signal


class Card(Elaboratable):
    """Asks the board for ``uart``, ``encoder``, ``interlock``, ``motor`` and ``laser``; runs on its default clock.

    Parameters
    ----------
    source : where the images come from
    baud : rate of the UART, at most an eighth of the clock
    max_columns, max_rows : as in :class:`~gateware.core.Core`
    """

    def __init__(self, source: Source, *, baud: int, max_columns: int = 2048, max_rows: int = 2048) -> None:
        self.source = source
        self.baud = baud
        self.core = Core(max_columns, max_rows)

    def elaborate(self, platform):
        m = Module()
        m.submodules.core = core = self.core
        m.submodules.source = source = self.source
        connect(m, source.video, core.video)
        clock_hz = round(platform.default_clk_frequency)
        m.d.comb += [source.run.eq(core.run), core.clock_hz.eq(clock_hz)]

        uart = platform.request("uart", 0, dir="-")
        m.submodules.rx_pin = rx_pin = io.Buffer("i", uart.rx)
        m.submodules.tx_pin = tx_pin = io.Buffer("o", uart.tx)
        m.submodules.receiver = receiver = UartReceiver(clock_hz, self.baud)
        m.submodules.transmitter = transmitter = UartTransmitter(clock_hz, self.baud)
        connect(m, receiver.o, core.rx)
        connect(m, core.tx, transmitter.i)
        m.d.comb += [receiver.rx.eq(rx_pin.i), tx_pin.o.eq(transmitter.tx)]

        for resource, pins in _PINS.items():
            port = platform.request(resource, 0, dir="-")
            for pin, member in pins.items():
                inner = getattr(core, member)
                direction = "i" if member in ("encoder_a", "encoder_b", "index", "interlock") else "o"
                buffer = io.Buffer(direction, getattr(port, pin))
                m.submodules[f"{resource}_{pin}"] = buffer
                m.d.comb += inner.eq(buffer.i) if direction == "i" else buffer.o.eq(inner)
        return m
