"""From a camera's clock to the card's: rows and frames are formed, carried over, and given their pauses."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.cdc import FFSynchronizer
from amaranth.lib.fifo import AsyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from ..layouts import Field, Video
from .monitor import MIN_BLANKING, MIN_FRAME_GAP, MIN_ROW_PERIOD

VERTICAL_CLOCKS = 8
"""Camera clocks for which the vertical sync must be on to end an image: a shorter pulse is a glitch."""


_MARGIN = 4  # words that may be under way to the FIFO when it has no more room


class Sampled(wiring.Signature):
    """A camera's bus after its own decoding, in the ``camera`` domain, everything active high.

    Members
    -------
    row : within a row; low between rows
    valid : a pixel is there; only while ``row``
    r, g, b : the pixel
    broken : strobe, in the first clock after a row: it did not end with a whole pixel
    vertical : vertical sync; an image ends, and the next one begins, where it goes on
    field : of the image whose first pixel is there
    """

    def __init__(self) -> None:
        super().__init__(
            {
                "row": Out(1),
                "valid": Out(1),
                "r": Out(8),
                "g": Out(8),
                "b": Out(8),
                "broken": Out(1),
                "vertical": Out(1),
                "field": Out(Field),
            }
        )


class _Word(data.Struct):
    """What the FIFO carries: a pixel, the end of an image, or (``mark``) a fault, with what to count in r and g."""

    r: 8
    g: 8
    b: 8
    valid: 1
    row_first: 1
    row_last: 1
    frame_first: 1
    frame_end: 1
    mark: 1
    field: Field


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
            width=_Word.as_shape().size, depth=self.depth + 1, w_domain="camera", r_domain="sync"
        )
        self._form(m, fifo)
        self._pace(m, fifo)
        return m

    def _form(self, m: Module, fifo) -> None:
        """In ``camera``: words into the FIFO."""
        i = self.i
        enabled = Signal()
        m.submodules.synchronizer = FFSynchronizer(self.enable, enabled, o_domain="camera")
        stable = Signal(range(VERTICAL_CLOCKS + 1))
        boundary = Signal()  # strobe: an image ends, the next begins
        with m.If(~i.vertical):
            m.d.camera += stable.eq(0)
        with m.Elif(stable != VERTICAL_CLOCKS):
            m.d.camera += stable.eq(stable + 1)
        m.d.camera += boundary.eq(i.vertical & (stable == VERTICAL_CLOCKS - 1))

        # The rest of a row in which the boundary came belongs to no image.
        skipping = Signal()
        m.d.camera += skipping.eq(i.row & (skipping | boundary))
        active, pixel = Signal(), Signal()
        dropping = Signal(init=1)  # until the next image
        m.d.comb += [active.eq(i.row & ~skipping & ~boundary), pixel.eq(i.valid & active & ~dropping)]

        held = Signal(_Word)
        holding = Signal()
        row_starts = Signal(init=1)  # the next pixel is the first of its row
        frame_starts = Signal()  # and of its image
        with m.If(pixel):
            m.d.camera += [
                held.r.eq(i.r),
                held.g.eq(i.g),
                held.b.eq(i.b),
                held.row_first.eq(row_starts),
                held.frame_first.eq(frame_starts),
                held.field.eq(i.field),
                row_starts.eq(0),
                frame_starts.eq(0),
            ]
        with m.If(~active):
            m.d.camera += row_starts.eq(1)

        # A held pixel goes out before a mark does: that finds a free clock, since the next row's first is held a clock.
        release = Signal()
        end_due, broken_due, cut_due = Signal(), Signal(), Signal()
        breaks = Signal()
        lost = Signal(8)  # images, to be told with the cut
        # A stage before the FIFO, and a look at its level that is three clocks old: both for speed.
        word, put = Signal(_Word), Signal()
        room = Signal()
        m.d.camera += [fifo.w_data.eq(word), fifo.w_en.eq(put & room), room.eq(fifo.w_level < self.depth - _MARGIN)]
        m.d.comb += [
            breaks.eq((i.broken | (boundary & i.row)) & ~dropping),
            release.eq(holding & (pixel | ~active)),
        ]
        with m.If(dropping):
            m.d.comb += [
                put.eq(cut_due | end_due),
                word.valid.eq(cut_due),
                word.frame_end.eq(1),
                word.mark.eq(cut_due),
                word.r.eq(lost),
            ]
        with m.Elif(release):
            m.d.comb += [put.eq(1), word.eq(held), word.valid.eq(1), word.row_last.eq(~active)]
        with m.Elif(end_due | broken_due):
            m.d.comb += [
                put.eq(1),
                word.valid.eq(broken_due),
                word.frame_end.eq(end_due),
                word.mark.eq(broken_due),
                word.g.eq(1),
            ]
        overflow = Signal()
        m.d.comb += overflow.eq(put & ~room & ~dropping)
        marked = ~release & ~dropping  # what was due is written
        m.d.camera += [
            holding.eq(pixel | (holding & ~release)),
            end_due.eq((boundary & ~dropping) | (end_due & ~marked)),
            broken_due.eq(breaks | (broken_due & ~marked)),
        ]
        with m.If(boundary):
            m.d.camera += frame_starts.eq(1)
        with m.If(overflow):
            m.d.camera += [dropping.eq(1), cut_due.eq(1), end_due.eq(0), lost.eq(1 + boundary)]
        with m.Elif(dropping):
            m.d.camera += [holding.eq(0), broken_due.eq(0)]
            with m.If(room):
                m.d.camera += [cut_due.eq(0), end_due.eq(0)]
            with m.If(boundary & enabled & (~cut_due | room)):
                m.d.camera += dropping.eq(0)
            with m.Elif(boundary & cut_due & ~lost.all()):
                m.d.camera += lost.eq(lost + 1)
        with m.Elif(boundary & ~enabled):
            m.d.camera += dropping.eq(1)

    def _pace(self, m: Module, fifo) -> None:
        """In ``sync``: words out of the FIFO."""
        video = self.video
        word = Signal(_Word)
        taken, wait = Signal(), Signal()
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
        m.d.sync += [
            video.pixel.valid.eq(taken & word.valid),
            video.frame_end.eq(taken & word.frame_end),
            video.field.eq(word.field),
        ]
        for name in ("r", "g", "b"):
            m.d.sync += video.pixel.p[name].eq(Mux(word.mark, 0, word[name]))
        for name in ("row_first", "row_last", "frame_first"):
            m.d.sync += video.pixel.p[name].eq(word[name])
        for counter, number in ((self.cut, word.r), (self.broken, word.g)):
            sum_ = Signal(9, name=f"{counter.name}_sum")
            m.d.comb += sum_.eq(counter + number)
            with m.If(taken & word.mark):
                m.d.sync += counter.eq(sum_[:8] | sum_[8].replicate(8))
