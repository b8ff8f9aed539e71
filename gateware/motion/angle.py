"""What the host needs to give each row its own angle: latches at rows, and a log of encoder edges.

Source of the method: "Angle" in the architecture. The host fits a smooth curve through the edges on both
sides of a row; edges lie at whole counts, so nothing is lost to the encoder's step.
"""

from collections.abc import Sequence

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import MAX_EDGES

from ..layouts import Edge
from ..memory import BlockRam
from .quadrature import UNKNOWN, Move

FIRST_CLOCKS = 8
"""How long the first row's stamp can be taken from :class:`AngleLatch` where it is not kept."""


class AngleStamp(data.Struct):
    """Time, and the decoder's ``count``, ``age`` and ``period`` at that time."""

    time: 48
    count: signed(32)
    age: 32
    period: 32


class AngleLatch(wiring.Component):
    """Latches the encoder at rows.

    Edges up to and including the clock of the strobe are in the latch, later ones are not: all inputs are seen at the
    same pin time. Latency one clock.

    Members
    -------
    row_first : strobe, column 0 of a row
    frame_first : strobe along with it, the row is the first one of its image
    now : state of the encoder
    first : at the last ``frame_first``; without ``keep_first`` 0
    last : at the last ``row_first``
    first_is_last : strobe, a clock after ``frame_first``: ``last`` is the first row's stamp

    Parameters
    ----------
    keep_first : without it the first row's stamp is not kept: whoever needs it takes it from ``last`` within
        :data:`FIRST_CLOCKS` from ``first_is_last`` on. A row that begins sooner, far from any contract of the camera,
        is not latched
    """

    row_first: In(1)
    frame_first: In(1)
    now: In(AngleStamp)
    first: Out(AngleStamp)
    last: Out(AngleStamp)
    first_is_last: Out(1)

    def __init__(self, *, keep_first: bool = True) -> None:
        self.keep_first = keep_first
        super().__init__()

    @staticmethod
    def reference(time: int, moves: Sequence[Move]) -> dict[str, int]:
        """The definition: the fields of a latch at ``time``."""
        edges = [move for move in moves if not move.illegal and move.time <= time]
        return {
            "time": time,
            "count": edges[-1].count if edges else 0,
            "age": min(time - edges[-1].time, UNKNOWN) if edges else UNKNOWN,
            "period": min(edges[-1].time - edges[-2].time, UNKNOWN) if len(edges) > 1 else UNKNOWN,
        }

    def elaborate(self, platform: object) -> Module:
        m = Module()
        left = Signal(range(FIRST_CLOCKS))  # clocks in which `last` stays
        m.d.sync += self.first_is_last.eq(self.frame_first)
        with m.If(self.row_first & (self.frame_first | (left == 0))):
            m.d.sync += self.last.eq(self.now)
        with m.If(self.frame_first):
            m.d.sync += self.first.eq(self.now) if self.keep_first else left.eq(FIRST_CLOCKS - 1)
        if not self.keep_first:
            with m.If(~self.frame_first & (left != 0)):
                m.d.sync += left.eq(left - 1)
        return m


