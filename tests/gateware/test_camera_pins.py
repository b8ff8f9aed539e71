"""A video input on the pins of a real board's platform: every pin is there, and the pixel clock is constrained."""

import warnings

from amaranth.build import Attrs, Pins, Resource, Subsignal

from boards.board import Top
from boards.catalogue import BOARDS
from gateware.camera.pins import camera_rgb
from gateware.camera.rgb import Interlace
from gateware.card import Card, uart


def _resource(name: str, first: int, /, **pins: tuple[str, int]) -> Resource:
    """Pins of the board's header, one after the other from ``first``; direction and number of each subsignal."""
    places = iter([f"{n}{sign}" for n in range(first, 28) for sign in "+-"])
    signals = []
    for signal, (direction, width) in pins.items():
        names = " ".join(next(places) for _ in range(width))
        signals.append(Subsignal(signal, Pins(names, dir=direction, conn=("gpio", 0))))
    return Resource(name, 0, *signals, Attrs(IO_TYPE="LVCMOS33", PULLMODE="UP"))


RGB = _resource(
    "video",
    12,
    **{"pclk": ("i", 1), "hs": ("i", 1), "vs": ("i", 1), "de": ("i", 1)},
    **{"r": ("i", 8), "g": ("i", 8), "b": ("i", 8), "field": ("i", 1)},
)


def test_a_card_with_a_video_input_is_complete():
    """DVP cameras are in ``tests/boards``."""
    board = BOARDS["ulx3s-85f"]
    platform = board.open()
    platform.add_resources([RGB])
    camera = camera_rgb(pclk_hz=27e6, interlace=Interlace.PIN)
    card = Card(camera, uart(1_000_000), clock_hz=board.sync_hz, features=board.features)
    clocks = board.card().clocks
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of amaranth-boards
        plan = platform.build(Top(clocks, card), do_build=False)
    constraints = str(plan.files["top.lpf"])
    assert constraints.count('LOCATE COMP "video_0__') == 29
    assert f'FREQUENCY PORT "video_0__pclk__io" {27e6} HZ;' in constraints
