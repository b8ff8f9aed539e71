"""What every board shares: its clocks, its links, its source of images, and how Yosys and nextpnr are called."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from amaranth.build import Platform
from amaranth.hdl import ClockDomain, DomainRenamer, Elaboratable, Module
from amaranth.vendor import LatticeECP5Platform, SiliconBluePlatform

from gateware.camera.ov2640 import OV2640
from gateware.camera.ov5640 import OV5640
from gateware.camera.ov7670 import OV7670
from gateware.camera.pattern import Pattern
from gateware.camera.pins import Camera, camera_dvp
from gateware.camera.sensor import SensorTable
from gateware.card import Card, Link, Source, uart, usb
from gateware.features import Features

from . import synthesis, wiring
from .clocks import Ecp5Clocks, Ice40Clocks
from .ecp5 import Ecp5
from .errors import BoardError

BAUD = 3_000_000
"""Of every UART: what an FT231X can, and what the host tries first."""

IMAGES_HZ = 60
"""Rate of the test picture."""

ROWS_1024 = Features(max_rows=1024)
"""Everything, for images of up to 1024 rows."""

LEAN = "-lean"
"""Behind a board's name: with a lean card."""

LEFT_OUT = ("speed_loop", "snapshot", "edge_log", "turn_check", "notes", "pwm_period", "full_rows")
"""Of :class:`~gateware.features.Features`, what a lean card is built without."""

SERIAL = 1
"""Serial number of the card; ``SERIAL=`` of ``make bitstream`` gives each one of its own."""

PLACEMENT = "--report report.json --seed {seed} --timing-allow-fail"
"""Options of nextpnr; that timing is met is checked afterwards, in the report."""


LINKS: dict[str, Callable[[int], Link]] = {"uart": lambda serial: uart(BAUD), "usb": usb}
"""Physical links by name, each made for a serial number."""


def _pattern(board: "Board") -> Source:
    return Pattern(*board.picture, period=board.sync_hz // IMAGES_HZ)


PIXEL_HZ = {"pattern-1080p": 150_000_000}
"""Sources whose pixels have a clock of their own, the domain ``pixel``. 1080p60 has 148.5 MHz, which the PLL cannot
make of the boards' oscillators: this is one percent more."""


def _pattern_1080p(board: "Board") -> Source:
    """As many rows of it as the board stores in the form that its card begins with."""
    rows = min(1080, board.features.max_rows if board.features.full_rows else board.features.compact_rows)
    period = PIXEL_HZ["pattern-1080p"] // IMAGES_HZ
    return DomainRenamer("pixel")(Pattern(1920, rows, period=period))


def _camera(table: SensorTable) -> Callable[["Board"], Camera]:
    return lambda board: camera_dvp(table, xclk="xclk")


SOURCES: dict[str, Callable[["Board"], Source | Camera]] = {
    "pattern": _pattern,
    "pattern-1080p": _pattern_1080p,
    **{name: _camera(table) for name, table in (("ov7670", OV7670), ("ov2640", OV2640), ("ov5640", OV5640))},
}
"""Sources of images by name, each made for a board."""


@dataclass(frozen=True)
class Board:
    """A board, and all in which it differs from others.

    Attributes
    ----------
    name : for ``BOARD=``
    title : for people, with the FPGA
    platform : of amaranth-boards
    family : ``ecp5`` or ``ice40``
    sync_hz : clock of the card
    wiring : places of the signals, see :data:`boards.wiring.ROLES`
    label : how a place is called on the board
    links : what it has of :data:`LINKS`: what to plug in where; the first is the default
    program : options of openFPGALoader
    about : paragraphs for its page
    source : where the pins are from
    picture : columns and rows of the test picture
    features : what the card is built with
    """

    name: str
    title: str
    platform: type[Platform]
    family: str
    sync_hz: int
    wiring: wiring.Wiring
    label: Callable[[str], str]
    links: Mapping[str, str]
    program: tuple[str, ...]
    about: str
    source: str
    picture: tuple[int, int] = (640, 480)
    features: Features = ROWS_1024

    def card(self, link: str | None = None, source: str = "pattern", serial: int = SERIAL) -> "Top":
        """What the board runs.

        Raises
        ------
        BoardError
            It has no clock for the pixels of this source.
        """
        made = LINKS[link or next(iter(self.links))](serial)
        pixel_hz = PIXEL_HZ.get(source)
        if pixel_hz and self.family != "ecp5":
            raise BoardError(f"{self.name} has no clock for the pixels of {source!r}; boards with an ECP5 have")
        clocks = Ecp5Clocks(self.sync_hz, pixel_hz) if self.family == "ecp5" else Ice40Clocks(self.sync_hz)
        pixel_domain = "pixel" if pixel_hz else "sync"
        own = {"clock_hz": self.sync_hz, "serial": serial, "pixel_domain": pixel_domain, "features": self.features}
        return Top(clocks, Card(SOURCES[source](self), made, **own))

    def lean(self) -> "Board":
        """The same board with a card of all detectors and no more: without :data:`LEFT_OUT`."""
        features = replace(self.features, **dict.fromkeys(LEFT_OUT, False))
        return replace(self, name=f"{self.name}{LEAN}", features=features)

    def open(self, seed: int = 1) -> Platform:
        """The platform with what is wired to it, for one build, whose placement begins from ``seed``."""
        vendor = {"ecp5": LatticeECP5Platform, "ice40": SiliconBluePlatform}[self.family]
        hooks = (Ecp5,) if self.family == "ecp5" else ()
        opened = type("Wired", (_Tools, *hooks, self.platform), {"vendor": vendor, "seed": seed})()
        opened.add_resources(wiring.resources(self.wiring, self.family))
        for name, text in synthesis.files(self.family).items():
            opened.add_file(name, text)
        return opened


class Top(Elaboratable):
    """A card with the clocks that it runs on."""

    def __init__(self, clocks: Ecp5Clocks | Ice40Clocks, card: Card) -> None:
        self.clocks = clocks
        self.card = card

    def elaborate(self, platform):
        m = Module()
        m.domains += [ClockDomain(name, reset_less=reset_less) for name, reset_less in self.clocks.domains.items()]
        m.submodules.clocks = self.clocks
        m.submodules.card = self.card
        return m


class _Tools:
    """Only synthesis, placement and packing, with this project's options: whatever else a platform wants to run is for
    programming, which is openFPGALoader's here.
    """

    @property
    def required_tools(self):
        return self.vendor.required_tools.fget(self)

    @property
    def command_templates(self):
        return self.vendor.command_templates.fget(self)

    def toolchain_prepare(self, fragment, name, **options):
        family = "ecp5" if self.vendor is LatticeECP5Platform else "ice40"
        ours = {
            "synth_opts": synthesis.OPTIONS[family],
            "script_after_read": synthesis.BEFORE[family],
            "script_after_synth": synthesis.AFTER[family],
            "nextpnr_opts": PLACEMENT.format(seed=self.seed),
            "emit_src": False,
        }
        return super().toolchain_prepare(fragment, name, **{**ours, **options})
