"""USB CDC-ACM: the card as a serial port of its own, through LUNA.

LUNA still uses what Amaranth 0.6 will no longer have; nothing of it leaves this file.
"""

import warnings
from types import SimpleNamespace

from amaranth.hdl import Module
from amaranth.lib import io, wiring
from amaranth.lib.fifo import AsyncFIFOBuffered
from amaranth.lib.wiring import In, Out, connect, flipped

from ..layouts import Bytes

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from luna.gateware.interface.utmi import UTMIInterface
    from luna.gateware.usb.devices.acm import USBSerialDevice

VENDOR, PRODUCT = 0x1209, 0x0001
"""pid.codes' identity for tests: a card that is sold needs one of its own."""

FULL_SPEED_BYTES = 64
HIGH_SPEED_BYTES = 512
"""Bytes of a bulk packet at most."""

_CROSSING = 16


class UsbSerial(wiring.Component):
    """Bytes from and to a USB host, as from a serial port.

    A short packet goes to the host after each zero byte, so that no packet of ours waits for others to fill one of
    USB's. While the host takes nothing, neither does ``i``. Bytes that come find room, or their packet is
    refused and sent again by the host: none gets lost.

    LUNA runs in the domain ``usb``: 12 MHz from direct pins, and ``usb_io`` of 48 MHz in phase with it; 60 MHz, the
    clock of the PHY, for ULPI. The ``sync`` domain may be any.

    Parameters
    ----------
    bus : :func:`direct_pins`, :func:`ulpi` or :func:`utmi`
    serial : the serial number that the host sees
    packet_bytes : :data:`FULL_SPEED_BYTES`, or :data:`HIGH_SPEED_BYTES` for ULPI

    Members
    -------
    o : bytes received
    i : bytes to send
    """

    o: Out(Bytes)
    i: In(Bytes)

    def __init__(self, bus: object, serial: str, packet_bytes: int = FULL_SPEED_BYTES) -> None:
        self.bus = bus
        self.serial = serial
        self.packet_bytes = packet_bytes
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            device = USBSerialDevice(
                bus=self.bus,
                idVendor=VENDOR,
                idProduct=PRODUCT,
                manufacturer_string="Magtrak",
                product_string="Magtrak card",
                serial_number=self.serial,
                max_packet_size=self.packet_bytes,
            )
        m.submodules.device = device
        m.submodules.to_host = to_host = AsyncFIFOBuffered(width=8, depth=_CROSSING, r_domain="usb", w_domain="sync")
        m.submodules.from_host = from_host = AsyncFIFOBuffered(
            width=8, depth=_CROSSING, r_domain="sync", w_domain="usb"
        )
        connect(m, flipped(self.i), to_host.w_stream)
        connect(m, from_host.r_stream, flipped(self.o))
        m.d.comb += [
            device.connect.eq(1),
            device.tx.payload.eq(to_host.r_data),
            device.tx.valid.eq(to_host.r_rdy),
            device.tx.last.eq(to_host.r_data == 0),
            to_host.r_en.eq(device.tx.ready),
            from_host.w_data.eq(device.rx.payload),
            from_host.w_en.eq(device.rx.valid),
            device.rx.ready.eq(from_host.w_rdy),
        ]
        return m


def utmi() -> object:
    """A UTMI bus, 12 MHz and full speed, whose signals a simulation drives."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return UTMIInterface()


def direct_pins(m: Module, platform: object, number: int = 0) -> object:
    """The board's resource ``usb``: ``d_p``, ``d_n`` and, where the board has it, ``pullup``."""
    return _buffers(m, platform.request("usb", number, dir="-"), {"d_p": "io", "d_n": "io", "pullup": "o"})


def ulpi(m: Module, platform: object, number: int = 0) -> object:
    """The board's resource ``ulpi``, whose PHY gives the clock."""
    pins = {"data": "io", "clk": "i", "dir": "i", "nxt": "i", "stp": "o", "rst": "o"}
    return _buffers(m, platform.request("ulpi", number, dir="-"), pins)


def _buffers(m: Module, port: object, pins: dict[str, str]) -> object:
    """A buffer for each pin that the port has, under its name, as LUNA wants them."""
    buffers = {}
    for name, direction in pins.items():
        if hasattr(port, name):
            m.submodules[f"usb_{name}"] = buffers[name] = io.Buffer(direction, getattr(port, name))
    return SimpleNamespace(**buffers)
