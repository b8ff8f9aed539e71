"""What makes the pixel path fast, in its netlist for an ECP5."""

from collections import Counter

import pytest
from amaranth.hdl import Module, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

from gateware.memory import BlockRam
from gateware.vision.vision import Vision
from tests.support.synthesis import ECP5, ICE40, bare_reads, netlist


@pytest.fixture
def collisions_show():
    """Here it is the RAM itself that counts."""


REGISTERS = ("REG_INPUTA_CLK", "REG_INPUTB_CLK", "REG_OUTPUT_CLK")


def bare_multipliers(top) -> list[str]:
    """Those whose own registers are not in use."""
    cells = {name: cell for name, cell in top["cells"].items() if "MULT" in cell["type"]}
    return [
        name
        for name, cell in cells.items()
        if any(cell["parameters"].get(register, "NONE") == "NONE" for register in REGISTERS)
    ]


def test_pixel_path_has_no_bare_multiplier_and_no_bare_read(tmp_path):
    top = netlist(Vision(), ECP5, tmp_path)
    assert len(top["cells"]) > 1000
    assert not bare_multipliers(top)
    assert not bare_reads(top)


class Both(wiring.Component):
    """What must not be: a product, and a block RAM whose output goes through logic."""

    a: In(10)
    b: In(10)
    write: In(1)
    product: Out(20)
    read: Out(10)

    def __init__(self, registers: int) -> None:
        self.registers = registers
        super().__init__()

    def elaborate(self, platform):
        m = Module()
        m.submodules.table = table = memory.Memory(shape=10, depth=1024, init=[])
        write, read = table.write_port(), table.read_port()
        m.d.comb += [write.addr.eq(self.a), write.data.eq(self.b), write.en.eq(self.write), read.addr.eq(self.b)]
        value = read.data
        for number in range(self.registers):
            register = Signal(10, name=f"register_{number}")
            m.d.sync += register.eq(value)
            value = register
        m.d.sync += [self.product.eq(self.a * self.b), self.read.eq(value + self.a)]
        return m


@pytest.mark.parametrize("registers", [0, 1])
def test_both_would_be_found(tmp_path, registers):
    top = netlist(Both(registers), ECP5, tmp_path)
    assert bare_multipliers(top)
    assert bool(bare_reads(top)) == (registers == 0)


@pytest.mark.parametrize("device", [ECP5, ICE40], ids=lambda device: device.name)
def test_block_ram_stands_alone(tmp_path, device):
    """Nothing looks for collisions, nor gives a 0 before the first read: see :class:`gateware.memory.BlockRam`."""
    top = netlist(BlockRam(16, 1024), device, tmp_path)
    kinds = Counter(cell["type"] for cell in top["cells"].values() if cell["type"] != "$scopeinfo")
    assert kinds == ({"DP16KD": 1} if device is ECP5 else {"SB_RAM40_4K": 4})


class Promising(wiring.Component):
    """What :class:`BlockRam` stands instead of."""

    def __init__(self) -> None:
        super().__init__(BlockRam(16, 1024).signature)

    def elaborate(self, platform):
        m = Module()
        m.submodules.words = words = memory.Memory(shape=16, depth=1024, init=[])
        write, read = words.write_port(), words.read_port()
        for inner, outer in ((write, self.write), (read, self.read)):
            m.d.comb += [inner.addr.eq(outer.addr), inner.en.eq(outer.en)]
        m.d.comb += [write.data.eq(self.write.data), self.read.data.eq(read.data)]
        return m


def test_logic_around_a_block_ram_would_be_found(tmp_path):
    top = netlist(Promising(), ECP5, tmp_path)
    assert sum(cell["type"] in ("LUT4", "TRELLIS_FF") for cell in top["cells"].values()) > 50
