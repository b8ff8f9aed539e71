"""Rows and frames out of a camera's bus."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ..layouts import Field, Video

VERTICAL_CLOCKS = 8
"""Camera clocks for which the vertical sync must be on to end an image: a shorter pulse is a glitch."""


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


class Word(data.Struct):
    """A pixel, the end of an image, or (``mark``) a fault, with what to count in r and g."""

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


class Forming(wiring.Component):
    """Makes words of what was sampled, all in ``camera``.

    A pixel waits for the next one or the end of its row, so that the last has ``row_last``. Where there is no room for
    a word the image is cut; a row with half a pixel, or in which the vertical sync comes on, is broken; and nothing
    comes before the first vertical sync: see :class:`~gateware.camera.crossing.Crossing`.

    Latency none from the clock after a pixel, or the end of its row, to ``word``.

    Members
    -------
    i : the camera's bus
    enable : images may begin
    room : there is room for a word
    put, word : a word, of which nobody knows where there is no room
    """

    def __init__(self) -> None:
        super().__init__({"i": In(Sampled()), "enable": In(1), "room": In(1, init=1), "put": Out(1), "word": Out(Word)})

    def elaborate(self, platform):
        m = Module()
        i, enabled, room, word, put = self.i, self.enable, self.room, self.word, self.put
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
        active = Signal()
        pixel = Signal()
        dropping = Signal(init=1)  # until the next image
        m.d.comb += [active.eq(i.row & ~skipping & ~boundary), pixel.eq(i.valid & active & ~dropping)]

        held = Signal(Word)
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
        end_due = Signal()
        broken_due = Signal()
        cut_due = Signal()
        breaks = Signal()
        lost = Signal(8)  # images, to be told with the cut
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
        return m


def told(m: Module, domain: str, taken, word, video, counters: dict[str, Signal]) -> None:
    """Words as ``video``, a clock later; what their marks count, in those of ``cut`` and ``broken`` that are there."""
    here = m.d[domain]
    here += [
        video.pixel.valid.eq(taken & word.valid),
        video.frame_end.eq(taken & word.frame_end),
        video.field.eq(word.field),
    ]
    for name in ("r", "g", "b"):
        here += video.pixel.p[name].eq(Mux(word.mark, 0, word[name]))
    for name in ("row_first", "row_last", "frame_first"):
        here += video.pixel.p[name].eq(word[name])
    for name, counter in counters.items():
        sum_ = Signal(9, name=f"{name}_sum")
        m.d.comb += sum_.eq(counter + {"cut": word.r, "broken": word.g}[name])
        with m.If(taken & word.mark):
            here += counter.eq(sum_[:8] | sum_[8].replicate(8))


class Direct(wiring.Component):
    """A camera's images in its own clock, for a card that measures in it; takes the place of a
    :class:`~gateware.camera.crossing.Crossing`.

    No FIFO, nothing is cut: a pixel a clock. Pauses are those of the camera, and what is too short of them the Monitor
    reports. Latency 2 clocks from the clock after a pixel to ``video``.

    Members
    -------
    i, video, broken : as of :class:`~gateware.camera.crossing.Crossing`, all in ``camera``
    """

    i: In(Sampled())
    video: Out(Video())
    broken: Out(8)

    def elaborate(self, platform):
        m = Module()
        m.submodules.forming = forming = Forming()
        connect(m, flipped(self.i), forming.i)
        m.d.comb += [forming.enable.eq(1), forming.room.eq(1)]
        word = Signal(Word)
        put = Signal()
        m.d.camera += [word.eq(forming.word), put.eq(forming.put)]
        told(m, "camera", put, word, self.video, {"broken": self.broken})
        return m
