"""Icepi Zero v1.3 with an LFE5U-25F: as large as a Raspberry Pi Zero, with its header."""

from amaranth_boards.icepi_zero import IcepiZero1_3Platform

from .board import Board

WIRING = {
    "encoder": {"a": "gpio_0:4", "b": "gpio_0:5", "index": "gpio_0:6"},
    "interlock": {"closed": "gpio_0:7"},
    "motor": {"pwm": "gpio_0:12", "direction": "gpio_0:13", "brake": "gpio_0:26"},
    "laser": {"enable": "gpio_0:27", "lamp": "gpio_0:14"},
    "camera": {
        "d": " ".join(f"gpio_0:{pin}" for pin in range(16, 24)),
        "pclk": "gpio_0:9",
        "href": "gpio_0:24",
        "vsync": "gpio_0:25",
        "xclk": "gpio_0:10",
        "reset": "~gpio_0:11",
        "scl": "gpio_0:3",
        "sda": "gpio_0:2",
        "powerdown": "gpio_0:8",
    },
}

_HEADER = (27, 28, 3, 5, 7, 29, 31, 26, 24, 21, 19, 23, 32, 33, 8, 10, 36, 11, 12, 35, 38, 40, 15, 16, 18, 22, 37, 13)
"""Pins of a Raspberry Pi's header at which GPIO0 to GPIO27 are."""


def label(place: str) -> str:
    number = int(place.removeprefix("gpio_0:"))
    return f"GPIO{number} (pin {_HEADER[number]})"


BOARDS = [
    Board(
        name="icepi-zero",
        title="Icepi Zero v1.3, LFE5U-25F-6",
        platform=IcepiZero1_3Platform,
        family="ecp5",
        sync_hz=60_000_000,
        wiring=WIRING,
        label=label,
        links={"uart": "the USB-C connector of its FT231X"},
        program=("--board", "icepi-zero"),
        about="All is on the 40-pin header; numbers in brackets are those of its pins.",
        source="amaranth-boards",
    )
]
