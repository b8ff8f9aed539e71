"""The card on a board: the core with its pins, its clock and its link."""

from collections.abc import Callable
from typing import Protocol

from amaranth.hdl import ClockDomain, Elaboratable, Module, Signal
from amaranth.lib import io
from amaranth.lib.wiring import connect

from .camera.pins import Camera
from .core import Core
from .features import EVERYTHING, Features
from .link.uart import Uart
from .link.usb import FULL_SPEED_BYTES, HIGH_SPEED_BYTES, UsbSerial, direct_pins, ulpi

PINS = {
    "encoder": {"a": "encoder_a", "b": "encoder_b", "index": "index"},
    "interlock": {"closed": "interlock"},
    "motor": {"pwm": "pwm", "direction": "direction", "brake": "brake"},
    "laser": {"enable": "laser", "lamp": "lamp"},
}
"""Resources that a board must have, and the members of the core that their subsignals are."""

OPTIONAL = ("direction", "brake")
"""Subsignals that a board may lack: a motor's driver can do without."""


class Source(Protocol):
    """A component with the members ``video: Out(Video())`` and ``run: In(1)``."""

    video: object
    run: Signal


Link = Callable[[Module, object, Core, int], None]
"""Adds the physical link to a card's module: its pins, and its bytes to and from the core, whose clock it is told."""


def uart(baud: int, *, flow_control: bool = False) -> Link:
    """A serial line on the board's resource ``uart``: ``rx``, ``tx``, with ``flow_control`` also ``rts``, ``cts``.

    ``baud`` is at most a quarter of the clock.
    """

    def add(m: Module, platform, core: Core, clock_hz: int) -> None:
        port = platform.request("uart", 0, dir="-")
        line = Uart(clock_hz, baud, flow_control=flow_control)
        m.submodules.uart = line
        pins = {"rx": "i", "tx": "o"} | ({"rts": "o", "cts": "i"} if flow_control else {})
        for name, direction in pins.items():
            m.submodules[f"uart_{name}"] = buffer = io.Buffer(direction, getattr(port, name))
            m.d.comb += getattr(line, name).eq(buffer.i) if direction == "i" else buffer.o.eq(getattr(line, name))
        connect(m, line.o, core.rx)
        connect(m, core.tx, line.i)
        m.d.comb += [core.line_errors.eq(line.errors), core.link_baud.eq(baud)]

    return add


def usb(serial: int, *, high_speed: bool = False) -> Link:
    """USB CDC-ACM on the board's resource ``usb``, or with ``high_speed`` on ``ulpi``.

    ``serial`` is what the host sees as the device's serial number. The board has the domains that
    :class:`~gateware.link.usb.UsbSerial` names; with ULPI the PHY drives the only one.
    """

    def add(m: Module, platform, core: Core, clock_hz: int) -> None:
        if high_speed:
            m.domains.usb = ClockDomain()
        bus = (ulpi if high_speed else direct_pins)(m, platform)
        size = HIGH_SPEED_BYTES if high_speed else FULL_SPEED_BYTES
        m.submodules.usb = port = UsbSerial(bus, f"{serial:016x}", size)
        connect(m, port.o, core.rx)
        connect(m, core.tx, port.i)

    return add


class Card(Elaboratable):
    """Asks the board for ``encoder``, ``interlock``, ``motor``, ``laser`` and what the link needs.

    Parameters
    ----------
    source : where the images come from: a component, or a camera on the board's pins, by
        :func:`~gateware.camera.pins.camera_dvp` or :func:`~gateware.camera.pins.camera_rgb`
    pixel_domain : of its images, as of :class:`~gateware.core.Core`
    link : :func:`uart` or :func:`usb`
    clock_hz : frequency of the ``sync`` domain
    serial : serial number of the card, 64 bits; 0: it has none
    features : what it is built with
    """

    def __init__(
        self,
        source: Source | Camera,
        link: Link,
        *,
        clock_hz: int,
        serial: int = 0,
        pixel_domain: str = "sync",
        features: Features = EVERYTHING,
    ) -> None:
        self.source = source
        self.link = link
        self.serial = serial
        self.clock_hz = clock_hz
        self.core = Core(features, pixel_domain)

    def elaborate(self, platform):
        m = Module()
        m.submodules.core = core = self.core
        source = self.source(m, platform, core, self.clock_hz) if callable(self.source) else self.source
        m.submodules.source = source
        connect(m, source.video, core.video)
        m.d.comb += [source.run.eq(core.run), core.clock_hz.eq(self.clock_hz), core.serial.eq(self.serial)]
        self.link(m, platform, core, self.clock_hz)

        for resource, pins in PINS.items():
            port = platform.request(resource, 0, dir="-")
            for pin, member in pins.items():
                if pin in OPTIONAL and not hasattr(port, pin):
                    continue
                inner = getattr(core, member)
                direction = "i" if member in ("encoder_a", "encoder_b", "index", "interlock") else "o"
                buffer = io.Buffer(direction, getattr(port, pin))
                m.submodules[f"{resource}_{pin}"] = buffer
                m.d.comb += inner.eq(buffer.i) if direction == "i" else buffer.o.eq(inner)
        return m
