"""Radiona ULX3S: test picture, FTDI UART at 1 Mbaud or USB of its own, the rest on the GPIO header.

``python -m boards.ulx3s [uart|usb]`` builds ``build/ulx3s/top.bit`` or ``build/ulx3s-usb/top.bit``. Wiring, 3.3 V:

- gp0 encoder A, gp1 encoder B, gp2 index, gp3 interlock (closed pulls it high)
- gp7 PWM, gp8 direction, gp9 brake
- gp10 laser enable, gp11 lamp
- the connector US2, for USB

The laser driver needs a pull-down of its own at its enable input: before configuration the pins float.
"""

import sys
from typing import ClassVar

from amaranth.build import Attrs, Pins, Resource, Subsignal
from amaranth.hdl import ClockSignal, Elaboratable, Instance, Module, Signal
from amaranth.lib.cdc import ResetSynchronizer
from amaranth_boards.ulx3s import ULX3S_85F_Platform

from gateware.camera.pattern import Pattern
from gateware.card import Card, uart, usb
from gateware.features import Features

SERIAL = 1
"""Serial number of the card; give each board one of its own."""


def _gpio(name: str, direction: str, /, **pins: str) -> Resource:
    signals = (Subsignal(pin, Pins(place, dir=direction, conn=("gpio", 0))) for pin, place in pins.items())
    return Resource(name, 0, *signals, Attrs(IO_TYPE="LVCMOS33", PULLMODE="DOWN"))


class Platform(ULX3S_85F_Platform):
    """The board with what is wired to its header."""

    resources: ClassVar = [
        *ULX3S_85F_Platform.resources,
        _gpio("encoder", "i", a="0+", b="1+", index="2+"),
        _gpio("interlock", "i", closed="3+"),
        _gpio("motor", "o", pwm="7+", direction="8+", brake="9+"),
        _gpio("laser", "o", enable="10+", lamp="11+"),
    ]


class UsbClocks(Elaboratable):
    """Clocks of the domains ``usb_io``, 48 MHz, and ``usb``, 12 MHz, in phase, from the board's 25 MHz."""

    def elaborate(self, platform):
        m = Module()
        locked, feedback = Signal(), Signal()
        usb_io_clock, usb_clock = Signal(), Signal()
        m.submodules.pll = Instance(
            "EHXPLLL",
            # 25 MHz / 5 = 5 MHz is compared with CLKOS2; the oscillator runs at 96 times that.
            p_CLKI_DIV=5,
            p_CLKFB_DIV=1,
            p_FEEDBK_PATH="CLKOS2",
            **{f"p_{output}_ENABLE": "ENABLED" for output in ("CLKOP", "CLKOS", "CLKOS2")},
            p_CLKOP_DIV=10,
            p_CLKOS_DIV=40,
            p_CLKOS2_DIV=96,
            **{f"p_{output}_FPHASE": 0 for output in ("CLKOP", "CLKOS", "CLKOS2")},
            # So that all edges coincide.
            p_CLKOP_CPHASE=9,
            p_CLKOS_CPHASE=39,
            p_CLKOS2_CPHASE=95,
            i_CLKI=ClockSignal("sync"),
            i_CLKFB=feedback,
            **{f"i_{name}": 0 for name in ("RST", "STDBY", "PHASESEL0", "PHASESEL1", "PHASEDIR", "PHASESTEP")},
            i_PHASELOADREG=0,
            i_PLLWAKESYNC=0,
            i_ENCLKOP=0,
            o_CLKOP=usb_io_clock,
            o_CLKOS=usb_clock,
            o_CLKOS2=feedback,
            o_LOCK=locked,
        )
        for domain, clock in (("usb_io", usb_io_clock), ("usb", usb_clock)):
            m.d.comb += ClockSignal(domain).eq(clock)
            m.submodules[f"reset_{domain}"] = ResetSynchronizer(~locked, domain=domain)
        return m


def _usb(m: Module, platform: Platform, core) -> None:
    m.submodules.usb_clocks = UsbClocks()
    usb(SERIAL)(m, platform, core)


LINKS = {"uart": uart(1_000_000), "usb": _usb}


def card(link: str = "uart") -> Card:
    """What the board runs."""
    return Card(Pattern(640, 480), LINKS[link], serial=SERIAL, features=Features(max_rows=1024))


if __name__ == "__main__":
    chosen = sys.argv[1] if len(sys.argv) > 1 else "uart"
    Platform().build(card(chosen), build_dir="build/ulx3s" if chosen == "uart" else f"build/ulx3s-{chosen}")
