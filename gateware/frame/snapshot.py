"""Pictures of what the card sees, a piece at a time."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak import reference
from magtrak.protocol import SNAPSHOT, SNAPSHOT_PIXELS, SnapshotSource

from ..camera.monitor import CheckedPixel
from ..layouts import NowSettings, Packets, struct
from ..memory import BlockRam
from ..select import one_of
from ..vision.pixels import MeasuredPixel

SLOTS = 8
"""Pieces that the memory holds."""

SLOT_WORDS = 128
_WORD_BYTES = 3
_HEADER_WORDS = SNAPSHOT.size // _WORD_BYTES
_HEADER_AT = SLOT_WORDS - _HEADER_WORDS  # at the end of the slot: the pixels follow when the address wraps
assert SNAPSHOT.size % _WORD_BYTES == 0 and _HEADER_WORDS <= 8 and SNAPSHOT_PIXELS <= SLOT_WORDS - 8

_SOURCE_AT, _PIXELS_AT = (
    next(offset for offset, field in SNAPSHOT if field.name == name) for name in ("source", "pixels")
)


class Snapshot(wiring.Component):
    """Looks over the shoulder of the measurement, without ever holding it up.

    A region of the image, thinned in both directions, is taken in strips of up to ``SNAPSHOT_PIXELS`` pixels' width, a
    row of a strip at a time, into one of :data:`SLOTS` slots of a memory, from which it goes to the link. A piece that
    finds no free slot when its row comes, or whose row comes while the one before is being closed (9 clocks), is
    taken from a later image: pieces leave in order and none is missing. A piece is of one image, and says of which.

    A region that reaches beyond the image ends where the image ends. The last piece has no pixels.

    The other settings are taken over when ``settings.snapshot`` changes. Pieces that are complete by then are still
    sent.

    Members
    -------
    settings : those of the snapshot are used
    raw, measured : pixels, always ready
    frame, generation : of the image that began last; at its first pixel here they are its own
    busy : pieces are still to be taken
    o : payloads of ``PacketType.SNAPSHOT``; a byte a clock, and 3 clocks more for each pixel
    """

    settings: In(NowSettings)
    raw: In(stream.Signature(CheckedPixel, always_ready=True))
    measured: In(stream.Signature(MeasuredPixel, always_ready=True))
    frame: In(32)
    generation: In(16)
    busy: Out(1)
    o: Out(Packets)

    reference = staticmethod(reference.snapshot)

    def elaborate(self, platform):
        m = Module()
        # A slot that is being written may be read too, but nothing comes of that: it waits to be complete.
        m.submodules.memory = memory = BlockRam(8 * _WORD_BYTES, SLOTS * SLOT_WORDS, registered=True)
        stored = Signal()
        sent = Signal()
        filled = Signal(range(SLOTS + 1))
        free = Signal()  # two clocks late: between two pieces there are more
        m.d.sync += [filled.eq(filled + stored - sent), free.eq(filled != SLOTS)]
        self._take(m, memory.write, free, stored)
        self._send(m, memory.read, filled != 0, sent)
        return m

    def _take(self, m, write, free, stored):
        """Pixels into slots; ``stored``: one more is complete."""
        settings = self.settings
        # Of these one is set.
        idle = Signal(init=1)
        settling = Signal()  # the next row and strip are compared with the region
        checking = Signal()  # is there a next piece?
        wanting = Signal()  # its first pixel is to come
        taking = Signal()
        concluding = Signal()  # the piece without pixels is next
        heading = Signal()  # the header is written
        number = Signal(8)
        source = Signal(SnapshotSource)
        step = Signal(6)
        column_last = Signal(12)
        row_first = Signal(12)
        row_last = Signal(12)
        started = Signal()
        m.d.sync += started.eq((settings.snapshot != number) & ~started)
        m.d.comb += self.busy.eq(~idle)

        # The pixel in question, and where it stands.
        place = data.StructLayout({"row_first": 1, "row_last": 1, "frame_first": 1, "fault": 1})
        raw, measured = self.raw, self.measured
        coming = Signal(place)
        colour = Signal(8 * _WORD_BYTES)
        comes = Signal()
        with m.If(source == SnapshotSource.RAW):
            m.d.comb += [comes.eq(raw.valid), colour.eq(Cat(raw.p.r, raw.p.g, raw.p.b))]
            m.d.comb += [coming[name].eq(raw.p[name]) for name, _ in place]
        with m.Else():
            grey = Mux(source == SnapshotSource.GATE, measured.p.gate.replicate(8), measured.p.weight)
            m.d.comb += [comes.eq(measured.valid), colour.eq(Cat(grey, raw.p.g, raw.p.b))]  # two bytes mean nothing
            m.d.comb += [coming[name].eq(measured.p[name]) for name, _ in place]
        pixel = Signal(place)
        pixel_colour = Signal(8 * _WORD_BYTES)
        valid = Signal()
        at_row = Signal(12)
        at_column = Signal(12)
        fault = Signal()  # the row broke the contract so far
        # What comes, a clock before.
        came = Signal()
        came_pixel = Signal(place)
        came_colour = Signal(8 * _WORD_BYTES)
        m.d.sync += [came.eq(comes), came_pixel.eq(coming), came_colour.eq(colour)]
        m.d.sync += [valid.eq(came), pixel.eq(came_pixel), pixel_colour.eq(came_colour)]
        with m.If(valid):
            m.d.sync += fault.eq(pixel.fault | (fault & ~pixel.row_first))
        with m.If(comes):
            m.d.sync += at_column.eq(Mux(coming.row_first, 0, at_column + 1))
            with m.If(coming.row_first):
                m.d.sync += at_row.eq(Mux(coming.frame_first, 0, at_row + 1))

        # Places are known from the first image on that begins after the source was chosen.
        begins = Signal()
        beginning = Signal()  # a clock before
        settled = Signal()
        seen = Signal()
        known = Signal()  # places will be, in the next clock
        frame = Signal(32)
        generation = Signal(16)
        m.d.comb += [
            beginning.eq(came & came_pixel.frame_first & settled & ~started),
            known.eq(~started & (seen | begins | beginning)),
        ]
        m.d.sync += [settled.eq(~started), begins.eq(beginning)]
        with m.If(begins):
            m.d.sync += [frame.eq(self.frame), generation.eq(self.generation), seen.eq(1)]

        # The piece in question: a row of a strip.
        slot = Signal(range(SLOTS))
        count = Signal(7)
        row = Signal(12)
        strip = Signal(12)  # its first column
        column = Signal(12)  # the next one
        following = Signal(12)  # the one after that
        next_strip = Signal(12)
        finishing = Signal()
        ended = Signal()  # no strip follows; also as long as this one has no row
        due = Signal()  # the row was to come in this image
        there = Signal()  # it did
        over = Signal()  # the image has no such row
        row_over = Signal()  # the region has none
        strip_over = Signal()
        narrow = Signal()  # the strip has not come in this row, all of which was seen
        in_row = Signal()
        hit = Signal()
        border = Signal()
        filling = Signal()
        last_sound = Signal()  # the last pixel of the row, which has kept the contract here
        # Places are compared a clock ahead, columns with both of what may be next by then. Rows and strips change at
        # least a clock before a pixel is waited for.
        takes = Signal()
        taken = Signal()
        of_row = Signal()
        at_next = Signal()
        at_following = Signal()
        m.d.comb += of_row.eq(came & (at_row == row) & known)
        m.d.sync += [
            in_row.eq(of_row),
            at_next.eq(of_row & (at_column == column)),
            at_following.eq(of_row & (at_column == following)),
            last_sound.eq(came_pixel.row_last & ~came_pixel.fault),
            border.eq(came_pixel.row_last | (at_column == column_last)),
            taken.eq(takes),
            # The pixel is the last that a piece has room for.
            filling.eq(Mux(takes, count == SNAPSHOT_PIXELS - 2, count == SNAPSHOT_PIXELS - 1)),
            row_over.eq(row > row_last),
            strip_over.eq(strip > column_last),
        ]
        m.d.comb += hit.eq(Mux(taken, at_following, at_next))

        header = Signal(struct(SNAPSHOT))
        for name, value in (
            *(("frame", frame), ("generation", generation), ("number", number), ("source", source)),
            *(("row", row), ("column", strip), ("step", step), ("flags", fault & ~finishing), ("pixels", count)),
        ):
            m.d.comb += header[name].eq(value)
        m.d.comb += takes.eq(hit & (taking | (wanting & free)))
        heads = Signal(_HEADER_WORDS)  # the word of the header that is written
        plain = Signal(init=1)  # none is
        writes_header = heads.any()
        m.d.sync += [
            write.en.eq(takes | writes_header),
            write.addr.eq(Cat(Mux(writes_header, _number(heads), count), slot)),
            write.data.eq(one_of([*_words(header), pixel_colour], Cat(heads, plain))),
            heads.eq(heads << 1),
            plain.eq(1),
        ]

        row_ends = Signal()  # no more of this row
        returns = Signal()  # the row has not come in a whole image
        misses = Signal()  # the image has no such columns
        passed = Signal()  # no more rows in this strip
        left = Signal()  # the header is whole
        begun = ~started
        m.d.comb += [
            row_ends.eq((takes & (border | filling)) | (taking & in_row & border)),
            returns.eq(wanting & begins & due & ~there),
            misses.eq(wanting & in_row & last_sound & narrow & ~fault & ~hit),
            passed.eq(over | row_over),
            left.eq(heading & heads[-1]),
        ]
        m.d.sync += [
            idle.eq(Mux(started, settings.snapshot == 0, idle | (left & finishing))),
            settling.eq(begun & ((checking & passed & ~ended) | (left & ~finishing))),
            checking.eq(Mux(started, settings.snapshot != 0, settling | (returns & ~takes & ~misses))),
            wanting.eq(begun & ((checking & ~passed & ~strip_over) | (wanting & ~returns & ~takes & ~misses))),
            taking.eq(begun & (takes | taking) & ~row_ends),
            concluding.eq(
                begun & ((checking & Mux(passed, ended, strip_over)) | misses | (concluding & ~free)),
            ),
            heading.eq(begun & (row_ends | (concluding & free) | (heading & ~heads[-1]))),
            stored.eq(left),
        ]
        with m.If(settling | concluding):
            m.d.sync += count.eq(0)
        with m.If(checking):
            m.d.sync += [following.eq(strip + step), there.eq(0), over.eq(0)]
            with m.If(passed):
                m.d.sync += [strip.eq(next_strip), column.eq(next_strip), row.eq(row_first), ended.eq(1)]
        with m.If(wanting):
            with m.If(begins):
                m.d.sync += [due.eq(1), there.eq(in_row)]
            with m.Elif(in_row):
                m.d.sync += there.eq(1)
        with m.If(returns):
            m.d.sync += over.eq(1)
        with m.If(concluding):
            m.d.sync += finishing.eq(1)
        with m.If(heading):
            m.d.sync += [heads[0].eq(plain), plain.eq(heads[-1])]
        with m.If(left):
            m.d.sync += [slot.eq(slot + 1), row.eq(row + step), column.eq(strip)]

        with m.If(valid & pixel.row_first):
            m.d.sync += narrow.eq(wanting & ~hit)
            with m.If(~wanting):  # it may have come unseen
                m.d.sync += due.eq(0)
        with m.Elif(hit):
            m.d.sync += narrow.eq(0)
        with m.If(takes):
            m.d.sync += [count.eq(count + 1), column.eq(following), following.eq(following + step)]
        with m.If(takes | taking):  # what the row's end leaves of this counts
            m.d.sync += [ended.eq(border), next_strip.eq(following), due.eq(1)]

        with m.If(started):
            m.d.sync += [
                number.eq(settings.snapshot),
                source.eq(settings.snapshot_source),
                step.eq(settings.snapshot_step),
                column_last.eq(settings.snapshot_column_last),
                row_first.eq(settings.snapshot_row_first),
                row_last.eq(settings.snapshot_row_last),
                next_strip.eq(settings.snapshot_column_first),
                *(over.eq(1), seen.eq(0), due.eq(0), ended.eq(0), finishing.eq(0), heads.eq(0), plain.eq(1)),
            ]

    def _send(self, m, read, ready, sent):
        """Slots into payloads; ``sent``: one is free again."""
        slot = Signal(range(SLOTS))
        index = Signal(range(SLOT_WORDS))
        fetched = read.data
        hot = Signal(_WORD_BYTES)  # the byte of it that is next
        only = Signal()  # the first one counts
        pixels = Signal(7)  # from the header's last word on: to come, with this one
        raw = Signal()
        in_header = Signal()
        ends = Signal()
        # All of these stand still while bytes are sent, for long enough before they count.
        m.d.sync += [
            in_header.eq(index[3:].all()),
            ends.eq(Mux(index[3:].all(), index.all() & (pixels == 0), pixels == 1)),
            only.eq(~index[3:].all() & ~raw),
        ]
        m.d.comb += [
            read.addr.eq(Cat(index, slot)),
            read.en.eq(1),
            self.o.payload.data.eq(one_of([fetched.word_select(n, 8) for n in range(_WORD_BYTES)], hot)),
            self.o.payload.last.eq(ends & (hot[-1] | only)),
        ]
        with m.FSM():
            with m.State("Wait"):
                m.d.sync += index.eq(_HEADER_AT)
                with m.If(ready):
                    m.next = "Fetch"
            with m.State("Fetch"):
                m.next = "Settle"
            with m.State("Settle"):
                m.next = "Load"
            with m.State("Load"):
                m.d.sync += hot.eq(1)
                with m.If(index == _HEADER_AT + _SOURCE_AT // len(fetched)):
                    m.d.sync += raw.eq(fetched[_SOURCE_AT % len(fetched) :][:8] == SnapshotSource.RAW)
                with m.If(index.all()):
                    m.d.sync += pixels.eq(fetched[_PIXELS_AT % len(fetched) :])
                m.next = "Send"
            with m.State("Send"):
                m.d.comb += self.o.valid.eq(1)
                with m.If(self.o.ready):
                    m.d.sync += hot.eq(hot << 1)
                    with m.If(hot[-1] | only):
                        m.d.sync += index.eq(index + 1)
                        with m.If(~in_header):
                            m.d.sync += pixels.eq(pixels - 1)
                        m.next = "Fetch"
                        with m.If(ends):
                            m.next = "Done"
            with m.State("Done"):
                m.d.comb += sent.eq(1)
                m.d.sync += slot.eq(slot + 1)
                m.next = "Wait"


def _words(header) -> list:
    """The header's words."""
    return [header.as_value().word_select(at, 8 * _WORD_BYTES) for at in range(_HEADER_WORDS)]


def _number(heads):
    """Where in a slot the word of the header is whose bit is set."""
    places = [_HEADER_AT + at for at in range(_HEADER_WORDS)]
    return Cat(
        Cat(head for head, place in zip(heads, places, strict=True) if place >> bit & 1).any() for bit in range(7)
    )
