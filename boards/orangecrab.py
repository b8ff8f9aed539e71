"""OrangeCrab r0.2 with an LFE5U-25F or 85F: a small board, and as many pins as a card needs with its camera."""

from amaranth_boards import orangecrab_r0_2

from .board import Board

WIRING = {
    "encoder": {"a": "io_0:a2", "b": "io_0:a3", "index": "io_0:a4"},
    "interlock": {"closed": "io_0:cipo"},
    "motor": {"pwm": "io_0:copi"},
    "laser": {"enable": "io_0:sck", "lamp": "~M3"},
    "camera": {
        "d": " ".join(f"io_0:{pin}" for pin in ("0", "1", "6", "9", "10", "11", "12", "13")),
        "pclk": "io_0:5",
        "href": "io_0:a0",
        "vsync": "io_0:a1",
        "scl": "io_0:scl",
        "sda": "io_0:sda",
    },
}


def label(place: str) -> str:
    named = {"cipo": "MISO", "copi": "MOSI", "M3": "green of the LED on the board"}
    pin = place.removeprefix("io_0:")
    return named.get(pin, pin.upper())


BOARDS = [
    Board(
        name=f"orangecrab-{size.lower()}",
        title=f"OrangeCrab r0.2, LFE5U-{size}-8",
        platform=getattr(orangecrab_r0_2, f"OrangeCrabR0_2_{size}Platform"),
        family="ecp5",
        sync_hz=60_000_000,
        wiring=WIRING,
        label=label,
        links={"usb": "its USB-C connector"},
        program=("--board", "orangeCrab"),
        about="""The camera needs an oscillator of its own, and resistors at RESET# (up) and PWDN (down). The motor's
driver gets its direction from the duty alone, locked anti-phase: `magtrak set motor_bridge=1`. To program it, hold the
button while plugging it in: its boot loader takes the bitstream.""",
        source="amaranth-boards",
    )
    for size in ("25F", "85F")
]