class EdgeLog(wiring.Component):
    """Remembers the edges since it was last taken, evenly thinned to at most :data:`MAX_EDGES`.

    The log holds every ``2 ** shift``-th edge, from the first one on. When it is full and one more has to go
    in, every second entry is dropped. Nothing is copied: entry j lives in the slot that is j rotated left by
    ``shift`` bits, so the entries that stay need not move, and the slots of those that go become
    entries 8 to 15.

    Since entries have only the low 32 bits of the time, a log whose first entry is ``2 ** horizon_bits`` clocks
    old is emptied: all entries that can be read are unmistakable.

    ``take`` freezes the log for reading, until the next ``take``, and starts another one in a second bank. An
    edge in the clock of ``take`` is the first of the new log. Throughput an edge a clock. Reading takes
    :attr:`read_latency` clocks.

    Parameters
    ----------
    horizon_bits : 1 to 31

    Members
    -------
    edge, backward, count, time : outputs of the decoder, and their time
    take : strobe
    entries : edges in the frozen log, up to 16
    shift : of the frozen log
    index : which entry to read, from 0
    entry : that entry
    """

    read_latency = 1

    def __init__(self, horizon_bits: int = 31) -> None:
        if not 1 <= horizon_bits <= 31:
            raise ValueError(f"a horizon of 2**{horizon_bits} clocks is not possible; 1 to 31 bits are")
        self.horizon_bits = horizon_bits
        super().__init__(
            {
                "edge": In(1),
                "backward": In(1),
                "count": In(signed(32)),
                "time": In(48),
                "take": In(1),
                "entries": Out(range(MAX_EDGES + 1)),
                "shift": Out(8),
                "index": In(range(MAX_EDGES)),
                "entry": Out(Edge),
            }
        )

    def reference(self, moves: Sequence[Move], end: int) -> tuple[int, list[dict[str, int]]]:
        """The definition: shift and entries of a log of ``moves`` that is taken at time ``end``."""
        edges: list[Move] = []
        for move in moves:
            if not move.illegal and move.time < end:
                if edges and move.time - edges[0].time >= 1 << self.horizon_bits:
                    edges = []
                edges.append(move)
        if edges and end - edges[0].time >= 1 << self.horizon_bits:
            edges = []
        shift = 0
        while len(edges[:: 1 << shift]) > MAX_EDGES:
            shift += 1
        entries = [
            {
                "time": edge.time & 0xFFFF_FFFF,
                "count": (edge.count + (1 << 30)) % (1 << 31) - (1 << 30),
                "backward": int(edge.backward),
            }
            for edge in edges[:: 1 << shift]
        ]
        return shift, entries

    def elaborate(self, platform: object) -> Module:
        m = Module()
        slot_bits = (MAX_EDGES - 1).bit_length()
        m.submodules.memory = memory = BlockRam(Edge, 2 * MAX_EDGES, block=True)  # the bank that is read is not written
        write, read = memory.write, memory.read
        m.d.comb += read.en.eq(1)

        def slot(entry: Signal, shift: Signal) -> Mux:
            turned = Cat(entry, entry)
            return Mux(
                shift[1],
                Mux(shift[0], turned[1:], turned[2:]),
                Mux(shift[0], turned[3:], turned),
            )[:slot_bits]

        bank = Signal()
        # Within the horizon lie at most 2**horizon_bits edges, and shift is less than horizon_bits.
        used = Signal.like(self.entries)
        shift = Signal(range(max(self.horizon_bits, 4)))
        # Edges so far, and the bits of that number that are 0 at an entry: 2**shift - 1, soon made one longer.
        number = Signal(max(self.horizon_bits - 4, 1))
        mask = Signal.like(number)
        age = Signal(self.horizon_bits + 1, init=1)  # of the first entry; 1 until there is one
        expired = Signal()
        begin = Signal()
        full = Signal()
        used_now = Signal.like(used)
        shift_now = Signal.like(shift)
        m.d.comb += [
            expired.eq(age[-1]),
            begin.eq(self.take | expired),
            full.eq(used == MAX_EDGES),
        ]
        with m.If(begin):
            m.d.comb += [used_now.eq(0), shift_now.eq(0)]
        with m.Elif(full):
            m.d.comb += [
                used_now.eq(MAX_EDGES // 2),
                shift_now.eq(shift + 1),
            ]
        with m.Else():
            m.d.comb += [used_now.eq(used), shift_now.eq(shift)]

        # The memory is written a clock later: before anything can be read after `take`.
        entry = Signal(slot_bits)
        due = Signal()
        m.d.comb += [entry.eq(used_now), due.eq(self.edge & (begin | ~(number & mask).any()))]
        m.d.sync += [
            write.addr.eq(Cat(slot(entry, shift_now), bank ^ self.take)),
            write.data.time.eq(self.time),
            write.data.count.eq(self.count),
            write.data.backward.eq(self.backward),
            write.en.eq(due),
        ]
        with m.If(self.edge):
            m.d.sync += number.eq(number + 1)
        with m.If(due & full):
            m.d.sync += mask.eq(Cat(1, mask))
        with m.If(begin):
            m.d.sync += [used.eq(0), shift.eq(0), mask.eq(0), number.eq(self.edge)]
        with m.If(used != 0):
            m.d.sync += age.eq(age + 1)
        with m.If(begin):
            m.d.sync += age.eq(1)
        with m.If(due):
            m.d.sync += [used.eq(used_now + 1), shift.eq(shift_now)]
        with m.If(self.take):
            m.d.sync += [
                bank.eq(~bank),
                self.entries.eq(Mux(expired, 0, used)),
                self.shift.eq(Mux(expired, 0, shift)),
            ]

        m.d.comb += [
            read.addr.eq(Cat(slot(self.index, self.shift), ~bank)),
            self.entry.eq(read.data),
        ]
        return m
