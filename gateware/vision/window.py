"""The centroid of a window about a row's crossing: a second pass over the row."""

from amaranth.hdl import C, Cat, Module, Mux, Signal, signed
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak.reference import centroid
from magtrak.reference.centroid import HALF_WIDTHS, LANES
from magtrak.reference.fir import FRACTION

from ..arithmetic import Multiply, SerialDivider, differences, sums
from ..layouts import FrameSettings
from ..memory import BlockRam
from .pixels import MeasuredPixel

FRACTION_BITS = (FRACTION - 1).bit_length()
WORDS = (2 * max(HALF_WIDTHS.values()) + LANES) // LANES + 1
"""Words of eight columns over which the widest window can spread."""


class Window(wiring.Component):
    """Keeps the mix of two rows, and measures a window of one of them, as
    :func:`magtrak.reference.centroid.window` does.

    While a row comes in, eight columns make a word, and the mean of each four a byte of the background. When the
    row's run is chosen, both ends' backgrounds and then the words of the window are read, eight columns a clock, from
    the last to the first. Moments come without multipliers: within a word by adding up, over the words by double
    accumulation.

    Memory: two rows of mix, in 64-bit words, and of means, twice. What is read while it is written does not matter: a
    row is measured in the blanking after it or while the next one is written into the other half.

    Parameters
    ----------
    max_columns : columns of an image, 16 to 2048

    Members
    -------
    settings : ``centroid_window`` and ``centroid_base`` are used
    pixel : stream of :class:`~gateware.vision.pixels.MeasuredPixel`, always ready; at least 7 blank clocks follow a row
    compare, centre, peak : strobe: a run's place and greatest weight; it may be taken in the next clock
    take : strobe: it is, so it is what will be measured
    start : strobe: the row is over, and what was taken last is measured
    row, last_column : row that ended and its last column, from two clocks before ``start`` on
    position : in 1/256 px, :attr:`latency` clocks after ``start``, until the next
    some : something rose above the base; else ``position`` means nothing
    whole : the window lies within the image
    """

    def __init__(self, max_columns: int = 2048) -> None:
        if not 16 <= max_columns <= 2048:
            raise ValueError(f"max_columns is {max_columns}; 16 to 2048 are possible")
        self.max_columns = max_columns
        self._divider = SerialDivider(14, 7 + FRACTION_BITS, bits_per_clock=2)
        super().__init__(
            {
                "settings": In(FrameSettings),
                "pixel": In(stream.Signature(MeasuredPixel, always_ready=True)),
                "compare": In(1),
                "centre": In(12),
                "peak": In(8),
                "take": In(1),
                "start": In(1),
                "row": In(12),
                "last_column": In(12),
                "position": Out(20),
                "some": Out(1),
                "whole": Out(1),
            }
        )

    reference = staticmethod(centroid.window)

    READ = 3
    """Clocks from ``start`` to the first word: address, memory, its register."""

    SUM = 4
    """Clocks from a word to the sums that hold it: subtract, three levels of additions."""

    @property
    def latency(self) -> int:
        """Clocks from ``start`` to ``position``: read, add up, one more for each further word, divide."""
        return self.READ + self.SUM + WORDS + self._divider.latency

    def elaborate(self, platform):
        m = Module()
        m.submodules.divider = divider = self._divider
        columns_bits = (self.max_columns - 1).bit_length()
        word_bits, group_bits = columns_bits - 3, columns_bits - 2
        m.submodules.words = words = BlockRam(8 * LANES, 2 << word_bits, registered=True)
        m.submodules.means_left = means_left = BlockRam(8, 2 << group_bits, registered=True)
        m.submodules.means_right = means_right = BlockRam(8, 2 << group_bits, registered=True)
        means = (means_left, means_right)
        self._write(m, words.write, means_left.write, columns_bits)
        m.d.comb += [
            means_right.write.addr.eq(means_left.write.addr),
            means_right.write.data.eq(means_left.write.data),
            means_right.write.en.eq(means_left.write.en),
        ]

        # What will be measured: the bounds of its window, and what its peak adds to the base.
        half = Signal(5)
        with m.Switch(self.settings.centroid_window):
            for window, width in HALF_WIDTHS.items():
                with m.Case(window):
                    m.d.comb += half.eq(width)
        next_left = Signal(signed(13), reset_less=True)
        next_right = Signal(13, reset_less=True)
        left = Signal(signed(13), reset_less=True)
        right = Signal(13, reset_less=True)
        added = Signal(8, reset_less=True)
        m.submodules.multiply = multiply = Multiply(8, 4)
        taken = Signal()
        m.d.comb += [multiply.a.eq(self.peak), multiply.b.eq(self.settings.centroid_base)]
        m.d.sync += taken.eq(self.take)
        with m.If(self.compare):
            m.d.sync += [
                next_left.eq(self.centre - half),
                next_right.eq(self.centre + half),
            ]
        with m.If(self.take):
            m.d.sync += [left.eq(next_left), right.eq(next_right)]
        with m.If(taken):
            m.d.sync += added.eq(multiply.product >> 4)

        # Both ends' means are read at all times; those of the clock before `start` count, or of the one before if the
        # run that was compared then is not taken.
        bank = self.row[0]
        compared = Signal()
        of_taken = Signal(2)
        m.d.sync += [compared.eq(self.compare), of_taken.eq(Cat(self.take | ~compared, of_taken))]
        for ram, end, next_end in zip(means, (left, right), (next_left, next_right), strict=True):
            place = Mux(compared, next_end, end)
            m.d.comb += [ram.read.en.eq(1), ram.read.addr.eq(Cat(place[2 : 2 + group_bits], bank))]

        # Steps after `start`: one-hot, 1 in the clock after.
        step = Signal(self.latency + 1)
        m.d.sync += step.eq(Cat(self.start, step))
        result = step[self.READ + self.SUM - 1 + WORDS]
        active = Signal()  # after `start` until the sums are whole
        m.d.sync += active.eq((self.start | active) & ~result)
        before = Signal()  # the left end lies outside the image
        behind = Signal()  # the right one does
        right_behind = Signal()
        next_behind = Signal()
        m.d.sync += [
            right_behind.eq((self.last_column - right)[-1]),
            next_behind.eq((self.last_column - next_right)[-1]),
        ]
        first_word = Signal(word_bits + 1)
        last_word = Signal(word_bits + 1)
        low = Signal(3)  # lane of the first column
        high = Signal(3)  # of the last
        m.d.comb += before.eq(left < 0)
        clipped_first = Signal(12)
        clipped_last = Signal(12)
        m.d.comb += [
            behind.eq(Mux(taken, next_behind, right_behind)),
            clipped_first.eq(Mux(before, 0, left)),
            clipped_last.eq(Mux(behind, self.last_column, right)),
        ]
        outside = Signal(2)
        bank_held = Signal()
        address = Signal(word_bits + 1)
        m.d.sync += outside.eq(Cat(before, behind))
        with m.If(self.start):
            m.d.sync += [
                address.eq((clipped_first >> 3) + (WORDS - 1)),
                bank_held.eq(bank),
                first_word.eq(clipped_first >> 3),
                last_word.eq(clipped_last >> 3),
                low.eq(clipped_first),
                high.eq(clipped_last),
                self.whole.eq(~before & ~behind),
            ]
        # The base, once the means are here: at most 255, for nothing rises above that.
        bases = [Signal(9, name=f"base{at}", reset_less=True) for at in range(2)]
        brighter = Signal(reset_less=True)
        shown = [Mux(out, 0, mean) for out, mean in zip(outside, (ram.read.data for ram in means), strict=True)]
        base = Signal(9, reset_less=True)
        with m.If(of_taken[1]):
            m.d.sync += [
                *(held.eq(mean + added) for held, mean in zip(bases, shown, strict=True)),
                # Where the left one lies outside and the right one is 0, either will do.
                brighter.eq(~outside[1] & (outside[0] | (means_right.read.data > means_left.read.data))),
            ]
        with m.If(step[1]):
            m.d.sync += base.eq(Mux(brighter, bases[1], bases[0]))

        # Read from the last word to the first. Words behind the window's last come before that one.
        read = words.read
        m.d.comb += [read.en.eq(active), read.addr.eq(Cat(address[:word_bits], bank_held))]
        with m.If(active):
            m.d.sync += address.eq(address - 1)
        mask = Signal(LANES)
        lanes_low = Signal(LANES)
        lanes_high = Signal(LANES)
        is_last = Signal()  # the word being read is
        reached = Signal()
        m.d.sync += [lanes_low.eq(0xFF << low), lanes_high.eq(C(0xFF, LANES) >> ~high)]
        with m.If(active):
            m.d.sync += [
                is_last.eq(address == last_word),
                reached.eq(~step[0] & (reached | is_last)),
                mask.eq(
                    Mux(reached | is_last, 0xFF, 0) & Mux(step[WORDS], lanes_low, 0xFF) & Mux(is_last, lanes_high, 0xFF)
                ),
            ]

        # What rises above the base; sums and moments of a word.
        above = [Signal(8, name=f"above{lane}", reset_less=True) for lane in range(LANES)]
        rests = []
        for at in range(0, LANES, 4):
            lanes = [(read.data.word_select(lane, 8), base) for lane in range(at, at + 4)]
            rests += differences(m, lanes, 8, f"rests{at}")
        with m.If(active):
            for lane, (value, rest) in enumerate(zip(above, rests, strict=True)):
                m.d.sync += value.eq(Mux(mask[lane] & ~rest[-1] & ~base[-1], rest, 0))
            total, moment = _word_sums(m, above)

        # Step READ + SUM is the first in which the sums of a word are here.
        adding = Signal()
        m.d.comb += adding.eq(step[self.READ + self.SUM - 1 : self.READ + self.SUM - 1 + WORDS].any())
        total_sum = Signal(14, reset_less=True)  # 63 * 255 < 2**14
        moments = Signal(17, reset_less=True)  # within words: 9 * (0 + ... + 7) * 255 < 2**17
        steps = Signal(17, reset_less=True)  # over words: (1 + ... + 8) * 8 * 255 < 2**17
        with m.If(step[self.READ + self.SUM - 2]):
            m.d.sync += [total_sum.eq(0), moments.eq(0), steps.eq(0)]
        with m.Elif(adding):
            m.d.sync += [total_sum.eq(total_sum + total), moments.eq(moments + moment), steps.eq(steps + total_sum)]
        m.d.comb += [
            divider.start.eq(result),
            divider.dividend.eq((moments + (steps << 3)) << FRACTION_BITS),
            divider.divisor.eq(total_sum),
            # Half a unit more, and the halves cut off: rounded half up.
            self.position.eq((Cat(C(1, 1), divider.quotient) + Cat(C(1, 1), first_word << (3 + FRACTION_BITS)))[2:]),
        ]
        with m.If(result):
            m.d.sync += self.some.eq(total_sum.any())
        return m

    def _write(self, m: Module, word_port, mean_port, columns_bits: int) -> None:
        """Both memories are filled; the last pixel of a row is repeated to the end of its word."""
        valid = Signal()
        first = Signal()
        frame_first = Signal()
        row_last = Signal()
        came = Signal(8, reset_less=True)
        m.d.sync += [
            valid.eq(self.pixel.valid),
            first.eq(self.pixel.valid & self.pixel.p.row_first),
            frame_first.eq(self.pixel.p.frame_first),
            row_last.eq(self.pixel.p.row_last),
            came.eq(self.pixel.p.mix),
        ]
        column = Signal(columns_bits)
        row = Signal()
        padding = Signal()
        step = Signal()
        m.d.comb += step.eq(valid | padding)
        mix = Signal(8)
        word = Signal(8 * LANES)
        group = Signal(10)
        at = Signal(columns_bits)
        last_mix = Signal(8)
        m.d.comb += [
            at.eq(Mux(first, 0, column)),
            mix.eq(Mux(valid, came, last_mix)),
        ]
        line = Signal()  # parity of the row
        m.d.comb += line.eq(Mux(first, ~row & ~frame_first, row))
        whole_word = Signal()
        whole_group = Signal()
        place = Signal(columns_bits)
        place_line = Signal()
        m.d.sync += [whole_word.eq(0), whole_group.eq(0)]
        with m.If(step):
            m.d.sync += [
                column.eq(at + 1),
                row.eq(line),
                last_mix.eq(mix),
                word.eq(Cat(word[8:], mix)),
                group.eq(Mux(at[:2] == 0, 0, group) + mix),
                whole_word.eq(at[:3].all()),
                whole_group.eq(at[:2].all()),
                place.eq(at),
                place_line.eq(line),
                padding.eq(Mux(valid, row_last, padding) & ~at[:3].all()),
            ]
        m.d.comb += [
            word_port.en.eq(whole_word),
            word_port.addr.eq(Cat(place[3:], place_line)),
            word_port.data.eq(word),
            mean_port.en.eq(whole_group),
            mean_port.addr.eq(Cat(place[2:], place_line)),
            mean_port.data.eq(group[2:]),
        ]


def _word_sums(m: Module, values: list) -> tuple:
    """Sum of eight values and sum of each times its number, 3 clocks later."""

    def held(value, name):
        register = Signal(value.shape(), name=name, reset_less=True)
        m.d.sync += register.eq(value)
        return register

    v = values
    couples = sums(m, [(v[at], v[at + 1]) for at in range(0, 8, 2)], 8, "couples")
    pairs = [held(value, f"pair{at}") for at, value in enumerate(couples)]
    odd = [held(value, f"odd{at}") for at, value in enumerate(sums(m, [(v[1], v[3]), (v[5], v[7])], 8, "odds"))]
    # Number n = n0 + 2 * n1 + 4 * n2: bit 0 is set in the odd ones, bit 1 in pairs 1 and 3, bit 2 in pairs 2 and 3.
    fourths = [(pairs[0], pairs[1]), (pairs[2], pairs[3]), (odd[0], odd[1]), (pairs[1], pairs[3])]
    *total, ones, twos = (held(value, f"fourth{at}") for at, value in enumerate(sums(m, fourths, 9, "fourths")))
    return held(total[0] + total[1], "word_total"), held(ones + (twos << 1) + (total[1] << 2), "word_moment")
