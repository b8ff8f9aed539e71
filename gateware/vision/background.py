"""The reduced picture of the room without the laser."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak import reference
from magtrak.protocol import AmbientMode
from magtrak.reference.ambient import MAX_SHIFT, MIN_CELLS

from ..arithmetic import delayed
from ..features import DEFAULT_CELLS
from ..layouts import FrameSettings
from ..memory import BlockRam
from .weight import Weight

BANK_CELLS = 2048
"""A block RAM of an ECP5. Each has its own output register before one of them is picked."""

_BANK_BITS = (BANK_CELLS - 1).bit_length()
_ADDRESS_CLOCKS = 3
_READ_CLOCKS = 3
_END_CLOCKS = 8
"""Clocks from an image's end to where all is known of its last pixel."""


class Background(wiring.Component):
    """Takes the background from images without laser, and gives it back for the others.

    :class:`magtrak.reference.BackgroundStore` is the definition: the greatest mix of each block of pixels, which are
    as small as the memory allows. Blocks lie in the memory one after the other, so that images of any shape use it up;
    their addresses are counted, not multiplied. An image's size is known at its end: the first one of another size
    has the old background subtracted.

    What is read while it is written does not matter: only images without anything subtracted are written, and in those
    a block's word counts where a row enters the block, a row's blanking after it was written last.

    One pixel a clock. ``value`` comes :attr:`latency` clocks after the pixel, together with the mix.

    Parameters
    ----------
    cells : blocks that fit

    Members
    -------
    settings : ``ambient_mode`` is used
    settings_change : strobe: a background taken before is of no use; at the latest a clock before the first pixel
    valid, row_first, frame_first : of the pixel
    column, row : place of the pixel of a clock ago
    mix : of the pixel of :attr:`latency` clocks ago, before anything is subtracted
    take : the image is a background; sampled a clock after its first pixel
    image_end : strobe, with or after the last pixel of an image. Where the next image follows within
        fewer than 8 clocks, the background is lost.
    faulty, image_rows, image_columns : of the image, from 3 clocks after ``image_end`` on, until the next
    value : to be subtracted from the mix of the pixel; 0 where nothing is
    subtracting : something is subtracted from this image; from 2 clocks after its first pixel on

    Raises
    ------
    ValueError
        There are fewer cells than an image of 2048 x 2048 needs, or more than there are pixels.
    """

    def __init__(self, cells: int = DEFAULT_CELLS) -> None:
        if not MIN_CELLS <= cells <= 2048 * 2048:
            raise ValueError(f"background_cells is {cells}; {MIN_CELLS} to {2048 * 2048} are possible")
        self.cells = cells
        super().__init__(
            {
                "settings": In(FrameSettings),
                "settings_change": In(1),
                "valid": In(1),
                "row_first": In(1),
                "frame_first": In(1),
                "column": In(12),
                "row": In(12),
                "mix": In(8),
                "take": In(1),
                "image_end": In(1),
                "faulty": In(1),
                "image_rows": In(12),
                "image_columns": In(12),
                "value": Out(8),
                "subtracting": Out(1),
            }
        )

    reference = reference.BackgroundStore

    latency = Weight.raw_latency
    """Clocks from the pixel to its value."""

    def elaborate(self, platform):
        m = Module()
        # Where blocks begin. The mask has a bit for each halving; it is the size of the blocks less one.
        mask = Signal(MAX_SHIFT)
        valid = delayed(m, self.valid, 1, "valid")
        first = delayed(m, self.valid & self.row_first, 1, "row_first")
        frame = delayed(m, self.valid & self.frame_first, 1, "frame_first")
        strobes = Signal(5)
        m.d.sync += strobes.eq(
            Cat(valid, valid & ~(self.column & mask).any(), first, frame, ~(self.row & mask).any()),
        )
        wait = self.latency - _ADDRESS_CLOCKS - _READ_CLOCKS
        pixel, begins, row_begins, frame_begins, band_begins = delayed(m, strobes, wait, "strobes")

        # Each row of a band of blocks goes through the same addresses.
        address = Signal(range(self.cells))
        base = Signal(range(self.cells))
        following = Signal(range(self.cells))
        full = Signal()  # there are more blocks than cells
        m.d.comb += following.eq(address + 1)
        with m.If(frame_begins):  # which is a block's beginning as well: a reset without an enable costs nothing
            m.d.sync += [address.eq(0), base.eq(0), full.eq(0)]
        with m.Elif(begins):
            with m.If(row_begins & ~band_begins):
                m.d.sync += address.eq(base)
            with m.Else():
                m.d.sync += address.eq(following)
                with m.If(address == self.cells - 1):
                    m.d.sync += full.eq(1)
                with m.If(row_begins):
                    m.d.sync += base.eq(following)
        banks = [self._bank(m, number) for number in range(-(-self.cells // BANK_CELLS))]
        for bank in banks:
            m.d.comb += [bank.read.addr.eq(address), bank.read.en.eq(1)]
        picked = delayed(m, address >> _BANK_BITS, _READ_CLOCKS - 1, "picked")
        stored = Signal(8, reset_less=True)
        with m.Switch(picked):
            for number, bank in enumerate(banks):
                with m.Case(number):
                    m.d.sync += stored.eq(bank.read.data)

        # The greatest so far, written with each pixel.
        taking = Signal()
        clocks = 1 + _READ_CLOCKS
        writes = delayed(m, pixel, clocks, "pixel")
        starts, fresh = delayed(m, begins, clocks, "begins"), delayed(m, band_begins, clocks, "band_begins")
        greatest = Signal(8, reset_less=True)
        before = Signal(8)
        m.d.comb += [
            before.eq(Mux(starts, Mux(fresh, 0, stored), greatest)),
        ]
        place = delayed(m, address, clocks, "address")
        keeps = Signal()
        m.d.sync += keeps.eq(writes & taking & ~full)
        for number, bank in enumerate(banks):
            m.d.comb += [
                bank.write.addr.eq(place),
                bank.write.data.eq(greatest),
                bank.write.en.eq(keeps & (place >> _BANK_BITS == number)),
            ]
        with m.If(writes):
            m.d.sync += greatest.eq(Mux(self.mix > before, self.mix, before))

        # Whether there is a background.
        ready = Signal()
        end = Signal(_END_CLOCKS)
        m.d.sync += end.eq(Cat(self.image_end, end))
        size = Signal(24)
        image_size = Cat(self.image_rows, self.image_columns)
        resized = Signal()
        differs = [Signal(name=f"differs_{half}") for half in range(2)]
        m.d.sync += [
            *(differs[at].eq(size.word_select(at, 12) != image_size.word_select(at, 12)) for at in range(2)),
            resized.eq(differs[0] | differs[1]),
        ]
        with m.If(end[-1]):
            with m.If(self.faulty):
                m.d.sync += ready.eq(ready & ~taking)
            with m.Elif(resized):
                m.d.sync += [size.eq(image_size), mask.eq(0), ready.eq(0)]
            with m.Elif(full):
                m.d.sync += [mask.eq(Cat(1, mask)), ready.eq(0)]
            with m.Elif(taking):
                m.d.sync += ready.eq(1)
        with m.If(frame):
            m.d.sync += [
                taking.eq(self.take),
                self.subtracting.eq(ready & ~self.take & (self.settings.ambient_mode != AmbientMode.OFF)),
            ]
            with m.If(end.any()):
                m.d.sync += [end.eq(0), ready.eq(0), self.subtracting.eq(0)]
        with m.If(self.settings_change):
            m.d.sync += ready.eq(0)
        m.d.comb += self.value.eq(Mux(self.subtracting, stored, 0))
        return m

    def _bank(self, m: Module, number: int) -> BlockRam:
        depth = min(BANK_CELLS, self.cells - number * BANK_CELLS)
        m.submodules[f"bank{number}"] = bank = BlockRam(8, depth, registered=True)
        return bank
