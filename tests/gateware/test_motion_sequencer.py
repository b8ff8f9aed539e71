"""The sequencer does what its definition says, instruction by instruction; and the assembler refuses nonsense."""

import random

import pytest
from amaranth.hdl import signed

from gateware.motion.assembly import WORD_BITS, Program
from gateware.motion.sequencer import Sequencer, Variable
from tests.support.simulation import simulate

INPUTS = {"one": signed(32), "two": 32}
FLAGS = ("red", "green")


def program():
    p = Program(tuple(INPUTS), FLAGS, ("out", "other"))
    p.variable("x", "y", "z")
    return p


def run(p, inputs, flags, writes=(), events=1):
    """All outputs of a sequencer that gets ``events`` and, before each, a variable; ours and the definition's.

    The program begins at label ``start`` and comes to ``wait()`` at label ``wait`` less one.
    """
    dut = Sequencer(p, INPUTS)
    got, want, state = [], [], {}

    async def testbench(ctx):
        ctx.set(dut.inputs, inputs)
        ctx.set(dut.flags, flags)
        clocks = 0

        async def clock():
            nonlocal clocks
            clocks += 1
            (*_, value, output) = await ctx.tick().sample(dut.value, dut.output.as_value())
            assert output.bit_count() <= 1
            if output:
                got.append((p.outputs[output.bit_length() - 1], value))
            assert clocks < 20_000

        for number in range(events):
            while not ctx.get(dut.waiting):
                await clock()
            if number < len(writes):
                name, value = writes[number]
                ctx.set(dut.write.payload, Variable.const({"address": p.variables[name], "value": value}))
                ctx.set(dut.write.valid, 1)
                while not ctx.get(dut.write.ready):
                    await clock()
                await clock()
                ctx.set(dut.write.valid, 0)
            for _ in range(3):
                await clock()
            ctx.set(dut.event, 1)
            await clock()
            ctx.set(dut.event, 0)
            await clock()
        while not ctx.get(dut.waiting):
            await clock()

    simulate(dut, testbench, clocks=30_000)
    want += p.run(state, inputs, flags, "start")
    for number in range(events):
        if number < len(writes):
            state[writes[number][0]] = writes[number][1]
        want += p.run(state, inputs, flags, "resume")
    assert got == want
    return [value for _, value in got]


def begin(p):
    p.label("start")
    p.put(0, "x", "y", "z")
    p.wait()
    p.label("resume")
    p.load(0)
    p.to_low()


def end(p):
    p.load_low()
    p.output("out")
    for name in ("x", "y", "z"):
        p.load(name)
        p.output("out")
    p.wait()
    p.jump("resume")


