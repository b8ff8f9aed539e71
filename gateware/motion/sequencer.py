"""All slow arithmetic of motion on one adder: a small computer that runs a fixed program."""

from collections.abc import Mapping

from amaranth.hdl import Cat, Const, Module, Mux, ShapeLike, Signal, signed
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ..memory import BlockRam
from .assembly import ADDRESS_BITS, LOW_BITS, VARIABLES, WORD_BITS, Op, Program


class Controls(data.Struct):
    """What an instruction does, a bit for each: an ``Op`` in the program's memory needs no decoding.

    load, negative, multiply, divide, wrap : of the :class:`Adder`
    arithmetic : the accumulator changes
    low, store, output, jump, wait : as their instructions
    """

    load: 1
    negative: 1
    multiply: 1
    divide: 1
    wrap: 1
    arithmetic: 1
    low: 1
    store: 1
    output: 1
    jump: 1
    wait: 1


CONTROLS = {
    Op.LOAD: ("arithmetic", "load"),
    Op.LOAD_NEGATIVE: ("arithmetic", "load", "negative"),
    Op.ADD: ("arithmetic",),
    Op.SUBTRACT: ("arithmetic", "negative"),
    Op.MULTIPLY: ("arithmetic", "multiply", "low"),
    Op.DIVIDE: ("arithmetic", "divide", "negative", "low"),
    Op.WRAP: ("arithmetic", "wrap"),
    Op.TO_LOW: ("low",),
    Op.STORE: ("store",),
    Op.OUTPUT: ("output",),
    Op.JUMP: ("jump",),
    Op.WAIT: ("wait",),
}

CODE = data.StructLayout(
    {"controls": Controls, "address": ADDRESS_BITS, "source": 4, "condition": 5, "unless": 1, "steps": 5}
)
"""An instruction in memory. ``address`` is that of a variable, a constant or a place to go to; ``condition`` a flag's
number, or an output's."""


def controls(op: Op) -> dict[str, int]:
    """The bits of :class:`Controls` for an instruction."""
    return dict.fromkeys(CONTROLS[op], 1)


class Variable(data.Struct):
    """A variable, and a value for it."""

    address: range(VARIABLES)
    value: signed(32)


class Adder(wiring.Component):
    """What the accumulator and L become: the one adder for everything.

    A step of a product adds or not, one of a quotient subtracts or not. Combinational.

    Members
    -------
    controls : of the instruction
    a, low : accumulator and L
    b : the operand; inverted if it is subtracted
    result, next_low : after one step
    """

    controls: In(Controls)
    a: In(signed(WORD_BITS))
    b: In(signed(WORD_BITS))
    low: In(LOW_BITS)
    result: Out(signed(WORD_BITS))
    next_low: Out(LOW_BITS)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        controls, a, low = self.controls, self.a, self.low
        x, total, chosen = Signal(signed(WORD_BITS)), Signal(signed(WORD_BITS)), Signal(signed(WORD_BITS))
        top = Mux(controls.wrap, a[31].replicate(WORD_BITS - 32), a[32:])
        taken = Signal()
        m.d.comb += [
            x.eq(Mux(controls.load, 0, Mux(controls.divide, Cat(low[-1], a), Cat(a[:32], top)))),
            total.eq((Cat(controls.negative, x) + Cat(controls.negative, self.b))[1:]),
            taken.eq(Mux(controls.multiply, low[0], ~(controls.divide & total[-1]))),
            chosen.eq(Mux(taken, total, x)),
            self.result.eq(Mux(controls.multiply, chosen >> 1, chosen)),
            self.next_low.eq(Mux(controls.multiply, Cat(low[1:], chosen[0]), Mux(controls.divide, Cat(taken, low), a))),
        ]
        return m


