"""Block RAM without logic around it."""

from collections.abc import Sequence

from amaranth.hdl import Module, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import Out


class BlockRam(wiring.Component):
    """A memory with a write port and a read port, for users that never look at a word while it is written.

    The read port is synchronous: ``read.data`` is the word of the ``read.addr`` at the clock before, if ``read.en`` was
    high then, or else stays. A memory whose ``write.en`` is 0 is a ROM.

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

    Members
    -------
    write, read : ports as of :mod:`amaranth.lib.memory`, seen from the memory
    """

    def __init__(self, shape, depth: int, init: Sequence = (), *, block: bool = False) -> None:
        self.shape = shape
        self.depth = depth
        self.init = init
        self.block = block
        bits = (depth - 1).bit_length()
        super().__init__(
            {
                "write": Out(memory.WritePort.Signature(addr_width=bits, shape=shape)),
                "read": Out(memory.ReadPort.Signature(addr_width=bits, shape=shape)),
            }
        )

    def elaborate(self, platform):
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
            self.read.data.eq(word),
        ]
        with m.If(self.read.en):
            m.d.sync += word.eq(read.data)
        return m
