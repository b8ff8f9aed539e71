"""What boards with an ECP5 share: parts of the FPGA that the tools don't choose by themselves."""

from functools import reduce
from operator import or_

from amaranth.hdl import C, Cat, ClockSignal, Const, Instance, Module, Mux, Signal, Value

from gateware.arithmetic import AddSubtract, Multiply
from gateware.memory import BlockRam, BlockRom
from gateware.select import Picked

_ADDRESS_BITS = 14
_HALF = 18
"""Bits of a block RAM's data bus; a port of 36 has those of both sides."""


class Ecp5:
    """A part of an ECP5 board's platform, which every one of :mod:`boards.board` has."""

    def get_multiplier(self, multiply: Multiply) -> Module:
        """A MULT18X18D with the registers inside it, which Yosys leaves unused: 278 MHz at speed 6, 132-146 without."""
        m = Module()
        pins = {}
        for name, factor in (("A", multiply.a), ("B", multiply.b)):
            wide = Signal(factor.shape() if len(factor) == 18 else Const(0, 18).shape(), name=name)
            m.d.comb += wide.eq(factor)  # with its sign
            pins |= {f"i_{name}{bit}": wide[bit] for bit in range(18)}
            pins[f"i_SIGNED{name}"] = int(factor.shape().signed)
        product = [Signal(name=f"P{bit}") for bit in range(36)]
        pins |= {f"o_P{bit}": wire for bit, wire in enumerate(product)}
        m.submodules.multiplier = Instance(
            "MULT18X18D",
            p_REG_INPUTA_CLK="CLK0",
            p_REG_INPUTB_CLK="CLK0",
            p_REG_OUTPUT_CLK="CLK0",
            p_GSR="DISABLED",
            i_CLK0=ClockSignal(),
            i_CE0=multiply.enable,
            i_RST0=0,
            i_SOURCEA=0,
            i_SOURCEB=0,
            **pins,
        )
        m.d.comb += multiply.product.eq(Cat(product))
        return m

    def get_add_subtract(self, add_subtract: AddSubtract) -> Module:
        """CCU2Cs whose LUTs invert ``b`` as well as adding it, for which Yosys spends a LUT for each bit. A bit below
        the lowest makes the carry that a subtraction begins with.
        """
        m = Module()
        bits = len(add_subtract.o)
        # Each is a propagate of A ^ B ^ C, and A is the carry where that is 0. The first one never propagates.
        a, b = Cat(add_subtract.subtract, add_subtract.a), Cat(C(0, 1), add_subtract.b)
        carry = None
        for at in range(0, bits + 1, 2):
            sums = Signal(2, name=f"sum{at}")
            pins = {} if carry is None else {"i_CIN": carry}
            carry = Signal(name=f"carry{at}")
            for n in range(2):
                there = at + n <= bits
                pins |= {f"i_A{n}": a[at + n] if there else 0, f"i_B{n}": b[at + n] if there else 0}
                pins |= {f"i_C{n}": add_subtract.subtract if there else 0, f"i_D{n}": 1, f"o_S{n}": sums[n]}
            m.submodules[f"carries{at}"] = Instance(
                "CCU2C",
                p_INIT0=Const(0x96AA if at else 0x000A, 16),
                p_INIT1=Const(0x96AA, 16),
                p_INJECT1_0="NO",
                p_INJECT1_1="NO",
                o_COUT=carry,
                **pins,
            )
            for n in range(2):
                if 1 <= at + n <= bits:
                    m.d.comb += add_subtract.o[at + n - 1].eq(sums[n])
        return m

    def get_picked(self, picked: Picked) -> Module:
        """A register for each value, whose reset takes it away where it is not the one: the AND takes no LUT, the OR a
        third of one for each bit.
        """
        m = Module()
        parts = [Signal(picked.bits, name=f"part{n}", reset_less=True) for n in range(picked.count)]
        with m.If(picked.enable):
            m.d.sync += [part.eq(Mux(picked.which[n], picked.i[n], 0)) for n, part in enumerate(parts)]
        m.d.comb += picked.o.eq(reduce(or_, parts))
        return m

    def get_block_ram(self, ram: BlockRam) -> Module:
        """DP16KDs side by side with the output register inside them, which Yosys leaves unused: 5.8 ns from the clock
        to the word without. Port A writes, port B reads; the pins are as Yosys would have them.
        """
        m = Module()
        width = next(width for width in (36, 18, 9) if ram.depth * width <= 1024 * _HALF)
        written, read = Value.cast(ram.write.data), Value.cast(ram.read.data)
        for number, at in enumerate(range(0, len(read), width)):
            word = Signal(width, name=f"word{number}")
            bits = Signal(width, name=f"bits{number}")
            m.d.comb += [word.eq(written[at : at + width]), read[at : at + width].eq(bits)]
            pins = _data("i_DI", word, "A") | _data("o_DO", bits, "A" if width > _HALF else "B")
            pins |= _address("A", ram.write.addr, width, enabled=True) | _address("B", ram.read.addr, width)
            pins |= {"i_CEA": ram.write.en, "i_WEA": 1, "i_OCEA": ram.read.en}
            pins |= {"i_CEB": ram.read.en, "i_WEB": 0, "i_OCEB": ram.read.en}
            m.submodules[f"ram{number}"] = _dp16kd(width, [], pins)
        return m

    def get_block_rom(self, rom: BlockRom) -> Module:
        """One DP16KD whose ports both read, as :meth:`get_block_ram` has it."""
        m = Module()
        width = next(width for width in (18, 9) if rom.depth * width <= 1024 * _HALF)
        pins = {}
        for side, address, out in zip("AB", rom.address, rom.word, strict=True):
            word = Signal(width, name=f"word{side}")
            m.d.comb += out.eq(word)
            pins |= _data("o_DO", word, side) | _address(side, address, width)
            pins |= {f"i_CE{side}": 1, f"i_WE{side}": 0, f"i_OCE{side}": 1}
        assert rom.bits <= width
        step = _HALF // width
        init = [
            sum(word << (9 * n) for n, word in enumerate(rom.init[at : at + step]))
            for at in range(0, len(rom.init), step)
        ]
        m.submodules.rom = _dp16kd(width, init, pins)
        return m


