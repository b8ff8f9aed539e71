"""From a camera's clock to the card's: rows and frames are formed, carried over, and given their pauses."""

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.fifo import AsyncFIFOBuffered
from amaranth.lib.wiring import In, Out, connect, flipped

from ..layouts import Video
from .forming import Forming, Sampled, Word, told
from .monitor import MIN_BLANKING, MIN_FRAME_GAP, MIN_ROW_PERIOD

_MARGIN = 4  # words that may be under way to the FIFO when it has no more room


class Crossing(wiring.Component):
    """Takes images from the ``camera`` domain into ``sync`` and keeps the contract of :class:`~gateware.layouts.Video`.

    A pixel waits for the next one or the end of its row, so that the last has ``row_last``. In ``sync`` the rows go
    out as they come, but for pauses that are shorter than the contract has them: there the first pixel of a row waits,
    and the FIFO holds what follows. So the camera may be faster than the card within a row, if not on average.

    What cannot be kept is never passed on as something else:

    - Where the FIFO is full the image is cut: its rest is left out, and a black pixel outside of any order ends it,
      which makes the :class:`~gateware.camera.monitor.Monitor` report ``framing``. The next image begins with the next
      vertical sync. ``cut`` counts images that lost anything so, also those lost whole.
    - A row with half a pixel is followed by such a black pixel, too, which the Monitor leaves out and reports.
      ``broken`` counts them, and rows in which the vertical sync came on.

    Nothing goes out before the first vertical sync: a camera may be in the middle of an image. While ``enable`` is
    low none begins.

    Latency: 3 camera clocks and 2 to 5 card clocks from a pixel to ``video``, while nothing waits.
    Throughput: a pixel a clock, of the slower clock on average.

    Parameters
    ----------
    depth : words of the FIFO, a power of two from 16 on; 512 is one block RAM of an ECP5

    Members
    -------
    i : the camera's bus, in ``camera``
    enable : images may begin
    video : images, in ``sync``
    cut, broken : see above; saturating

    Raises
    ------
    ValueError
        The depth is not possible.
    """

    def __init__(self, depth: int = 512) -> None:
        if depth < 16 or depth & (depth - 1):
            raise ValueError(f"depth is {depth}; powers of two from 16 on are possible")
        self.depth = depth
        super().__init__(
            {
                "i": In(Sampled()),
                "enable": In(1, init=1),
                "video": Out(Video()),
                "cut": Out(8),
                "broken": Out(8),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.fifo = fifo = AsyncFIFOBuffered(
            width=Word.as_shape().size, depth=self.depth + 1, w_domain="camera", r_domain="sync"
        )
        m.submodules.forming = forming = Forming()
        m.submodules.synchronizer = FFSynchronizer(self.enable, forming.enable, o_domain="camera")
        connect(m, flipped(self.i), forming.i)
        # A stage before the FIFO, and a look at its level that is three clocks old: both for speed.
        m.d.camera += [
            fifo.w_data.eq(forming.word),
            fifo.w_en.eq(forming.put & forming.room),
            forming.room.eq(fifo.w_level < self.depth - _MARGIN),
        ]
        self._pace(m, fifo)
        return m

    def _pace(self, m: Module, fifo) -> None:
        """In ``sync``: words out of the FIFO."""
        video = self.video
        word = Signal(Word)
        taken = Signal()
        wait = Signal()
        left = Signal(range(MIN_FRAME_GAP))  # clocks in which no row may begin
        pause = Signal()  # left != 0, ahead of time
        m.d.comb += [
            word.eq(fifo.r_data),
            wait.eq(word.row_first & pause),
            fifo.r_en.eq(~wait),
            taken.eq(fifo.r_rdy & ~wait),
        ]
        with m.If(taken & word.frame_end):
            m.d.sync += [left.eq(MIN_FRAME_GAP - 1), pause.eq(1)]
        with m.Elif(taken & word.row_first):
            m.d.sync += [left.eq(MIN_ROW_PERIOD - 1), pause.eq(1)]
        with m.Elif(taken & word.row_last & (left < MIN_BLANKING)):
            m.d.sync += [left.eq(MIN_BLANKING - 1), pause.eq(1)]
        with m.Elif(pause):
            m.d.sync += [left.eq(left - 1), pause.eq(left != 1)]
        told(m, "sync", taken, word, video, {"cut": self.cut, "broken": self.broken})
