"""Radiona ULX3S: FTDI UART at 1 Mbaud, test picture, the rest on the GPIO header.

``python -m boards.ulx3s`` builds ``build/ulx3s/top.bit``. Wiring, 3.3 V:

- gp0 encoder A, gp1 encoder B, gp2 index, gp3 interlock (closed pulls it high)
- gp7 PWM, gp8 direction, gp9 brake
- gp10 laser enable, gp11 lamp

The laser driver needs a pull-down of its own at its enable input: before configuration the pins float.
"""

from typing import ClassVar

from amaranth.build import Attrs, Pins, Resource, Subsignal
from amaranth_boards.ulx3s import ULX3S_85F_Platform

from gateware.camera.pattern import Pattern
from gateware.card import Card


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


def card() -> Card:
    """What the board runs."""
    return Card(Pattern(640, 480), baud=1_000_000, max_rows=1024)


if __name__ == "__main__":
    Platform().build(card(), build_dir="build/ulx3s")
