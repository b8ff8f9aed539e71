"""Cameras on the pins of a real board's platform: every pin is there, and the pixel clock is constrained."""

from typing import ClassVar

import pytest
from amaranth.build import Attrs, Pins, PinsN, Resource, Subsignal

from boards.ulx3s import Platform
from gateware.camera.ov5640 import OV5640
from gateware.camera.pins import camera_dvp, camera_rgb
from gateware.camera.rgb import Interlace
from gateware.card import Card, uart


def _resource(name: str, first: int, /, **pins: tuple[str, int]) -> Resource:
    """Pins of the board's header, one after the other from ``first``; direction and number of each subsignal."""
    places = iter([f"{n}{sign}" for n in range(first, 28) for sign in "+-"])
    signals = []
    for signal, (direction, width) in pins.items():
        kind = PinsN if signal == "reset" else Pins
        signals.append(
            Subsignal(signal, kind(" ".join(next(places) for _ in range(width)), dir=direction, conn=("gpio", 0)))
        )
    return Resource(name, 0, *signals, Attrs(IO_TYPE="LVCMOS33", PULLMODE="UP"))


DVP = _resource(
    "camera",
    12,
    **{"pclk": ("i", 1), "href": ("i", 1), "vsync": ("i", 1), "d": ("i", 8)},
    **{"scl": ("io", 1), "sda": ("io", 1), "xclk": ("o", 1), "reset": ("o", 1), "powerdown": ("o", 1)},
)
RGB = _resource(
    "video",
    12,
    **{"pclk": ("i", 1), "hs": ("i", 1), "vs": ("i", 1), "de": ("i", 1)},
    **{"r": ("i", 8), "g": ("i", 8), "b": ("i", 8), "field": ("i", 1)},
)


class Board(Platform):
    resources: ClassVar = [*Platform.resources, DVP, RGB]


@pytest.mark.parametrize(
    ("camera", "name", "hz", "pins"),
    [
        (camera_dvp(OV5640, pclk_hz=28e6, xclk_half=1), "camera", 28e6, 16),
        (camera_rgb(pclk_hz=27e6, interlace=Interlace.PIN), "video", 27e6, 29),
    ],
)
def test_a_card_with_a_camera_is_complete(camera, name, hz, pins, monkeypatch, tmp_path):
    for tool in ("YOSYS", "NEXTPNR_ECP5", "ECPPACK", "OPENFPGALOADER"):
        monkeypatch.setenv(tool, "true")
    monkeypatch.chdir(tmp_path)
    plan = Board().build(Card(camera, uart(1_000_000), max_rows=1024), do_build=False)
    constraints = str(plan.files["top.lpf"])
    assert constraints.count(f'LOCATE COMP "{name}_0__') == pins
    assert f'FREQUENCY PORT "{name}_0__pclk__io" {hz} HZ;' in constraints
