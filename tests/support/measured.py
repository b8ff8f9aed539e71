"""The compiled card as a measuring device: images in, decoded frames out, without a port or a host's link."""

from collections.abc import Mapping
from types import TracebackType

import numpy as np

from magtrak import protocol
from magtrak.frames import Frame, decode_frame
from magtrak.protocol import Deframer, PacketType, RowForm
from magtrak.reference import words_from_luts
from sim.core import SimulatedCore

CLOCK_HZ = 20_000_000
BLANKING = 16
ROW_PERIOD = 48
FRAME_GAP = 64
SLICE = 4000  # clocks; the link stands still while 4096 bytes wait to be read


class MeasuringCard:
    """A card that sends full rows, over a link of a byte a clock.

    Use it as a context manager; it frees the compiled card.
    """

    def __init__(self) -> None:
        self.core = SimulatedCore(CLOCK_HZ, CLOCK_HZ)
        self._deframer = Deframer()
        self._commits = 0
        self._frames: list[Frame] = []

    def __enter__(self) -> "MeasuringCard":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.core.close()

    def configure(self, settings: Mapping[str, int], luts: np.ndarray) -> None:
        """Put settings and gate tables ((3, 256) bool) in force with the next image."""
        self._commits += 1
        writes = [(protocol.register(name), 0, value) for name, value in settings.items()]
        for name, words in zip(("lut_hue", "lut_luminance", "lut_saturation"), words_from_luts(luts), strict=True):
            writes += [(protocol.register(name), offset, word) for offset, word in enumerate(words)]
        for name, value in (("form", RowForm.FULL), ("commit", self._commits), ("run", 1)):
            writes.append((protocol.register(name), 0, value))
        for register, offset, value in writes:
            payload = protocol.COMMAND.pack({"address": register.address + offset, "value": register.encode(value)})
            self.core.send(protocol.frame_packet(protocol.Packet(PacketType.WRITE, 0, payload)))
        while self.core.waiting:
            self._run(self.core.clock + SLICE)
        self._run(self.core.clock + SLICE)

    def measure(self, image: np.ndarray, *, blanking: int = BLANKING, row_period: int = ROW_PERIOD) -> Frame:
        """The frame of one (rows, columns, 3) image.

        ``blanking``: clocks from a row's last pixel to the next one's first; ``row_period``: at least, from row to row.
        """
        self.show(image, blanking=blanking, row_period=row_period)
        return self.finish(1)[0]

    def show(
        self,
        image: np.ndarray,
        *,
        blanking: int = BLANKING,
        row_period: int = ROW_PERIOD,
        gap: int = FRAME_GAP,
        end: bool = True,
    ) -> None:
        """Let an image pass the camera, ``gap`` clocks from now; ``end``: its end is reported right after."""
        rows, columns = image.shape[:2]
        starts = self.core.clock + gap + max(columns - 1 + blanking, row_period) * np.arange(rows, dtype=np.int64)
        # The end is reported in the first clock without a pixel.
        self.core.rows(starts, image, frame_first=True, end=int(starts[-1]) + columns if end else None)
        self._run(int(starts[-1]) + columns + 1)

    def finish(self, count: int) -> list[Frame]:
        """The frames of all images shown, of which there must be ``count``; waits until the link is silent."""
        silent = 0
        while silent < 3:
            silent = 0 if self._run(self.core.clock + SLICE) else silent + 1
        frames, self._frames = self._frames, []
        assert len(frames) == count, f"{len(frames)} frames came instead of {count}"
        return frames

    def _run(self, until: int) -> bool:
        """Run and read; whether anything came."""
        came = False
        while self.core.clock < until:
            self.core.run(min(self.core.clock + SLICE, until))
            data = self.core.receive()
            came |= bool(data)
            for packet in self._deframer.feed(data):
                if packet.type == PacketType.FRAME:
                    self._frames.append(decode_frame(packet.payload))
        assert not self._deframer.damaged, "a packet was damaged on the way"
        return came
