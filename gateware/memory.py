"""Block RAM without logic around it."""

from collections.abc import Sequence

from amaranth.hdl import Module, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

REGISTERED_DEPTH = 2048
"""Words that a memory with an output register may have: one row of an ECP5's block RAMs, 9 bits wide each."""


class BlockRam(wiring.Component):
    """A memory with a write port and a read port, for users that never look at a word while it is written.

    The read port is synchronous: ``read.data`` is the word of the ``read.addr`` at the clock before, if ``read.en`` was
    high then, or else stays. A memory whose ``write.en`` is 0 is a ROM.

    With ``registered`` another register of the same enable follows: ``read.data`` is a clock with ``read.en`` later.
    Block RAMs of an ECP5 have such a register inside, and are the slowest cells of the card without. Where the tools
    don't use it, a board's platform has the method ``get_block_ram(ram)``, which returns what takes this component's
    place then.

    What is read is undefined where ``read.en``, ``write.en`` and equal addresses meet in one clock. Block RAMs differ
    in what they return then. :class:`amaranth.lib.memory.Memory` promises the old word, for which Yosys puts a copy of
    the last word written, a comparator and a multiplexer at each bit around the RAM: a hundred cells and
    more, in the slowest path of the card. Here a read port without a clock stands before a register: for that
    the attribute ``no_rw_check`` tells Yosys that no such promise is wanted, and it takes both as one port.

    Nor may it matter what stands there before anything was read. An iCE40's block RAM cannot begin with 0, which would
    take a cell at each bit; by the attribute ``before_reading`` the boards tell Yosys that it need not.

    Every user says why it never meets that case, or why the word does not matter then; the tests of ``gateware``
    run with an inverted word in its place, and with ones before anything was read (``tests/gateware/conftest.py``).

    Parameters
    ----------
    shape : of a word
    depth : words
    init : the words before anything is written, 0 where there are fewer. Reset leaves what is there.
    block : never of logic cells, however small it is
    registered : two clocks from the address to the word, not one; up to :data:`REGISTERED_DEPTH` words, of which none
        has an ``init``

    Members
    -------
    write, read : ports as of :mod:`amaranth.lib.memory`, seen from the memory

    Raises
    ------
    ValueError
        It is ``registered``, and has an ``init`` or too many words.
    """

    def __init__(
        self, shape, depth: int, init: Sequence = (), *, block: bool = False, registered: bool = False
    ) -> None:
        if registered and depth > REGISTERED_DEPTH:
            raise ValueError(f"{depth} words with an output register; {REGISTERED_DEPTH} are possible")
        if registered and init:
            raise ValueError("a memory with an output register has no init; BlockRom has")
        self.shape = shape
        self.depth = depth
        self.init = init
        self.block = block
        self.registered = registered
        bits = (depth - 1).bit_length()
        super().__init__(
            {
                "write": Out(memory.WritePort.Signature(addr_width=bits, shape=shape)),
                "read": Out(memory.ReadPort.Signature(addr_width=bits, shape=shape)),
            }
        )

    @property
    def latency(self) -> int:
        """Clocks with ``read.en`` from an address to its word."""
        return 2 if self.registered else 1

    def elaborate(self, platform):
        if self.registered and hasattr(platform, "get_block_ram"):
            return platform.get_block_ram(self)
        m = Module()
        attrs = {"no_rw_check": 1} | ({"ram_style": "block"} if self.block else {})
        words = memory.Memory(shape=self.shape, depth=self.depth, init=self.init, attrs=attrs)
        m.submodules.words = words
        write, read = words.write_port(), words.read_port(domain="comb")
        word = Signal(self.shape, reset_less=True, attrs={"before_reading": 1})
        m.d.comb += [
            write.addr.eq(self.write.addr),
            write.data.eq(self.write.data),
            write.en.eq(self.write.en),
            read.addr.eq(self.read.addr),
        ]
        with m.If(self.read.en):
            m.d.sync += word.eq(read.data)
            if self.registered:
                held = Signal(self.shape, reset_less=True)
                m.d.sync += held.eq(word)
                word = held
        m.d.comb += self.read.data.eq(word)
        return m


class BlockRom(wiring.Component):
    """A table in one block RAM, read at two places at once, with its output registers in use.

    A board's platform may have the method ``get_block_rom(rom)``, as :class:`BlockRam` tells of ``get_block_ram``.

    Parameters
    ----------
    bits : of a word
    depth : words
    init : the words

    Members
    -------
    address : of two words
    word : those of the addresses :attr:`latency` clocks ago
    """

    def __init__(self, bits: int, depth: int, init: Sequence[int]) -> None:
        self.bits = bits
        self.depth = depth
        self.init = init
        super().__init__({"address": In((depth - 1).bit_length()).array(2), "word": Out(bits).array(2)})

    latency = 2
    """Clocks from an address to its word."""

    def elaborate(self, platform):
        if hasattr(platform, "get_block_rom"):
            return platform.get_block_rom(self)
        m = Module()
        m.submodules.words = words = memory.Memory(shape=self.bits, depth=self.depth, init=self.init)
        for number, (address, word) in enumerate(zip(self.address, self.word, strict=True)):
            read, held = words.read_port(), Signal(self.bits, name=f"held{number}", reset_less=True)
            m.d.comb += [read.en.eq(1), read.addr.eq(address), word.eq(held)]
            m.d.sync += held.eq(read.data)
        return m
