"""Block RAMs as an ECP5 has them, against what Yosys makes of a memory, and both against what is promised.

The simulator knows no DP16KD; a model of what is used of it runs both netlists. That the model is right shows where it
does what Yosys had in mind.
"""

import random
from typing import Any

import pytest

from gateware.memory import REGISTERED_DEPTH, BlockRam, BlockRom
from tests.support.synthesis import ECP5, netlist

SEED = 31


@pytest.fixture
def collisions_show():
    """Here it is the RAM itself that counts."""


class DP16KD:
    """A block RAM: 1024 rows of 18 bits, ports of 9, 18 and 36 bits; one port writes, the other reads, or both read.

    Parameters
    ----------
    cell : of a netlist of Yosys
    """

    def __init__(self, cell: dict[str, Any]) -> None:
        self._pins = {pin: bits[0] for pin, bits in cell["connections"].items()}
        self._inputs = {pin for pin, way in cell["port_directions"].items() if way == "input"}
        self._set = cell["parameters"]
        self._words = []
        for number in range(64):
            row = int(self._set.get(f"INITVAL_{number:02X}", "0"), 2)
            self._words += [row >> (20 * n) & 0x3FFFF for n in range(16)]
        self._latch, self._out = [0, 0], [0, 0]
        assert not any(self._level(pin, {}) for pin in ("RSTA", "RSTB", *(f"CS{s}{n}" for s in "AB" for n in range(3))))

    def _level(self, pin: str, nets: dict[Any, int]) -> int:
        bit = self._pins.get(pin, "0")
        return int(bit == "1") if isinstance(bit, str) else nets[bit]

    def _number(self, name: str, bits: int, nets: dict[Any, int]) -> int:
        return sum(self._level(f"{name}{bit}", nets) << bit for bit in range(bits))

    def clock(self, nets: dict[Any, int]) -> None:
        before = list(self._words)
        for side, name in enumerate("AB"):
            width = int(self._set[f"DATA_WIDTH_{name}"], 2)
            address, write = self._number(f"AD{name}", 14, nets), self._level(f"WE{name}", nets)
            if self._set[f"REGMODE_{name}"] == "OUTREG" and self._level(f"OCE{name}", nets):
                self._out[side] = self._latch[side]
            if not self._level(f"CE{name}", nets):
                continue
            row = address >> 4
            if write:
                data = self._number(f"DI{name}", 18, nets)
                if width == 36:
                    assert address & 15 in (0, 15)
                    if address & 1:
                        self._words[row & ~1], self._words[row | 1] = data, self._number("DIB", 18, nets)
                elif width == 18:
                    assert address & 3 in (0, 3)
                    self._words[row] = data if address & 3 else self._words[row]
                else:
                    assert width == 9
                    at = 9 * (address >> 3 & 1)
                    self._words[row] = self._words[row] & ~(0x1FF << at) | (data & 0x1FF) << at
            elif width == 36:
                self._latch = [before[row & ~1], before[row | 1]]
                if self._set["REGMODE_A"] == "OUTREG":  # both halves go by this port's registers
                    assert self._level("OCEA", nets) == self._level("OCEB", nets)
            elif width == 18:
                self._latch[side] = before[row]
            else:
                self._latch[side] = before[row] >> 9 * (address >> 3 & 1) & 0x1FF

    def drive(self, nets: dict[Any, int]) -> None:
        for side, name in enumerate("AB"):
            words = self._out if self._set[f"REGMODE_{name}"] == "OUTREG" else self._latch
            for bit in range(18):
                net = self._pins.get(f"DO{name}{bit}")
                if isinstance(net, int):
                    nets[net] = words[side] >> bit & 1


class Netlist:
    """Block RAMs, and registers with and without an enable; nothing else may be in it."""

    def __init__(self, top: dict[str, Any]) -> None:
        cells = [cell for cell in top["cells"].values() if cell["type"] != "$scopeinfo"]
        self.rams = [DP16KD(cell) for cell in cells if cell["type"] == "DP16KD"]
        assert len(self.rams) == len(cells), {cell["type"] for cell in cells}
        self._ports = {name: port["bits"] for name, port in top["ports"].items()}
        self._nets: dict[Any, int] = {"x": 0, "0": 0, "1": 1}

    def set(self, **values: int) -> None:
        for name, value in values.items():
            for at, net in enumerate(self._ports[name]):
                self._nets[net] = value >> at & 1

    def get(self, name: str) -> int:
        return sum(self._nets[net] << at for at, net in enumerate(self._ports[name]))

    def clock(self) -> None:
        for ram in self.rams:
            ram.clock(self._nets)
        for ram in self.rams:
            ram.drive(self._nets)


@pytest.mark.parametrize("registered", [False, True])
@pytest.mark.parametrize(("bits", "depth"), [(64, 512), (36, 300), (16, 1024), (21, 2048)])
def test_ram(tmp_path, bits, depth, registered):
    print("seed", SEED)
    rng = random.Random(SEED)
    dut = Netlist(netlist(BlockRam(bits, depth, registered=registered), ECP5, tmp_path))
    assert len(dut.rams) == -(-bits // (36 if depth <= 512 else 18 if depth <= 1024 else 9))
    words: list[int | None] = [None] * depth
    line: list[int | None] = [None] * (1 + registered)
    places = rng.sample(range(depth), 12)
    seen = 0
    for _ in range(1500):
        write, at, word = rng.random() < 0.5, rng.choice(places), rng.getrandbits(bits)
        read, from_ = rng.random() < 0.7, rng.choice(places)
        if write and read and at == from_:
            read = False
        dut.set(write__en=write, write__addr=at, write__data=word, read__en=read, read__addr=from_)
        dut.clock()
        if read:
            line = [words[from_], *line][: 1 + registered]
        if write:
            words[at] = word
        if line[-1] is not None:
            seen += 1
            assert dut.get("read__data") == line[-1]
    assert seen > 1000


@pytest.mark.parametrize(("bits", "depth"), [(18, 1024), (7, 1100)])
def test_rom(tmp_path, bits, depth):
    rng = random.Random(SEED)
    init = [rng.getrandbits(bits) for _ in range(depth)]
    dut = Netlist(netlist(BlockRom(bits, depth, init), ECP5, tmp_path))
    assert len(dut.rams) == 1
    line = [(0, 0), (0, 0)]
    for _ in range(600):
        pair = rng.randrange(depth), rng.randrange(depth)
        dut.set(address__0=pair[0], address__1=pair[1])
        dut.clock()
        line = [pair, *line][:2]
        got = dut.get("word__0"), dut.get("word__1")
        assert line[1] == (0, 0) or got == (init[line[1][0]], init[line[1][1]])


def test_what_it_cannot_have():
    with pytest.raises(ValueError, match="2049 words"):
        BlockRam(8, REGISTERED_DEPTH + 1, registered=True)
    with pytest.raises(ValueError, match="init"):
        BlockRam(8, 16, [1], registered=True)
