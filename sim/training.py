"""A short run of a card that has just been compiled, from which the compiler learns what is rare in it.

``python -m sim.training card.so`` runs two small images of a line, one of them with other settings.
"""

import sys
from pathlib import Path

import numpy as np

from magtrak import protocol

from .core import SimulatedCore, load

ROWS, COLUMNS, ROW_CLOCKS = 24, 320, 352
CLOCK_HZ = 20_000_000


def run(path: Path) -> None:
    """Two images, one after the other, with the host's commands between them."""
    core = SimulatedCore(CLOCK_HZ, 1.2e6, compiled=load(path))
    values = {"run": 1, "floor": 40, "detector": int(protocol.Detector.CENTROID), "commit": 1}
    commands = [
        protocol.Packet(
            protocol.PacketType.WRITE,
            number,
            protocol.COMMAND.pack({"address": protocol.register(name).address, "value": value}),
        )
        for number, (name, value) in enumerate(values.items())
    ]
    rng = np.random.default_rng(1)
    image = rng.integers(0, 12, (ROWS, COLUMNS, 3), dtype=np.uint8)
    centre = np.linspace(40, 280, ROWS)[:, None]
    image[:, :, 1] += (180 * np.exp(-((np.arange(COLUMNS) - centre) ** 2) / 4.5)).astype(np.uint8)
    clock = 1000
    for sent in (commands[:1], commands[1:]):
        core.send(b"".join(map(protocol.frame_packet, sent)))
        core.run(clock + 4000)
        starts = core.clock + ROW_CLOCKS * np.arange(1, ROWS + 1)
        core.rows(starts, image, frame_first=True, end=int(starts[-1]) + COLUMNS + 1)
        clock = int(starts[-1]) + 2 * ROW_CLOCKS
        core.run(clock)
        core.receive()
    core.close()


if __name__ == "__main__":
    run(Path(sys.argv[1]))
