r"""Verilog whose registers say when they change.

Amaranth's Verilog computes the next value of each register in a block of its own, which begins with the present value,
and a clocked block takes it over::

    always @* begin                       always @(posedge clk) begin
      if (dummy) begin end                  if (begins) begin
      \$26  = passing;                       passing <= let_in;
      if (begins) begin            =>        end
        \$26  = let_in;                    end
      end
    end
    always @(posedge clk)
      passing <= \$26 ;

Both mean the same. But from the left Verilator makes code that computes and copies everything in each clock; from the
right it makes branches, past which it need not go: a sixth of the card's instructions fall away.
"""

import re
from dataclasses import dataclass

_NEXT = re.compile(
    r"^  always @\* begin\n    if \(\S+ \) begin end\n"
    r"    (?P<next>\\\$\S+)  = (?P<register>\S+) ?;\n(?P<body>.*?)^  end\n",
    re.MULTILINE | re.DOTALL,
)
_TAKEN = re.compile(
    r"^  always @\((?P<edge>posedge \S+)\)\n    (?P<register>\S+) ? ?<= (?P<next>\\\$\S+) ;\n", re.MULTILINE
)


@dataclass(frozen=True)
class _Edit:
    start: int
    end: int
    text: str


def write_where_changed(verilog: str) -> str:
    """The same modules; registers whose blocks do not look as above stay as they are.

    A register is rewritten if its next value is named in these two blocks only, and is not read in its own.
    """
    return "".join(_rewritten(module) for module in re.split(r"^(?=module )", verilog, flags=re.MULTILINE))


def _rewritten(module: str) -> str:
    taken: dict[str, list[re.Match[str]]] = {}
    for block in _TAKEN.finditer(module):
        taken.setdefault(block["next"], []).append(block)
    edits = []
    for block in _NEXT.finditer(module):
        name = block["next"] + " "  # an escaped name ends with a space
        takers = taken.get(block["next"], [])
        # Its declaration and its taker are the only other places.
        alone = module.count(name) == block[0].count(name) + 2
        if len(takers) != 1 or takers[0]["register"] != block["register"] or not alone:
            continue
        body = _clocked(block["body"], name, block["register"] + " ")
        if name not in body:
            edits.append(_Edit(block.start(), block.end(), f"  always @({takers[0]['edge']}) begin\n{body}  end\n"))
            edits.append(_Edit(takers[0].start(), takers[0].end(), ""))
    for edit in sorted(edits, key=lambda edit: edit.start, reverse=True):
        module = module[: edit.start] + edit.text + module[edit.end :]
    return module


def _clocked(body: str, name: str, register: str) -> str:
    """Statements that write to ``name`` at once, as ones that write to ``register`` at the end of the clock."""
    lines = []
    for line in body.splitlines(keepends=True):
        target, is_written, value = line.partition(" = ")
        if is_written and name in target:
            line = f"{target.replace(name, register)} <= {value}"
        lines.append(line)
    return "".join(lines)
