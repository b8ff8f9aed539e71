# amaranth: UnusedElaboratable=no
"""Writes ``docs/resources.md``: what each block takes of an FPGA. ``python -m docs.resources``; it takes a while."""

from collections.abc import Callable
from pathlib import Path

from amaranth.lib import wiring

from gateware.camera.monitor import Monitor
from gateware.core import Core
from gateware.features import Features
from gateware.frame.assembler import FrameAssembler
from gateware.frame.buffer import FrameBuffer
from gateware.link.link import Link
from gateware.motion.motion import Motion
from gateware.registers import RegisterFile
from gateware.vision.background import Background
from gateware.vision.choose import Choose
from gateware.vision.fir import Fir
from gateware.vision.gate import Gate
from gateware.vision.hls import HLS
from gateware.vision.isolate import Isolate
from gateware.vision.lookahead import Lookahead
from gateware.vision.peak import Peak
from gateware.vision.pixels import Pixels
from gateware.vision.runs import Runs
from gateware.vision.spread import Spread
from gateware.vision.vision import Vision
from gateware.vision.weight import Weight
from gateware.vision.window import Window
from tests.support.synthesis import ECP5, ICE40, Device, Use, place

BUILD = Path(__file__).resolve().parent.parent / "build" / "resources"
PAGE = Path(__file__).with_name("resources.md")
MAX_ROWS = 1024

BLOCKS: tuple[tuple[str, Callable[[], wiring.Component]], ...] = (
    *((block.__name__, block) for block in (Monitor, HLS, Gate, Weight, Background, Pixels, Isolate)),
    *((block.__name__, block) for block in (Lookahead, Fir, Runs, Choose, Spread, Window)),
    ("Peak", lambda: Peak(2048, Window().latency)),
    ("Vision", lambda: Vision(Features(max_rows=MAX_ROWS))),
    ("Motion", Motion),
    ("FrameBuffer", lambda: FrameBuffer(MAX_ROWS)),
    ("FrameAssembler", lambda: FrameAssembler(MAX_ROWS)),
    ("RegisterFile", RegisterFile),
    ("Link", Link),
    ("Core", lambda: Core(Features(max_rows=MAX_ROWS))),
)

HEAD = f"""# What the gateware takes

Rendered by `python -m docs.resources`: Yosys and nextpnr as `requirements.lock` has them, seed 1. Cells, block RAMs
and multipliers are those of the block alone; its frequency is that between registers at all of its ports. Images of up
to 2048 columns, frames of up to {MAX_ROWS} rows.

`Pixels` holds `HLS`, `Gate`, `Weight` and `Background`; `Vision` is the whole path from pixels to rows; `Core` is
everything but the board.
"""

PIXEL_PATH = """## The pixel path

Multipliers have their own registers in use (`gateware.arithmetic.Multiply`; on an ECP5 board's platform
`boards.ecp5.Ecp5` puts them in), and whatever is read from a block RAM goes to a register before anything is made of
it. `tests/gateware/test_synthesis.py` proves both of the netlist of `Vision`. Memories promise nothing of a word that
is read while it is written (`gateware.memory.BlockRam`); each user says why that does not matter.

A block RAM of an ECP5 without its own output register takes 5.83 ns from the clock to its output. Yosys does not use
that register, so the ECP5 boards' platform places the RAM itself (`boards/ecp5.py`; compared by
`tests/gateware/test_memory_ecp5.py`). Dividers are short because they do not
restore: the sign of what is left decides whether the next step adds or subtracts, in the LUTs of the carries
themselves (`gateware.arithmetic.AddSubtract`).

Blocks are mapped as boards are (`boards/synthesis.py`): a carry chain takes a cell beside its bits at most, not four
(`boards/ecp5_carries.v`).
"""

FRAMES = """## Frames, registers and link

Memories are `BlockRam`: no logic looks for a word that is read while it is written, and every user says why that does
not matter. Wide choices go by one bit each from registers (`gateware/select.py`), two thirds of a LUT for each bit.
`synth_ecp5 -nowidelut` makes fewer cells of multiplexers: PFUMX and L6MUX are free, but Yosys spends four LUTs on each
function of six inputs.

What a register takes stands in a ROM, and what was written is read back from a memory, a block RAM each on an ECP5.

Rows are stored in the form in which they are sent, as words of 32 bits: 8 block RAMs hold two buffers of 512 rows in
the full form or 2048 in the compact one, 16 and 32 hold 1024 and 2048 full rows.

The CRC takes 4 bits a clock when sending and one when receiving, not 8: the link has the clocks. Where
nothing but order counts, an address is a shift register with feedback (`gateware/link/fifo.py`): no carry, one LUT.
"""


def line(name: str, make: Callable[[], wiring.Component]) -> str:
    cells = [f"`{name}`"]
    for device, goal in ((ECP5, 200.0), (ICE40, 48.0)):
        cells += _cells(place(make, device, BUILD, goal), device)
    return "| " + " | ".join(cells) + " |"


def _cells(use: Use, device: Device) -> list[str]:
    mhz = "does not fit" if use.mhz is None else f"{use.mhz:.0f}"
    return [str(use.cells), str(use.block_rams), str(use.multipliers), mhz]


def main() -> None:
    heads = ["block"]
    for device in (ECP5, ICE40):
        heads += [f"{device.name}: {device.units[0]}", *device.units[1:], "MHz"]
    lines = [HEAD, "| " + " | ".join(heads) + " |", "|---" + "|---:" * (len(heads) - 1) + "|"]
    for name, make in BLOCKS:
        lines.append(line(name, make))
        print(lines[-1], flush=True)
        PAGE.write_text(
            "\n".join([*lines, "", PIXEL_PATH, FRAMES])
        )  # what is there so far: the whole takes half an hour


if __name__ == "__main__":
    main()
