"""Cameras on a board: their pins, clock and set-up, as parts of a :class:`~gateware.card.Card`.

A board file names the resource and gives ``camera_dvp(OV7670)`` or ``camera_rgb()`` to its card in place of a source.
"""

from collections.abc import Callable

from amaranth.hdl import ClockDomain, ClockSignal, Module, ResetSignal, Signal
from amaranth.lib import io
from amaranth.lib.cdc import ResetSynchronizer

from magtrak.protocol import Sensor

from ..core import Core
from ..crossing.exchange import FASTEST
from ..crossing.mirror import Mirror
from .dvp import Dvp
from .rgb import Interlace, Rgb
from .sensor import SensorTable
from .setup import Setup
from .timing import Timing

Camera = Callable[[Module, object, Core, int], "Dvp | Rgb"]
"""Adds a camera to a card's module, whose clock it is told: pins, domain ``camera``, set-up; gives the source."""


def camera_dvp(table: SensorTable | None = None, *, pclk_hz: float = 50e6, xclk: str = "sync", **options) -> Camera:
    """A camera on the board's resource ``camera``. With a table, no image passes before the camera is set up.

    Its subsignals: ``pclk``, ``href``, ``vsync``, ``d`` (8); with a table ``scl``, ``sda`` (both pulled up). Where the
    board has them: ``xclk``, the camera's input clock; ``reset`` and ``powerdown``, which are held inactive (declare
    them with ``PinsN`` where they are active low).

    Parameters
    ----------
    table : the kind of camera (``OV7670``, ``OV2640``, ``OV5640``); None: it needs no set-up
    pclk_hz : the fastest pixel clock; timing has to hold for it
    xclk : the domain whose clock ``xclk`` is
    options : of :class:`~gateware.camera.dvp.Dvp`
    """

    def add(m: Module, platform, core: Core, clock_hz: int) -> Dvp:
        if core.pixel_domain != "sync":
            raise ValueError(f"pixel_domain is {core.pixel_domain!r}; DVP's images come to 'sync'")
        port = platform.request("camera", 0, dir="-")
        _domain(m, platform, port.pclk, pclk_hz)
        order = {} if table is None else {"high_byte_first": table.high_byte_first}
        source = Dvp(**(order | options))
        for name in ("href", "vsync", "d"):
            _sampled(m, port, name, getattr(source, name))
        if hasattr(port, "xclk"):
            m.submodules.camera_xclk = buffer = io.Buffer("o", port.xclk)
            m.d.comb += buffer.o.eq(ClockSignal(xclk))
        for name in ("reset", "powerdown"):
            if hasattr(port, name):
                m.submodules[f"camera_{name}"] = io.Buffer("o", getattr(port, name))
        _report(m, core, source, Sensor.DVP if table is None else table.sensor)
        if table is None:
            m.d.comb += core.camera.camera_state.ready.eq(1)
        else:
            _setup(m, clock_hz, port, core, table)
            m.d.comb += source.enable.eq(core.camera.camera_state.ready)
        return source

    return add


def camera_rgb(*, pclk_hz: float = 75e6, **options) -> Camera:
    """Parallel video on the board's resource ``video``; in a card whose ``pixel_domain`` is ``camera`` nothing crosses.

    Its subsignals: ``pclk``, ``hs``, ``vs``, ``de``, ``r``, ``g``, ``b`` (8 each); ``field`` with ``Interlace.PIN``.

    Parameters
    ----------
    pclk_hz : as in :func:`camera_dvp`
    options : of :class:`~gateware.camera.rgb.Rgb`

    Raises
    ------
    ValueError
        When a card is made: its ``pixel_domain`` is another, or too fast for its clock.
    """

    def add(m: Module, platform, core: Core, clock_hz: int) -> Rgb:
        if core.pixel_domain not in ("sync", "camera"):
            raise ValueError(f"pixel_domain is {core.pixel_domain!r}; 'sync' and 'camera' are possible here")
        own_clock = core.pixel_domain == "camera"
        if own_clock and pclk_hz > FASTEST * clock_hz:
            raise ValueError(f"pclk_hz is {pclk_hz:g}; up to {FASTEST} times {clock_hz} are possible")
        port = platform.request("video", 0, dir="-")
        _domain(m, platform, port.pclk, pclk_hz)
        source = Rgb(own_clock=own_clock, **options)
        for name in ("hs", "vs", "de", "r", "g", "b"):
            _sampled(m, port, name, getattr(source, name))
        if source.interlace is Interlace.PIN:
            _sampled(m, port, "field", source.field_pin)
        _report(m, core, source, Sensor.RGB)
        m.d.comb += core.camera.camera_state.ready.eq(1)
        return source

    return add


def _domain(m: Module, platform, pin, hz: float) -> None:
    m.domains.camera = ClockDomain()
    m.submodules.camera_pclk = buffer = io.Buffer("i", pin)
    m.d.comb += ClockSignal("camera").eq(buffer.i)
    platform.add_clock_constraint(pin.io, hz)
    m.submodules.camera_clock_reset = ResetSynchronizer(ResetSignal("sync", allow_reset_less=True), domain="camera")


def _sampled(m: Module, port, name: str, to: Signal) -> None:
    m.submodules[f"camera_{name}"] = buffer = io.Buffer("i", getattr(port, name))
    m.d.camera += to.eq(buffer.i)


def _setup(m: Module, clock_hz: int, port, core: Core, table: SensorTable) -> None:
    m.submodules.camera_setup = setup = Setup(table, clock_hz)
    for name in ("scl", "sda"):
        m.submodules[f"camera_{name}"] = buffer = io.Buffer("io", getattr(port, name))
        m.d.comb += [buffer.o.eq(0), buffer.oe.eq(getattr(setup, f"{name}_low"))]
        if name == "sda":
            m.d.comb += setup.sda.eq(buffer.i)
    m.d.comb += [
        setup.exposure.eq(core.camera_exposure),
        setup.gain.eq(core.camera_gain),
        core.camera.camera_state.ready.eq(setup.ready),
        core.camera.camera_state.unacknowledged.eq(setup.unacknowledged),
        core.camera.camera_setup.eq(setup.setup),
    ]


def _report(m: Module, core: Core, source: Dvp | Rgb, sensor: Sensor) -> None:
    m.submodules.camera_timing = timing = Timing(core.pixel_domain)
    state = core.camera.camera_state
    broken = source.broken
    if core.pixel_domain != "sync":
        m.submodules.camera_broken = mirror = Mirror(broken.shape(), core.pixel_domain, "sync")
        m.d.comb += mirror.i.eq(broken)
        broken = mirror.o
    m.d.comb += [
        timing.video.pixel.valid.eq(source.video.pixel.valid),
        timing.video.pixel.payload.eq(source.video.pixel.payload),
        timing.video.frame_end.eq(source.video.frame_end),
        state.sensor.eq(sensor),
        state.cut.eq(source.cut),
        state.broken.eq(broken),
        state.clock_missing.eq(timing.clock_missing),
        state.unsteady.eq(timing.unsteady),
        core.camera.camera_row.eq(timing.row),
        core.camera.camera_rows.eq(timing.row_count),
        core.camera.camera_rate.eq(timing.rate),
    ]