def test_each_instruction_by_hand():
    p = program()
    begin(p)
    for step in (
        lambda: p.load("one"),
        lambda: p.add(5),
        lambda: p.subtract("two"),
        lambda: p.load_negative("one"),
        lambda: p.load((1 << 31) + 5),
        p.wrap,
        lambda: p.load(-(1 << 31) - 1),
        p.wrap,
        lambda: p.multiply(0, 4),
        lambda: (p.load(1000), p.to_low(), p.load(0), p.multiply("two", 24)),
        p.load_low,
        lambda: (p.load(1000), p.to_low(), p.load(0), p.divide(7, 32)),
        p.load_low,
    ):
        step()
        p.output("other")
    end(p)
    low, high = 1000 * 12345 & 0xFFFFFF, 1000 * 12345 >> 24
    want = [-3, 2, 2 - 12345, 3, (1 << 31) + 5, -(1 << 31) + 5, -(1 << 31) - 1, (1 << 31) - 1, (1 << 27) - 1]
    want += [high, low << 8, 1000 % 7 - 7, 1000 // 7]
    assert run(p, {"one": -3, "two": 12345}, {"red": 0, "green": 1})[: len(want)] == want


def test_blocks_and_writes():
    p = program()
    begin(p)
    with p.when("red"):
        p.put(1, "x")
    with p.otherwise():
        p.put(2, "x")
        with p.unless("red"):
            p.put(3, "y")
    with p.when("green"):
        p.load("z")
        with p.when("negative"):
            p.load_negative("z")
        with p.otherwise():
            p.add(100)
        p.output("other")
    end(p)
    got = run(p, {"one": 0, "two": 0}, {"red": 0, "green": 1}, [("z", 7), ("z", -9)], events=2)
    assert got == [107, 0, 2, 3, 7, 9, 0, 2, 3, -9]


@pytest.mark.parametrize("seed", range(6))
def test_random_programs(seed):
    """Only ranges are kept: whatever comes in any order."""
    rng = random.Random(seed)
    print(f"seed {seed}")
    p = program()
    begin(p)
    edge = [0, 1, -1, 2, (1 << 31) - 1, -(1 << 31)]
    operands = [
        "x",
        "y",
        "z",
        "one",
        "two",
        *edge,
        *(rng.getrandbits(31) >> rng.randrange(31) for _ in range(6)),
    ]

    def block(depth):
        for _ in range(rng.randrange(2, 9)):
            kind = rng.choice(["add", "subtract", "load", "load_negative", "store", "multiply", "divide", "wrap", "if"])
            if kind in ("add", "subtract"):
                p.wrap()
                getattr(p, kind)(rng.choice(operands))
            elif kind in ("load", "load_negative"):
                getattr(p, kind)(rng.choice(operands))
            elif kind == "store":
                p.store(rng.choice("xyz"))
                p.output("other")
            elif kind == "multiply":
                p.load(rng.choice(operands))
                p.to_low()
                p.load(rng.choice([0, "one"]))
                p.multiply(rng.choice(operands), rng.randrange(1, 32))
            elif kind == "divide":
                p.load(rng.choice(operands))
                p.to_low()
                p.load(0)
                p.divide(rng.choice([0, 1, 3, 12345, "two"]), rng.randrange(1, 33))
            elif kind == "wrap":
                p.wrap()
            elif depth:
                with rng.choice([p.when, p.unless])(rng.choice(["negative", "red", "green"])):
                    block(depth - 1)
                if rng.random() < 0.5:
                    with p.otherwise():
                        block(depth - 1)

    block(3)
    end(p)
    inputs = {"one": rng.randrange(-(1 << 31), 1 << 31), "two": rng.choice([rng.getrandbits(32), (1 << 32) - 1])}
    flags = {"red": rng.getrandbits(1), "green": rng.getrandbits(1)}
    writes = [(rng.choice("xyz"), rng.randrange(-(1 << 31), 1 << 31)) for _ in range(8)]
    got = run(p, inputs, flags, writes, events=8)
    assert len(got) >= 32 and all(abs(value) < 1 << WORD_BITS - 1 for value in got)


def test_nonsense_is_refused():
    p = program()
    with pytest.raises(ValueError, match="one is no variable"):
        p.store("one")
    with pytest.raises(ValueError, match="blue is no flag"):
        p._emit(0, 0, flag="blue")
    with pytest.raises(ValueError, match="x is there already"):
        p.variable("x")
    with p.when("red"):
        p.load(1)
    p.load(2)
    with pytest.raises(ValueError, match="does not follow a block"), p.otherwise():
        pass
    p.load("nobody")
    with pytest.raises(ValueError, match="nobody"):
        p.assemble()
    for _ in range(2000):
        p.load(0)
    p.instructions = [one for one in p.instructions if one.operand != "nobody"]
    with pytest.raises(ValueError, match="words"):
        p.assemble()


def test_wrapping_is_noticed():
    p = program()
    p.label("start")
    p.load((1 << 33) - 1)
    p.add(1)
    p.wait()
    with pytest.raises(OverflowError, match="ADD"):
        p.run({}, {}, {}, "start")
