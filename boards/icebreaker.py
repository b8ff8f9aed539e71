"""1BitSquared iCEBreaker with an iCE40UP5K: a small card."""

from amaranth_boards.icebreaker import ICEBreakerPlatform

from gateware.features import Features

from .board import Board

WIRING = {
    "encoder": {"a": "pmod_2:1", "b": "pmod_2:2", "index": "pmod_2:3"},
    "interlock": {"closed": "pmod_2:4"},
    "motor": {"pwm": "pmod_2:7", "direction": "pmod_2:8"},
    "laser": {"enable": "pmod_2:9", "lamp": "pmod_2:10"},
    "camera": {
        "d": " ".join(f"pmod_1:{pin}" for pin in (1, 2, 3, 4, 7, 8, 9, 10)),
        "pclk": "pmod_0:10",  # the pin with a global buffer
        "href": "pmod_0:2",
        "vsync": "pmod_0:3",
        "xclk": "pmod_0:1",
        "reset": "~pmod_0:4",
        "scl": "pmod_0:7",
        "sda": "pmod_0:8",
        "powerdown": "pmod_0:9",
    },
}


def label(place: str) -> str:
    number, pin = place.removeprefix("pmod_").split(":")
    return f"{('PMOD1A', 'PMOD1B', 'PMOD2')[int(number)]} pin {pin}"


BOARDS = [
    Board(
        name="icebreaker",
        title="1BitSquared iCEBreaker, iCE40UP5K",
        platform=ICEBreakerPlatform,
        family="ice40",
        sync_hz=24_000_000,
        wiring=WIRING,
        label=label,
        links={"uart": "its USB connector (an FT2232H, its second port)"},
        program=("--board", "ice40_generic"),
        about="""Camera on PMOD1A and PMOD1B, everything else on PMOD2. An iCE40 has no pull-downs: encoder, index
and interlock each need a resistor of 10 kohm to ground, without which an open interlock may look closed.""",
        source="amaranth-boards",
        picture=(320, 240),
        features=Features(
            max_columns=640,
            max_rows=64,
            background_cells=0,
            isolate=False,
            window=False,
            runs=False,
            speed_loop=False,
            snapshot=False,
            edge_log=False,
            full_rows=False,
            turn_check=False,
            pwm_period=False,
            notes=False,
            close_images=False,
            fast_clock=False,
        ),
    )
]
