"""The virtual card with its own test picture in place of a camera, as a board has it: for ``magtrak self-test``.

The gateware's pattern source stands before the core in the same compiled model; motor outputs are wired to encoder
inputs there. Nothing surrounds this card but a host.
"""

import signal
import sys
import time
from pathlib import Path

import click
import numpy as np

from .core import INTERLOCK, PIN, SimulatedCore, library
from .terminal import Terminal

COLUMNS, ROWS = 160, 120
CLOCK_HZ = 2_000_000
PERIOD = CLOCK_HZ // 80
"""Clocks from image to image."""

BYTES_PER_SECOND = 100_000
"""Of the link: compact rows of all images pass, full rows do not, as with 640 x 480 at 60 Hz on 3 Mbaud."""

SLICE = 250
"""Clocks between two looks at the host."""


def run_pattern(link: Path | None, serial: int, board: str, *, real_time: bool) -> None:
    """Run until ended by a signal.

    Parameters
    ----------
    link : as in :class:`~sim.terminal.Terminal`
    serial : the card's serial number
    board : the board whose card it is; empty: it has everything
    real_time : keep to the wall clock where the machine is fast enough, and drop what the host does not read;
        otherwise card time stands still while it does not
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that the link goes when the card is told to end
    compiled = library((COLUMNS, ROWS, PERIOD), board)
    terminal = Terminal(link)
    core = SimulatedCore(CLOCK_HZ, BYTES_PER_SECOND, serial, compiled)
    try:
        core.pins(np.array([(0, INTERLOCK, 1)], PIN))
        click.echo(f"virtual card on {terminal.name}: its own test picture, {COLUMNS} x {ROWS}", err=True)
        since = time.monotonic()
        while True:
            core.send(terminal.read())
            core.run(core.clock + SLICE)
            # What the host does not read backs up into the card.
            while not terminal.write(b"") and not real_time:
                time.sleep(1e-3)
            if terminal.write(b""):
                terminal.write(core.receive())
            ahead = core.clock / CLOCK_HZ - (time.monotonic() - since)
            if real_time and ahead > 0:
                time.sleep(ahead)
            elif real_time:
                since -= ahead  # the machine is slower than the card: no hurry to catch up
    finally:
        core.close()
        terminal.close()
