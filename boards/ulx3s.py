"""Radiona ULX3S with an LFE5U-12F, 25F, 45F or 85F."""

from amaranth_boards import ulx3s

from gateware.features import FEWER_CELLS, Features

from .board import ROWS_1024, Board

WIRING = {
    "encoder": {"a": "gpio_0:0+", "b": "gpio_0:1+", "index": "gpio_0:2+"},
    "interlock": {"closed": "gpio_0:3+"},
    "motor": {"pwm": "gpio_0:7+", "direction": "gpio_0:8+", "brake": "gpio_0:9+"},
    # GP11 to GP13 are the ESP32's as well.
    "laser": {"enable": "gpio_0:10+", "lamp": "gpio_0:10-"},
    "camera": {
        "d": " ".join(f"gpio_0:{pin}" for pin in ("18+", "18-", "19+", "19-", "20+", "20-", "21+", "21-")),
        "pclk": "gpio_0:17+",  # the only one of J2 that is near a clock's entry
        "href": "gpio_0:22+",
        "vsync": "gpio_0:22-",
        "xclk": "gpio_0:23+",
        "reset": "~gpio_0:23-",
        "scl": "gpio_0:24+",
        "sda": "gpio_0:24-",
        "powerdown": "gpio_0:25+",
    },
}


def label(place: str) -> str:
    pin = place.removeprefix("gpio_0:")
    number = int(pin[:-1])
    return f"{'J1' if number < 14 else 'J2'} G{'P' if pin[-1] == '+' else 'N'}{number}"


BOARDS = [
    Board(
        name=f"ulx3s-{size.lower()}",
        title=f"Radiona ULX3S, LFE5U-{size}-6",
        platform=getattr(ulx3s, f"ULX3S_{size}_Platform"),
        family="ecp5",
        sync_hz=60_000_000,
        wiring=WIRING,
        label=label,
        links={"uart": "connector US1 (an FT231X)", "usb": "connector US2"},
        program=("--board", "ulx3s"),
        about="Camera on J2, everything else on J1. US1 gives power, programs the board, and is the serial port.",
        source="amaranth-boards, and the board's constraints, github.com/emard/ulx3s, doc/constraints/ulx3s_v20.lpf",
        features=Features(max_rows=512, background_cells=FEWER_CELLS) if size == "12F" else ROWS_1024,
    )
    for size in ("12F", "25F", "45F", "85F")
]
