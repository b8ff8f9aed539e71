"""Headers and edge logs of two frames."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from magtrak.protocol import FRAME_FLAGS, MAX_EDGES

from ..layouts import Edge, Field, FrameHeader, struct
from .facts import EDGE_BASE, EDGE_WORDS, HEADER_WORDS, WORDS, ImageFacts, MotionFacts, RowFacts


class HeaderStore(wiring.Component):
    """Puts the headers of frames together, each in one of two banks, as 32-bit words.

    A header's parts come at three moments: ``take``, later ``taken``, and ``filled`` before or after
    it. Edges are copied from ``taken`` on, the header from the later of the two moments on.

    The copy takes at most ``copy_clocks`` from ``taken``, or 24 from ``filled``. The next ``taken``
    must not come earlier: images are at least 112 clocks apart, which is enough.

    Members
    -------
    take, into : strobe: an accepted image ends; its bank, which is not that of a header still to be completed
    image, number : sampled then
    taken : strobe for each ``take``, in order: its motion is known
    motion, dropped, damaged_commands, line_errors : sampled then
    edge_index, edge : entry of the edge log as of ``taken``; ``edge`` follows the index by a clock
    filled : of each bank: its rows are complete; high until the frame was sent
    rows : of each bank: what is known of its rows
    complete, complete_bank : strobe: the header in this bank is complete
    edges, form : of each bank, as its header says
    bank, index : word to read
    word : that word, 2 clocks later
    """

    copy_clocks = EDGE_WORDS * MAX_EDGES + HEADER_WORDS + 6

    take: In(1)
    into: In(1)
    image: In(ImageFacts)
    number: In(32)
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
    edges: Out(range(MAX_EDGES + 1)).array(2)
    form: Out(1).array(2)
    bank: In(1)
    index: In(range(WORDS))
    word: Out(32)

    def elaborate(self, platform):
        m = Module()
        m.submodules.memory = memory = Memory(shape=32, depth=2 * WORDS, init=[])
        write = memory.write_port()
        read = memory.read_port()
        m.d.comb += [read.addr.eq(Cat(self.index, self.bank)), read.en.eq(1)]
        m.d.sync += self.word.eq(read.data)

        images = [Signal(ImageFacts, name=f"image{bank}") for bank in range(2)]
        numbers = [Signal(32, name=f"number{bank}") for bank in range(2)]
        for bank in range(2):
            with m.If(self.take & (self.into == bank)):
                m.d.sync += [images[bank].eq(self.image), numbers[bank].eq(self.number)]
            m.d.comb += self.form[bank].eq(images[bank].form)

        motion = Signal(MotionFacts)
        dropped = Signal(32)
        damaged, lost = Signal(16), Signal(16)
        with m.If(self.taken):
            m.d.sync += [
                motion.eq(self.motion),
                dropped.eq(self.dropped),
                damaged.eq(self.damaged_commands),
                lost.eq(self.line_errors),
            ]

        # Banks whose motion is to come, the oldest lowest.
        queue, waiting = Signal(2), Signal(range(3))
        rest, left = Signal(2), Signal(range(3))
        m.d.comb += [rest.eq(Mux(self.taken, queue >> 1, queue)), left.eq(waiting - self.taken)]
        m.d.sync += [queue.eq(rest), waiting.eq(left + self.take)]
        with m.If(self.take):
            m.d.sync += queue.bit_select(left[0], 1).eq(self.into)

        copying = Signal()  # bank
        with m.If(self.taken):
            m.d.sync += copying.eq(queue[0])
        image = Signal(ImageFacts)
        number = Signal(32)
        rows = Signal(RowFacts)
        header = Signal(FrameHeader)
        flags = Signal(struct(FRAME_FLAGS))
        m.d.comb += [
            image.eq(Mux(copying, images[1], images[0])),
            number.eq(Mux(copying, numbers[1], numbers[0])),
            rows.eq(Mux(copying, self.rows[1], self.rows[0])),
            flags.index_seen.eq(motion.index_seen),
            flags.speed_in_band.eq(image.speed_in_band),
            flags.laser_on.eq(image.laser_on),
            flags.motor_stopped.eq(image.motor_stopped),
            flags.encoder_fault.eq(motion.encoder_fault),
            flags.camera_fault.eq(rows.vision.errors.as_value().any()),
            flags.rows_lost.eq(rows.lost),
            header.frame.eq(number),
            header.flags.eq(flags),
            header.camera_errors.eq(rows.vision.errors),
            header.rows.eq(rows.rows),
            header.columns.eq(rows.vision.columns),
            header.dropped.eq(dropped),
            header.damaged_commands.eq(damaged),
            header.encoder_errors.eq(motion.encoder_errors),
            header.field.eq(image.field),
            header.row_step.eq(Mux(image.field == Field.PROGRESSIVE, 1, 2)),
            header.first_row.eq(image.field == Field.ODD),
            header.line_errors.eq(lost),
        ]
        for name in ("generation", "form", "detector", "exposure_us", "time_offset_ns"):
            m.d.comb += header[name].eq(image[name])
        for name in ("edges", "edge_shift", "index_passes", "index_count"):
            m.d.comb += header[name].eq(motion[name])
        for when in ("first", "last"):
            for name in ("time", "count", "age", "period"):
                m.d.comb += header[f"{when}_{name}"].eq(motion[when][name])

        step = Signal(range(EDGE_WORDS * MAX_EDGES + 1))
        m.d.sync += [write.en.eq(0), self.complete.eq(0)]
        m.d.comb += self.edge_index.eq(step // EDGE_WORDS)
        with m.FSM():
            with m.State("Wait"):
                m.d.sync += step.eq(0)
                with m.If(self.taken):
                    m.next = "Edges"

            with m.State("Edges"):
                # The edge that is here belongs to the index of the clock before.
                m.d.sync += [
                    step.eq(step + 1),
                    write.en.eq(step != 0),
                    write.addr.eq(Cat((step - 1)[: EDGE_BASE.bit_length() - 1], 1, copying)),
                    write.data.eq(self.edge.as_value().word_select((step - 1)[0], 32)),
                ]
                with m.If(step == EDGE_WORDS * MAX_EDGES):
                    m.d.sync += step.eq(0)
                    m.next = "Rows"

            with m.State("Rows"):
                with m.If(self.filled.bit_select(copying, 1)):
                    m.next = "Header"

            with m.State("Header"):
                m.d.sync += [
                    step.eq(step + 1),
                    write.en.eq(1),
                    write.addr.eq(Cat(step[: EDGE_BASE.bit_length() - 1], 0, copying)),
                    write.data.eq(header.as_value().word_select(step, 32)),
                ]
                with m.If(step == HEADER_WORDS - 1):
                    m.next = "Complete"

            with m.State("Complete"):
                m.d.sync += [self.complete.eq(1), self.complete_bank.eq(copying)]
                for bank in range(2):
                    with m.If(copying == bank):
                        m.d.sync += self.edges[bank].eq(motion.edges)
                m.next = "Wait"

        return m
