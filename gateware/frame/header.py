"""Headers and edge logs of two frames."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import FRAME, FRAME_FLAGS, MAX_EDGES, Layout, Phase

from ..layouts import Edge, Field
from ..memory import BlockRam
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
    rowless : of each bank: the image was not measured, and its rows are not sent
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
    rowless: Out(1).array(2)
    bank: In(1)
    index: In(range(WORDS))
    word: Out(32)

    def elaborate(self, platform):
        m = Module()
        # As with the rows, a bank is read while it is written only before it is complete.
        m.submodules.memory = memory = BlockRam(32, 2 * WORDS)
        write, read = memory.write, memory.read
        m.d.comb += [read.addr.eq(Cat(self.index, self.bank)), read.en.eq(1)]
        m.d.sync += self.word.eq(read.data)

        images = [Signal(ImageFacts, name=f"image{bank}") for bank in range(2)]
        numbers = [Signal(32, name=f"number{bank}") for bank in range(2)]
        for bank in range(2):
            with m.If(self.take & (self.into == bank)):
                m.d.sync += [images[bank].eq(self.image), numbers[bank].eq(self.number)]
            m.d.comb += [self.form[bank].eq(images[bank].form), self.rowless[bank].eq(_rowless(images[bank].phase))]

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
        image = {name: Mux(copying, images[1][name], images[0][name]) for name, _ in data.Layout.cast(ImageFacts)}
        number = Mux(copying, numbers[1], numbers[0])
        rows = {name: Mux(copying, self.rows[1][name], self.rows[0][name]) for name in ("rows", "lost")}
        vision = {name: Mux(copying, *(self.rows[n].vision[name] for n in (1, 0))) for name in ("errors", "columns")}
        flags = {name: image[name] for name in ("speed_in_band", "laser_on", "motor_stopped")} | {
            "index_seen": motion.index_seen,
            "encoder_fault": motion.encoder_fault,
            "camera_fault": vision["errors"].any(),
            "rows_lost": rows["lost"],
        }
        values = (
            {name: image[name] for name in ("generation", "form", "detector", "phase", "exposure_us", "time_offset_ns")}
            | {name: motion[name] for name in ("edges", "edge_shift", "index_passes", "index_count", "encoder_errors")}
            | {
                f"{when}_{name}": motion[when][name]
                for when in ("first", "last")
                for name in ("time", "count", "age", "period")
            }
            | {
                "frame": number,
                "flags": _packed(FRAME_FLAGS, flags),
                "camera_errors": vision["errors"],
                "rows": Mux(_rowless(image["phase"]), 0, rows["rows"]),
                "columns": vision["columns"],
                "dropped": dropped,
                "damaged_commands": damaged,
                "field": image["field"],
                "row_step": Mux(image["field"] == Field.PROGRESSIVE, 1, 2),
                "first_row": image["field"] == Field.ODD,
                "line_errors": lost,
            }
        )
        # Not a signal: of a word that is written alone its fields are put together, and nothing at other times.
        header = _packed(FRAME, values)

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
                ]
                with m.Switch(step):
                    for word in range(HEADER_WORDS):
                        with m.Case(word):
                            m.d.sync += write.data.eq(header[32 * word : 32 * (word + 1)])
                with m.If(step == HEADER_WORDS - 1):
                    m.next = "Complete"

            with m.State("Complete"):
                m.d.sync += [self.complete.eq(1), self.complete_bank.eq(copying)]
                for bank in range(2):
                    with m.If(copying == bank):
                        m.d.sync += self.edges[bank].eq(motion.edges)
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


def _rowless(phase: Value) -> Value:
    return (phase == Phase.BACKGROUND) | (phase == Phase.SKIPPED)
