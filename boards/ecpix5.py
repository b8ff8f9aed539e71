"""LambdaConcept ECPIX-5 with an LFE5UM5G-45F or 85F."""

from amaranth_boards import ecpix5

from .board import Board

WIRING = {
    "encoder": {"a": "pmod_0:1", "b": "pmod_0:2", "index": "pmod_0:3"},
    "interlock": {"closed": "pmod_0:7"},
    "motor": {"pwm": "pmod_1:1", "direction": "pmod_1:2", "brake": "pmod_1:3"},
    "laser": {"enable": "pmod_1:7", "lamp": "pmod_1:8"},
    "camera": {
        "d": " ".join(f"pmod_6:{pin}" for pin in (1, 2, 3, 4, 7, 8, 9, 10)),
        "pclk": "pmod_7:7",
        "href": "pmod_7:2",
        "vsync": "pmod_7:3",
        "xclk": "pmod_7:1",
        "reset": "~pmod_7:4",
        "scl": "pmod_7:8",
        "sda": "pmod_7:9",
        "powerdown": "pmod_7:10",
    },
}


def label(place: str) -> str:
    number, pin = place.removeprefix("pmod_").split(":")
    return f"PMOD{number} pin {pin}"


BOARDS = [
    Board(
        name=f"ecpix5-{size}f",
        title=f"LambdaConcept ECPIX-5, LFE5UM5G-{size}F-8",
        platform=getattr(ecpix5, f"ECPIX5{size}Platform"),
        family="ecp5",
        sync_hz=60_000_000,
        wiring=WIRING,
        label=label,
        links={"uart": "the micro-USB connector (an FT2232H, its second port)"},
        program=("--board", "ecpix5"),
        about="Camera on PMOD6 and PMOD7, encoder and interlock on PMOD0, motor and laser on PMOD1.",
        source="amaranth-boards",
    )
    for size in ("45", "85")
]
