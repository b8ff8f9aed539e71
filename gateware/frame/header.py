"""Headers and edge logs of two frames."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import FRAME, FRAME_FLAGS, MAX_EDGES, Layout, Phase

from ..layouts import Edge, Field
from ..memory import BlockRam
from ..select import Picked
from .facts import EDGE_BASE, EDGE_WORDS, HEADER_WORDS, WORDS, ImageFacts, MotionFacts, RowFacts, StartFacts

_EDGE_BITS = EDGE_BASE.bit_length() - 1

_START_WORDS = [
    next(at for at, field in FRAME if field.name == name) // 32 for name in ("frame", "exposure_us", "time_offset_ns")
]
"""Words of the header that are known at the beginning of an image."""


def _stamp(when: str) -> range:
    """Words of the header that are the stamp of a row."""
    ends = [next(at for at, field in FRAME if field.name == f"{when}_{name}") // 32 for name in ("time", "period")]
    return range(ends[0], ends[1] + 1)


_FIRST, _LAST = _stamp("first"), _stamp("last")


class HeaderStore(wiring.Component):
    """Puts the headers of frames together, each in one of two banks, as 32-bit words.

    A header's parts come at four moments: ``begin``, ``take``, later ``taken``, and ``filled`` before or after
    it. What is wide goes to the memory as soon as it is known: settings and number after ``begin``, edges after
    ``taken``, all else after the later of the last two moments.

    That takes at most ``copy_clocks`` from ``taken``, or 60 from ``filled``. The next ``taken``
    must not come earlier: images are at least 112 clocks apart, which is enough.

    Parameters
    ----------
    edge_log : without it no edges are copied
    close_images : an image may begin right after the one before, of which all is kept for that here. Without it
        settings, number, rows and motion stay what they were until the header is complete, and only the first row's
        stamp goes to the memory sooner: by ``first_is_last``. The header is complete 140 clocks after the later of
        ``taken`` and ``filled`` at most; counters that are sampled then may be newer.
    fast_clock : the word goes through a register behind the memory; without it, it comes a clock sooner

    Members
    -------
    begin, into : strobe: an image that is accepted begins; its bank, which is not that of a header still to be
        completed
    start, number : of that image, from the clock after on for :data:`~gateware.frame.facts.STEADY_CLOCKS`
    forms : of the images in both banks
    take, ends : strobe: an accepted image ends; its bank
    image : sampled then
    first_is_last : strobe, in an accepted image of which ``close_images`` is not built: ``motion.last`` is that of the
        first row, for :data:`~gateware.motion.angle.FIRST_CLOCKS`; ``motion.first`` is not looked at then
    taken : strobe for each ``take``, in order: its motion is known
    motion, dropped, damaged_commands, line_errors : sampled then
    edge_index, edge : entry of the edge log as of ``taken``; ``edge`` follows the index by a clock
    filled : of each bank: its rows are complete; high until the frame was sent
    rows : of each bank: what is known of its rows
    complete, complete_bank : strobe: the header in this bank is complete
    bank, index : word to read
    word : that word, 2 clocks later
    """

    copy_clocks = EDGE_WORDS * MAX_EDGES + 2 * HEADER_WORDS + 12

    begin: In(1)
    into: In(1)
    start: In(StartFacts)
    number: In(32)
    forms: In(2)
    take: In(1)
    ends: In(1)
    image: In(ImageFacts)
    first_is_last: In(1)
    taken: In(1)
    motion: In(MotionFacts)
    dropped: In(32)
    damaged_commands: In(16)
    line_errors: In(16)
    edge_index: Out(range(MAX_EDGES))
    edge: In(Edge)
    filled: In(2)
    rows: In(RowFacts).array(2)
    complete: Out(1)
    complete_bank: Out(1)
    bank: In(1)
    index: In(range(WORDS))
    word: Out(32)

    def __init__(self, *, edge_log: bool = True, close_images: bool = True, fast_clock: bool = True) -> None:
        self.edge_log = edge_log
        self.close_images = close_images
        self.fast_clock = fast_clock
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        # As with the rows, a bank is read while it is written only before it is complete.
        m.submodules.memory = memory = BlockRam(32, 2 * WORDS)
        write, read = memory.write, memory.read
        m.d.comb += [read.addr.eq(Cat(self.index, self.bank)), read.en.eq(1)]
        if self.fast_clock:
            m.d.sync += self.word.eq(read.data)
        else:
            m.d.comb += self.word.eq(read.data)

        motion = Signal(MotionFacts)
        dropped = Signal(32)
        damaged = Signal(16)
        lost = Signal(16)
        sampled = [
            motion.eq(self.motion),
            dropped.eq(self.dropped),
            damaged.eq(self.damaged_commands),
            lost.eq(self.line_errors),
        ]
        due = Signal()  # a header is to be copied
        copying = Signal()  # its bank
        started = Signal()  # what is known early is to be written
        starting = Signal()  # into this bank
        image = Signal(ImageFacts)
        rows = Signal(RowFacts)
        m.d.comb += rows.eq(Mux(copying, self.rows[1], self.rows[0]))
        kept = data.StructLayout({"generation": 16, "detector": 8})
        begun = Signal(kept)
        starts = [Signal(kept, name=f"start{bank}") for bank in range(2)]
        with m.If(self.taken):
            m.d.sync += due.eq(1)
        if self.close_images:
            with m.If(self.begin):
                m.d.sync += [started.eq(1), starting.eq(self.into)]
            with m.If(self.taken):
                m.d.sync += sampled

            # What is narrow waits in registers.
            images = [Signal(ImageFacts, name=f"image{bank}") for bank in range(2)]
            for bank in range(2):
                with m.If(self.take & (self.ends == bank)):
                    m.d.sync += images[bank].eq(self.image)
            m.d.comb += [
                begun.eq(Mux(copying, starts[1], starts[0])),
                image.eq(Mux(copying, images[1], images[0])),
            ]

            # Banks whose motion is to come, the oldest lowest.
            queue = Signal(2)
            waiting = Signal(range(3))
            rest = Signal(2)
            left = Signal(range(3))
            m.d.comb += [rest.eq(Mux(self.taken, queue >> 1, queue)), left.eq(waiting - self.taken)]
            m.d.sync += [queue.eq(rest), waiting.eq(left + self.take)]
            with m.If(self.take):
                m.d.sync += queue.bit_select(left[0], 1).eq(self.ends)
            with m.If(self.taken):
                m.d.sync += copying.eq(queue[0])
        else:
            # One image at a time.
            m.d.comb += [*sampled, starting.eq(copying), *(begun[name].eq(self.start[name]) for name in kept.members)]
            with m.If(self.begin):
                m.d.sync += copying.eq(self.into)
            with m.If(self.take):
                m.d.sync += image.eq(self.image)
            with m.If(self.first_is_last):
                m.d.sync += started.eq(1)
        flags = {name: image[name] for name in ("speed_in_band", "laser_on", "motor_stopped")} | {
            "index_seen": motion.index_seen,
            "encoder_fault": motion.encoder_fault,
            "camera_fault": rows.vision.errors.as_value().any(),
            "rows_lost": rows.lost,
        }
        values = (
            {name: begun[name] for name in kept.members}
            | {name: image[name] for name in ("phase", "field")}
            | {"form": self.forms.bit_select(copying, 1)}
            | {name: motion[name] for name in ("edges", "edge_shift", "index_passes", "index_count", "encoder_errors")}
            | {
                f"{when}_{name}": motion[when][name]
                for when in ("first", "last")
                for name in ("time", "count", "age", "period")
            }
            | {
                "flags": _packed(FRAME_FLAGS, flags),
                "camera_errors": rows.vision.errors,
                "rows": Mux((image.phase == Phase.BACKGROUND) | (image.phase == Phase.SKIPPED), 0, rows.rows),
                "columns": rows.vision.columns,
                "dropped": dropped,
                "damaged_commands": damaged,
                "row_step": Mux(image.field == Field.PROGRESSIVE, 1, 2),
                "first_row": image.field == Field.ODD,
                "line_errors": lost,
            }
        )
        # All that is ever written: the header, with number and settings of the image that begins, and the edge. Not a
        # signal: of a word that is written its fields are put together, and nothing at other times.
        values |= {name: self.start[name] for name in ("exposure_us", "time_offset_ns")} | {"frame": self.number}
        words = Cat(_packed(FRAME, values), self.edge)
        hot = Signal(HEADER_WORDS + EDGE_WORDS)  # the word to be written, at this address
        at = Signal(range(2 * WORDS))
        wanted = Signal()

        # Words that are known at the beginning go to the memory then, all others at the end. Where motion is not kept
        # the former are the stamp of the first row, and the latter the words without it.
        step = Signal(range(EDGE_WORDS * MAX_EDGES))  # word of header or log
        logged = Signal(init=not self.edge_log)  # the edges are copied
        passing = Signal()
        of_start = Signal()
        m.d.comb += [
            self.edge_index.eq(step // EDGE_WORDS),
            passing.eq(hot[:HEADER_WORDS].any()),
            of_start.eq(Cat(hot[word] for word in _START_WORDS).any()),
        ]
        m.d.sync += [
            hot.eq(Cat(0, hot[: HEADER_WORDS - 1])),
            write.addr.eq(at),
            self.complete.eq(0),
        ]
        if self.close_images:
            m.d.sync += write.en.eq(Mux(passing, of_start == wanted, hot.any()))
        else:
            m.d.sync += [write.en.eq(hot.any()), hot[_FIRST[0]].eq(0), hot[_LAST[0]].eq(0)]
        m.submodules.word = word = Picked(32, len(hot))
        m.d.comb += [
            *(word.i[n].eq(words[32 * n : 32 * (n + 1)]) for n in range(len(hot))),
            word.which.eq(hot),
            word.enable.eq(hot.any()),
            write.data.eq(word.o),
        ]
        with m.FSM():
            with m.State("Wait"):
                m.d.sync += step.eq(0 if self.close_images else _FIRST[0])
                with m.If(started):
                    m.next = "Start"
                with m.Elif(due):
                    if not self.close_images:
                        m.d.sync += step.eq(0)
                    if self.edge_log:
                        with m.If(~logged):
                            m.next = "Edges"
                    with m.If(logged & self.filled.bit_select(copying, 1)):
                        m.next = "Header"

            with m.State("Start"):
                m.d.sync += [started.eq(0), step.eq(step + 1), at.eq(Cat(step[:_EDGE_BITS], 0, starting))]
                if self.close_images:
                    m.d.sync += [wanted.eq(1), hot[0].eq(step == 0)]
                    for bank in range(2):
                        with m.If(starting == bank):
                            m.d.sync += [starts[bank][name].eq(self.start[name]) for name in kept.members]
                    last = HEADER_WORDS - 1
                else:
                    # The words of the last row's stamp, at the place of the first row's.
                    m.d.sync += hot[_LAST[0]].eq(step == _FIRST[0])
                    last = _FIRST[-1]
                with m.If(step == last):
                    m.next = "Wait" if self.close_images else "Still"

            if not self.close_images:
                with m.State("Still"):
                    m.d.sync += hot[_LAST[-1] + 1].eq(0)
                    m.next = "Wait"

            if self.edge_log:
                with m.State("Edges"):
                    # The edge follows the index by a clock, as `hot` does.
                    m.d.sync += [step.eq(step + 1), at.eq(Cat(step[:_EDGE_BITS], 1, copying))]
                    m.d.sync += hot[HEADER_WORDS:].eq(Cat(~step[0], step[0]))
                    with m.If(step == EDGE_WORDS * MAX_EDGES - 1):
                        m.d.sync += logged.eq(1)
                        m.next = "Wait"

            with m.State("Header"):
                m.d.sync += [step.eq(step + 1), wanted.eq(0)]
                m.d.sync += [hot[0].eq(step == 0), at.eq(Cat(step[:_EDGE_BITS], 0, copying))]
                if not self.close_images:
                    with m.If(step == _FIRST[0] - 1):
                        m.d.sync += step.eq(_LAST[0])
                    m.d.sync += hot[_LAST[0]].eq(step == _LAST[0])
                with m.If(step == HEADER_WORDS - 1):
                    m.next = "Complete"

            with m.State("Complete"):
                m.d.sync += [self.complete.eq(1), self.complete_bank.eq(copying), due.eq(0)]
                m.d.sync += logged.eq(not self.edge_log)
                m.next = "Wait"

        return m


def _packed(layout: Layout, values: dict) -> Value:
    """The record of these values, each cut or extended to its field; reserved ones are 0."""
    parts = []
    for field in layout.fields:
        value = Value.cast(0 if field.reserved else values.pop(field.name))
        extension = value[-1].replicate(field.bits) if value.shape().signed else Const(0, field.bits)
        parts.append(Cat(value, extension)[: field.bits])
    assert not values, f"{layout.name} has no fields {sorted(values)}"
    return Cat(parts)
