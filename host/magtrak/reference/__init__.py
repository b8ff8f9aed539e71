"""What the gateware's vision computes, in numpy, bit for bit.

These functions are the definition: tests compare each block of the gateware with them, and the host
uses them as a card in software. They stand on the host's side because the host has to run without Amaranth, and the
gateware may import the host package but not the reverse.
"""

from .gate import gate, luts_from_words, words_from_luts
from .hls import hls
from .rows import ROW_DTYPE, measure
from .runs import Runs, find_runs
from .snapshot import Piece, snapshot
from .weight import mix, saturated, weight

__all__ = [
    "ROW_DTYPE",
    "Piece",
    "Runs",
    "find_runs",
    "gate",
    "hls",
    "luts_from_words",
    "measure",
    "mix",
    "saturated",
    "snapshot",
    "weight",
    "words_from_luts",
]