class Sequencer(wiring.Component):
    """Runs a :class:`~gateware.motion.assembly.Program`, which defines what each instruction does.

    One memory holds variables, program and constants. An instruction takes three clocks, a product or quotient of n
    steps n + 2:

    1. its operand's address goes to the memory; ``STORE`` writes;
    2. the operand is taken, and the next instruction's address goes to the memory;
    3. the accumulator changes, and the next instruction is taken.

    After reset it goes on at the program's first instruction. At ``WAIT`` nothing moves until ``event``; ``resumed`` is
    high in the clock in which it is seen. Inputs and flags should be constant from the clock after that until the next
    ``WAIT``. The memory never reads where it writes in the same clock, but for the operand of a ``STORE``, which
    nothing takes.

    Variables can be written from outside, with a wait of a clock, from the first ``WAIT`` on; never while an operand
    is read.

    Parameters
    ----------
    program : what it runs
    inputs : shapes of the program's inputs

    Members
    -------
    event : something has happened
    waiting, resumed : it waits; it goes on
    inputs, flags : values, in the program's order
    write : stream of :class:`Variable`
    value : the accumulator
    output : strobes, in the program's order: ``value`` is for this output
    """

    def __init__(self, program: Program, inputs: Mapping[str, ShapeLike]) -> None:
        self.program = program
        assert program.inputs == ("memory", *inputs), "shapes for all inputs of the program, in its order"
        super().__init__(
            {
                "event": In(1),
                "waiting": Out(1),
                "resumed": Out(1),
                "inputs": In(data.StructLayout(dict(inputs))),
                "flags": In(data.StructLayout(dict.fromkeys(program.flags[2:], 1))),
                "write": In(stream.Signature(Variable)),
                "value": Out(signed(WORD_BITS)),
                "output": Out(data.StructLayout(dict.fromkeys(program.outputs, 1))),
            }
        )

    def image(self) -> list[int]:
        """What the memory holds at first."""
        words = []
        for word in self.program.assemble():
            if "constant" in word:
                words.append(word["constant"] & (1 << WORD_BITS) - 1)
            else:
                op = Op(word.pop("op"))
                words.append(CODE.const(word | {"controls": controls(op)}).as_value().value)
        return [0] * VARIABLES + words

    def elaborate(self, platform: object) -> Module:
        m = Module()
        image = self.image()
        width = max(WORD_BITS, CODE.size)
        m.submodules.memory = memory = BlockRam(width, 1 << ADDRESS_BITS, image)
        read, write = memory.read, memory.write

        code = Signal(CODE, init={"controls": controls(Op.JUMP), "address": VARIABLES})
        next_place, place = Signal(ADDRESS_BITS), Signal(ADDRESS_BITS)
        left = Signal(5)
        started = Signal()
        a, low, b = self.value, Signal(LOW_BITS, reset_less=True), Signal(signed(WORD_BITS), reset_less=True)
        outside, word = Signal(signed(WORD_BITS), reset_less=True), Signal(signed(WORD_BITS))
        shape = dict(self.inputs.shape().members)
        values = [Const(0), *(self.inputs[name] for name in shape)]

        m.submodules.adder = adder = Adder()
        does = code.controls
        m.d.comb += [
            adder.controls.eq(does),
            adder.a.eq(a),
            adder.b.eq(b),
            adder.low.eq(low),
            word.eq(Mux(code.source == 0, read.data, outside) ^ does.negative.replicate(WORD_BITS)),
        ]

        flags = Cat(1, a[-1], self.flags)
        goes = Signal()
        m.d.comb += goes.eq(does.jump & (flags.bit_select(code.condition, 1) ^ code.unless))

        reads, stores = Signal(), Signal()  # an operand; a variable
        m.d.comb += [
            read.en.eq(0),
            self.write.ready.eq(started & ~reads),
            write.en.eq(stores | (self.write.valid & self.write.ready)),
            write.data.eq(Mux(reads, a, self.write.payload.value)),
            write.addr.eq(Mux(reads, code.address[: (VARIABLES - 1).bit_length()], self.write.payload.address)),
        ]
        with m.FSM():
            with m.State("Operand"):
                m.d.comb += [read.en.eq(1), read.addr.eq(code.address), reads.eq(1), stores.eq(does.store)]
                with m.Switch(code.source):
                    for number, value in enumerate(values):
                        if number:
                            with m.Case(number):
                                m.d.sync += outside.eq(value)
                m.next = "Fetch"

            with m.State("Fetch"):
                m.d.comb += [
                    next_place.eq(Mux(goes, code.address, place)),
                    read.addr.eq(next_place),
                    self.waiting.eq(does.wait),
                ]
                m.d.sync += [b.eq(word), left.eq(code.steps)]
                with m.If(~self.waiting | self.event):
                    m.d.comb += [read.en.eq(1), self.resumed.eq(self.waiting)]
                    m.d.sync += place.eq(next_place + 1)
                    m.next = "Execute"

            with m.State("Execute"):
                with m.If(left == 0):
                    m.d.sync += code.eq(read.data)
                    m.next = "Operand"
                m.d.sync += left.eq(left - 1)
                with m.If(does.arithmetic):
                    m.d.sync += a.eq(adder.result)
                with m.If(does.low):
                    m.d.sync += low.eq(adder.next_low)
                with m.If(does.output):
                    m.d.comb += self.output.eq(
                        1 << code.condition[: max(len(self.program.outputs) - 1, 1).bit_length()]
                    )

        with m.If(self.waiting):
            m.d.sync += started.eq(1)
        return m
