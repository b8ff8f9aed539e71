"""Clocks of the boards, from the one oscillator that each has.

An ECP5's PLL runs at 480 MHz, of which every frequency that the card needs is a whole part: ``sync`` as the board
has it, ``usb_io`` 48 MHz, ``usb`` 12 MHz, ``xclk`` 24 MHz for a camera. A second one, at 600 MHz, makes ``pixel`` where
pixels have a clock of their own. An iCE40's makes one, for ``sync`` and ``xclk``.

Sources: Lattice FPGA-TN-02200 (ECP5 sysClock PLL/DLL), FPGA-TN-02052 (iCE40 sysCLOCK PLL).
"""

from typing import ClassVar

from amaranth.hdl import ClockDomain, ClockSignal, Const, Elaboratable, Instance, Module, Signal
from amaranth.lib import io
from amaranth.lib.cdc import ResetSynchronizer

from .errors import BoardError

_VCO_HZ = 480_000_000
_PIXEL_VCO_HZ = 600_000_000
_ECP5_OTHERS_HZ = {"usb_io": 48_000_000, "usb": 12_000_000, "xclk": 24_000_000}
_ICE40_SETTLES_S = 15e-6
"""Block RAMs of an iCE40 read as zero for some 3 us after configuration (IceStorm's issue 76)."""


class ClockError(BoardError):
    """The PLL cannot make the clock that a board asks for."""


def ecp5_dividers(from_hz: float, sync_hz: float, vco_hz: int = _VCO_HZ) -> tuple[int, int, int]:
    """Input, feedback and output divider for ``sync_hz``, with the oscillator at ``vco_hz``.

    Raises
    ------
    ClockError
        There are none: ``sync_hz`` has to divide ``vco_hz``, by up to 128.
    """
    output = round(vco_hz / sync_hz)
    # The phase comparator takes 3.125 MHz at least.
    for divider in range(1, 129):
        feedback = round(sync_hz * divider / from_hz)
        exact = from_hz * feedback == sync_hz * divider and output * sync_hz == vco_hz
        if exact and 1 <= feedback <= 128 and output <= 128 and from_hz / divider >= 3_125_000:
            return divider, feedback, output
    made, there, whole = (f"{hz / 1e6:g} MHz" for hz in (sync_hz, from_hz, vco_hz))
    raise ClockError(f"no clock of {made} from {there}: it has to divide {whole}")


