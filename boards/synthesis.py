"""How Yosys makes a netlist of a card, for each family of FPGAs."""

from pathlib import Path

_HERE = Path(__file__).parent

FILES = {"ecp5": ("ecp5_carries.v", "ecp5_ends.v"), "ice40": ()}
"""What Yosys's scripts read, see :func:`files`."""

_ECP5 = "-nowidelut -cmp2softlogic"
_MAP = "&if {W} {D} {R}; &mfs"
_AGAIN = f"&st; &dch -f -r; {_MAP}"
_ABC = f"+&scorr; &sweep; &dc2; &dch -f -r; &ps; {_MAP}; {_AGAIN}; {_AGAIN}"
"""Maps three times over, each time from the netlist of the time before: 86 cells of 6,203 less."""

OPTIONS = {"ecp5": f"{_ECP5} -run begin:map_gates", "ice40": "-dsp -device u"}
"""Of ``synth_ecp5`` and ``synth_ice40``; ``docs/boards/README.md`` tells what they bring."""

BEFORE = {"ecp5": "", "ice40": "setattr -unset init a:before_reading"}
"""What Yosys does first: see :class:`gateware.memory.BlockRam`."""

AFTER = {
    "ecp5": f"""techmap -map ecp5_carries.map
scratchpad -set abc9.script "{_ABC}"
synth_ecp5 {_ECP5} -top top -run map_gates:
splitnets
select -set carries t:CCU2C %co1:+[COUT] w:* %i
select -set used t:* %ci1 w:* %i o:* %u
select -set last @carries @used %d %ci1:+[COUT] t:CCU2C %i
select -set first t:CCU2C @carries %co1:+[CIN] %d
chtype -set CCU2C_LAST @last
chtype -set CCU2C_FIRST @first
techmap -map ecp5_ends.map
clean""",
    "ice40": "",
}
"""What follows: the rest of ``synth_ecp5`` with carry chains of our own, and then what is known only at the end, which
carries nobody looks at and which begin a chain.

A cell that is both first and last keeps its carry, and the two cells that this costs."""


def script(family: str) -> str:
    """What makes a netlist of a design that has been read, whose module is ``top``: as a board's build has it."""
    return f"{BEFORE[family]}\nsynth_{family} {OPTIONS[family]} -top top\n{AFTER[family]}\n"


def files(family: str) -> dict[str, str]:
    """Files that the scripts read, by name. They are no ``.v``, which a platform would take for part of the card."""
    return {name.replace(".v", ".map"): (_HERE / name).read_text() for name in FILES[family]}