def _dp16kd(width: int, init: list[int], pins: dict) -> Instance:
    """A block RAM with its output registers; ``init`` in words of 18 bits."""
    rows = [init[at : at + 16] for at in range(0, len(init), 16)]
    values = {
        f"p_INITVAL_{number:02X}": Const(sum(word << (20 * n) for n, word in enumerate(row)), 320)
        for number, row in enumerate(rows)
    }
    for side in "AB":
        pins |= {f"i_CLK{side}": ClockSignal(), f"i_RST{side}": 0}
        pins |= {f"i_CS{side}{bit}": 0 for bit in range(3)}
        values |= {f"p_DATA_WIDTH_{side}": width, f"p_REGMODE_{side}": "OUTREG", f"p_CSDECODE_{side}": "0b000"}
        values |= {f"p_CLK{side}MUX": f"CLK{side}", f"p_WRITEMODE_{side}": "NORMAL"}
    return Instance("DP16KD", p_RESETMODE="SYNC", p_ASYNC_RESET_RELEASE="SYNC", p_GSR="DISABLED", **values, **pins)


def _data(name: str, word: Signal, side: str) -> dict:
    """Pins of a word: 36 bits take those of side B as well."""
    return {f"{name}{side if bit < _HALF else 'B'}{bit % _HALF}": word[bit] for bit in range(len(word))}


def _address(side: str, address, width: int, *, enabled: bool = False) -> dict:
    """Pins of an address: those of words of 9, 18, 36 bits begin at bits 3, 4, 5; below, ``enabled`` sets all bytes."""
    low = {9: 3, 18: 4, 36: 5}[width]
    bytes_on = (1 << (width // 9)) - 1 if enabled and width > 9 else 0
    pins = Cat(C(bytes_on, low), address, C(0, _ADDRESS_BITS - low - len(address)))
    return {f"i_AD{side}{bit}": pins[bit] for bit in range(_ADDRESS_BITS)}