class Ecp5Clocks(Elaboratable):
    """Drives the domains ``sync``, ``usb_io``, ``usb`` and ``xclk`` of an ECP5, their edges in phase, and ``pixel``.

    ``sync`` and ``pixel`` have no reset of their own: the global one holds every register until all PLLs are locked. It
    ends with a clock of ``sync``, which is any moment for ``pixel``: nothing changes there before images come.

    Parameters
    ----------
    sync_hz : has to divide 480 MHz
    pixel_hz : has to divide 600 MHz; None: there is no such domain

    Raises
    ------
    ClockError
        The PLL cannot make it.
    """

    def __init__(self, sync_hz: int, pixel_hz: int | None = None) -> None:
        self.sync_hz = sync_hz
        self.pixel_hz = pixel_hz

    @property
    def domains(self) -> dict[str, bool]:
        """Those that it drives, and whether they are without reset."""
        pixel = {} if self.pixel_hz is None else {"pixel": True}
        return {"sync": True, **pixel, **dict.fromkeys(_ECP5_OTHERS_HZ, False)}

    def elaborate(self, platform):
        m = Module()
        from_hz = platform.default_clk_frequency
        dividers = ecp5_dividers(from_hz, self.sync_hz)
        m.submodules.oscillator = oscillator = io.Buffer("i", platform.request(platform.default_clk, dir="-"))
        reset = Const(0)
        if platform.default_rst is not None:
            m.submodules.button = button = io.Buffer("i", platform.request(platform.default_rst, dir="-"))
            reset = button.i
        clocks = [Signal(name=f"clk_{name}") for name in ("sync", *_ECP5_OTHERS_HZ)]
        locks = Signal(1 if self.pixel_hz is None else 2)
        locked = Signal()
        others = [_VCO_HZ // hz for hz in _ECP5_OTHERS_HZ.values()]
        m.submodules.pll = _ecp5_pll(oscillator.i, dividers, others, clocks, locks[0])
        m.d.comb += [ClockSignal("sync").eq(clocks[0]), locked.eq(locks.all())]
        if self.pixel_hz is not None:
            clock = Signal(name="clk_pixel")
            dividers = ecp5_dividers(from_hz, self.pixel_hz, _PIXEL_VCO_HZ)
            m.submodules.pixel_pll = _ecp5_pll(oscillator.i, dividers, [], [clock], locks[1])
            m.d.comb += ClockSignal("pixel").eq(clock)
        released = Signal(2)
        for stage, value in enumerate((locked & ~reset, released[0])):
            m.submodules[f"released_{stage}"] = Instance(
                "FD1S3AX", p_GSR="DISABLED", i_CK=clocks[0], i_D=value, o_Q=released[stage]
            )
        m.submodules.reset = Instance("SGSR", i_CLK=clocks[0], i_GSR=released[1])
        for name, clock in zip(_ECP5_OTHERS_HZ, clocks[1:], strict=True):
            m.d.comb += ClockSignal(name).eq(clock)
            m.submodules[f"reset_{name}"] = ResetSynchronizer(~locked | reset, domain=name)
        return m


def _ecp5_pll(
    source: Signal, dividers: tuple[int, int, int], others: list[int], clocks: list[Signal], locked: Signal
) -> Instance:
    """A PLL with ``others`` as dividers of its further outputs."""
    divider, feedback, output = dividers
    outputs = {}
    for name, division, clock in zip(("CLKOP", "CLKOS", "CLKOS2", "CLKOS3"), [output, *others], clocks, strict=False):
        outputs |= {
            f"p_{name}_ENABLE": "ENABLED",
            f"p_{name}_DIV": division,
            f"p_{name}_CPHASE": division - 1,  # so that all edges coincide
            f"p_{name}_FPHASE": 0,
            f"o_{name}": clock,
        }
    idle = ("RST", "STDBY", "PHASESEL0", "PHASESEL1", "PHASEDIR", "PHASESTEP", "PHASELOADREG", "PLLWAKESYNC")
    return Instance(
        "EHXPLLL",
        p_CLKI_DIV=divider,
        p_CLKFB_DIV=feedback,
        p_FEEDBK_PATH="CLKOP",
        **outputs,
        i_CLKI=source,
        i_CLKFB=clocks[0],
        **{f"i_{name}": 0 for name in (*idle, "ENCLKOP")},
        o_LOCK=locked,
    )


def ice40_dividers(from_hz: float, sync_hz: float) -> tuple[int, int]:
    """DIVF and DIVQ of an iCE40's PLL with DIVR 0, simple feedback.

    Raises
    ------
    ClockError
        There are none: the frequency is ``from_hz`` times (DIVF + 1) over 2 ** DIVQ.
    """
    for shift in range(1, 7):
        factor = sync_hz * (1 << shift) / from_hz
        if factor == int(factor) and 1 <= factor <= 128 and 533e6 <= from_hz * factor <= 1066e6:
            return int(factor) - 1, shift
    raise ClockError(f"no clock of {sync_hz / 1e6:g} MHz from {from_hz / 1e6:g} MHz: an iCE40's PLL cannot make it")


class Ice40Clocks(Elaboratable):
    """Drives the domains ``sync`` and ``xclk`` of an iCE40, one clock.

    It stands still until the PLL is locked and the block RAMs can be read: so ``sync`` needs no reset, for
    configuration leaves every register with its initial value. A reset would occupy the registers' own input for it,
    and cost several hundred cells.

    Parameters
    ----------
    sync_hz : the oscillator's, times a whole number, over a power of two

    Raises
    ------
    ClockError
        The PLL cannot make it.
    """

    domains: ClassVar = {"sync": True, "xclk": True}
    """Those that it drives, and whether they are without reset."""

    def __init__(self, sync_hz: int) -> None:
        self.sync_hz = sync_hz

    def elaborate(self, platform):
        m = Module()
        factor, shift = ice40_dividers(platform.default_clk_frequency, self.sync_hz)
        pin = platform.request(platform.default_clk, dir="-")
        clock, locked = Signal(name="clk_start"), Signal()
        m.submodules.pll = Instance(
            "SB_PLL40_PAD",
            p_FEEDBACK_PATH="SIMPLE",
            p_DIVR=Const(0, 4),
            p_DIVF=Const(factor, 7),
            p_DIVQ=Const(shift, 3),
            p_FILTER_RANGE=Const(1, 3),  # for 10 to 17 MHz
            i_PACKAGEPIN=pin.io,
            i_RESETB=Const(1),
            i_BYPASS=Const(0),
            o_PLLOUTCORE=clock,
            o_LOCK=locked,
        )
        m.domains.start = ClockDomain(reset_less=True, local=True)
        m.d.comb += ClockSignal("start").eq(clock)
        last = int(_ICE40_SETTLES_S * self.sync_hz)
        count = Signal(range(last + 1))
        ready = Signal()
        with m.If(~locked):
            m.d.start += [count.eq(0), ready.eq(0)]
        with m.Elif(count == last):
            m.d.start += ready.eq(1)
        with m.Else():
            m.d.start += count.eq(count + 1)
        # Opened and closed while the clock is low, the gate lets whole pulses pass.
        m.domains.low = ClockDomain(reset_less=True, local=True, clk_edge="neg")
        open_, gated = Signal(), Signal(name="clk_sync", attrs={"keep": 1})
        m.d.low += open_.eq(ready)
        m.d.comb += [ClockSignal("low").eq(clock), gated.eq(clock & open_)]
        platform.add_clock_constraint(gated, self.sync_hz)
        m.d.comb += [ClockSignal(name).eq(gated) for name in ("sync", "xclk")]
        return m
