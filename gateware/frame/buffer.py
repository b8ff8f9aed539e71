"""Two buffers for frames: one fills while the other is sent."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from magtrak.protocol import MAX_EDGES

from ..layouts import Edge, Rows
from .facts import FrameReader, ImageFacts, MotionFacts, StartFacts, VisionFacts
from .header import HeaderStore
from .rows import RowStore


class FrameBuffer(wiring.Component):
    """Holds whole images until they are sent; the camera never waits.

    The first pixel of an image claims a free buffer. Without one an image is dropped whole, and counted: the new one;
    or, when the link has stood still for the whole image before, the one that is complete and waits, so that a host
    that reads again gets the newest one after the one that was under way.

    Frames leave in order, and one that is being sent is never written. ``rows`` of the header counts what was
    written for this very image: rows that earlier ones left behind are never sent.

    Reset empties both buffers.

    Parameters
    ----------
    max_rows : rows of a buffer in the full form, a power of two; in the compact form there are four times as many, up
        to 2048. Rows beyond are left out, and the header says so
    edge_log, close_images, fast_clock : as in :class:`~gateware.frame.header.HeaderStore`

    Members
    -------
    frame_first : strobe: the first pixel of an image
    refused : strobe: an image that came was not let in; counted as seen and dropped
    frame_end : strobe: the image is over; after its last pixel and before the next ``frame_first``
    form : of the rows of the image, a ``RowForm``; sampled at ``frame_first``
    start : of the image, from the clock after its ``frame_first`` on for :data:`~gateware.frame.facts.STEADY_CLOCKS`
    image : sampled at ``frame_end``
    rows, vision : results of the images, in order; ``vision`` as of ``rows.frame_end``
    take : strobe at ``frame_end`` of an image that has a buffer
    first_is_last : strobe: ``motion.last`` is that of the first row; only looked at without ``close_images``
    taken : strobe for each ``take``, in order and at least 112 clocks apart: its motion is known
    motion : sampled at ``taken``
    edge_index, edge : entry of the edge log as of ``taken``; ``edge`` follows the index by a clock
    moving : strobe: the link took a byte
    damaged_commands, line_errors : for the header
    frames, dropped : images seen, and those of them that were dropped
    number : of the image that began last
    reader : the oldest complete frame
    """

    def __init__(
        self, max_rows: int, *, edge_log: bool = True, close_images: bool = True, fast_clock: bool = True
    ) -> None:
        self.row_store = RowStore(max_rows, close_images=close_images, fast_clock=fast_clock)
        self.header_store = HeaderStore(edge_log=edge_log, close_images=close_images, fast_clock=fast_clock)
        self.max_rows = max_rows
        super().__init__(
            {
                "frame_first": In(1),
                "refused": In(1),
                "frame_end": In(1),
                "form": In(1),
                "start": In(StartFacts),
                "image": In(ImageFacts),
                "rows": In(Rows()),
                "vision": In(VisionFacts),
                "take": Out(1),
                "first_is_last": In(1),
                "taken": In(1),
                "motion": In(MotionFacts),
                "edge_index": Out(range(MAX_EDGES)),
                "edge": In(Edge),
                "moving": In(1),
                "damaged_commands": In(16),
                "line_errors": In(16),
                "frames": Out(32),
                "dropped": Out(32),
                "number": Out(32),
                "reader": Out(FrameReader(max_rows)),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.rows = rows = self.row_store
        m.submodules.header = header = self.header_store
        reader = self.reader

        busy = Signal(2)  # claimed, and not sent yet
        filled = Signal(2)  # rows complete
        complete = Signal(2)  # header complete as well
        claiming = Signal()  # the buffer whose turn it is
        sending = Signal()

        moved = Signal()  # since the first pixel of the image before
        free = Signal()  # the buffer whose turn it is
        gives_way = Signal()  # the one that waits behind it
        accepts = Signal()  # an image that begins now has a buffer
        accepted = Signal()  # the present one has
        into = Signal()  # which buffer the one that begins now has
        filling = Signal()  # which the present one has
        forms = Signal(2)
        begun = Signal()  # an image, a clock ago
        m.d.comb += [
            free.eq(~busy.bit_select(claiming, 1)),
            gives_way.eq(~free & ~moved & complete.bit_select(~sending, 1)),
            accepts.eq(free | gives_way),
            into.eq(Mux(free, claiming, ~sending)),
            self.take.eq(self.frame_end & accepted),
            rows.frame_first.eq(begun),
            rows.accepted.eq(accepted),
            rows.into.eq(filling),
            rows.forms.eq(forms),
            rows.vision.eq(self.vision),
            header.begin.eq(self.frame_first & accepts),
            header.into.eq(into),
            header.start.eq(self.start),
            header.forms.eq(forms),
            header.number.eq(self.number),
            header.take.eq(self.take),
            header.ends.eq(filling),
            header.image.eq(self.image),
            header.first_is_last.eq(self.first_is_last & accepted),
            header.taken.eq(self.taken),
            header.motion.eq(self.motion),
            header.dropped.eq(self.dropped),
            header.damaged_commands.eq(self.damaged_commands),
            header.line_errors.eq(self.line_errors),
            self.edge_index.eq(header.edge_index),
            header.edge.eq(self.edge),
            header.filled.eq(filled),
            rows.bank.eq(sending),
            rows.index.eq(reader.row_index),
            reader.row.eq(rows.word),
            header.bank.eq(sending),
            header.index.eq(reader.word_index),
            reader.word.eq(header.word),
            reader.ready.eq(complete.bit_select(sending, 1)),
        ]
        connect(m, flipped(self.rows), rows.rows)
        for bank in range(2):
            m.d.comb += header.rows[bank].eq(rows.facts[bank])

        with m.If(reader.done):
            m.d.sync += sending.eq(~sending)
        with m.If(self.frame_first):
            m.d.sync += [self.number.eq(self.frames), accepted.eq(accepts), filling.eq(into)]
            with m.If(free):
                m.d.sync += claiming.eq(~claiming)
        with m.If(self.frame_first | self.refused):
            m.d.sync += self.frames.eq(self.frames + 1)
        with m.If((self.frame_first & ~free) | self.refused):
            m.d.sync += self.dropped.eq(self.dropped + 1)
        m.d.sync += begun.eq(self.frame_first)
        m.d.sync += moved.eq(self.moving | (moved & ~self.frame_first))
        for bank in range(2):
            with m.If(self.frame_first & accepts & (into == bank)):
                m.d.sync += [busy[bank].eq(1), filled[bank].eq(0), complete[bank].eq(0), forms[bank].eq(self.form)]
            with m.If(rows.filled & (rows.filled_bank == bank)):
                m.d.sync += filled[bank].eq(1)
            with m.If(header.complete & (header.complete_bank == bank)):
                m.d.sync += complete[bank].eq(1)
            with m.If(reader.done & (sending == bank)):
                m.d.sync += [busy[bank].eq(0), filled[bank].eq(0), complete[bank].eq(0)]

        return m
