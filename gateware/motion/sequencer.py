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
    Op.DIVIDE: ("arithmetic", "divide", "low"),
    Op.WRAP: ("arithmetic", "wrap"),
    Op.TO_LOW: ("low",),
    Op.STORE: ("store",),
    Op.OUTPUT: ("output",),
    Op.JUMP: ("jump",),
    Op.WAIT: ("wait",),
}

CODE = data.StructLayout(
    {"controls": Controls, "address": ADDRESS_BITS, "outside": 1, "condition": 5, "unless": 1, "steps": 5}
)
"""An instruction in memory. ``address`` is that of a variable, a constant or a place to go to, or has a bit for each
input, where the operand is from ``outside``, or output; ``condition`` is a flag's number."""


def controls(op: Op) -> dict[str, int]:
    """The bits of :class:`Controls` for an instruction."""
    return dict.fromkeys(CONTROLS[op], 1)


class Variable(data.Struct):
    """A variable, and a value for it."""

    address: range(VARIABLES)
    value: signed(32)


class Adder(wiring.Component):
    """What the accumulator and L become: the one adder for everything.

    A step of a product adds or not. One of a quotient is two clocks: A and L are doubled, as A is added to itself; then
    the operand is subtracted, or added where A is negative. Combinational. In front of each bit of the adder is a
    function of four inputs, a cell.

    Members
    -------
    controls : of the instruction
    second : second clock of a quotient's step
    a, low : accumulator and L; 0 instead of the accumulator for ``load``
    b : the operand
    result, next_low : after one step; L stays in the first clock of a quotient's
    """

    controls: In(Controls)
    second: In(1)
    a: In(signed(WORD_BITS))
    b: In(signed(WORD_BITS))
    low: In(LOW_BITS)
    result: Out(signed(WORD_BITS))
    next_low: Out(LOW_BITS)

    def elaborate(self, platform: object) -> Module:
        m = Module()
        controls, a, low = self.controls, self.a, self.low
        inverted = Signal()
        doubled = Signal()
        carry = Signal()
        chosen = Signal(2)
        x = Signal(WORD_BITS)
        y = Signal(WORD_BITS)
        total = Signal(signed(WORD_BITS))
        m.d.comb += [
            doubled.eq(controls.divide & ~self.second),
            inverted.eq(controls.negative | (controls.divide & self.second & ~a[-1])),
            chosen[0].eq(doubled | (~inverted & (~controls.multiply | low[0]))),
            chosen[1].eq(doubled | inverted),
            carry.eq(inverted | (doubled & low[-1])),
            x.eq(Cat(a[:32], Mux(controls.wrap, a[31].replicate(WORD_BITS - 32), a[32:]))),
            y.eq(Mux(chosen[1], Mux(chosen[0], a, ~self.b), Mux(chosen[0], self.b, 0))),
            total.eq((Cat(carry, x) + Cat(carry, y))[1:]),
            self.result.eq(Mux(controls.multiply, total >> 1, total)),
            self.next_low.eq(
                Mux(controls.multiply, Cat(low[1:], total[0]), Mux(controls.divide, Cat(~total[-1], low), a))
            ),
        ]
        return m


class Sequencer(wiring.Component):
    """Runs a :class:`~gateware.motion.assembly.Program`, which defines what each instruction does.

    One memory holds variables, program and constants. An instruction takes three clocks, a product of n steps n + 2, a
    quotient 2 n + 2:

    1. its operand's address goes to the memory; ``STORE`` writes;
    2. the operand is taken, ``load`` clears the accumulator, and the next instruction's address goes to the memory;
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
        assert program.inputs == tuple(inputs), "shapes for all inputs of the program, in its order"
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
        place = Signal(ADDRESS_BITS)
        left = Signal(5)
        second = Signal()
        started = Signal()
        a = self.value
        low = Signal(LOW_BITS, reset_less=True)
        b = Signal(signed(WORD_BITS), reset_less=True)
        # Each input has a register that is 0 unless the instruction asks for it: what is chosen is just their sum.
        values = [self.inputs[name] for name in self.inputs.shape().members]
        asked = [Signal.like(value, name=f"asked_{number}") for number, value in enumerate(values)]
        word = read.data & (~code.outside).replicate(WORD_BITS)
        for one in asked:
            word |= Cat(one, (one[-1] if one.shape().signed else Const(0)).replicate(WORD_BITS - len(one)))

        m.submodules.adder = adder = Adder()
        does = code.controls
        m.d.comb += [
            adder.controls.eq(does),
            adder.second.eq(second),
            adder.a.eq(a),
            adder.b.eq(b),
            adder.low.eq(low),
        ]

        flags = Cat(1, a[-1], self.flags)
        goes = Signal()
        m.d.comb += goes.eq(does.jump & (flags.bit_select(code.condition, 1) ^ code.unless))

        reads = Signal()  # an operand
        stores = Signal()  # a variable
        for number, (one, value) in enumerate(zip(asked, values, strict=True)):
            others = Signal(name=f"others_{number}")
            m.d.comb += others.eq(reads & ~(code.outside & code.address[number]))
            with m.If(reads):
                m.d.sync += one.eq(value)
            with m.If(others):  # as the flip-flop's own reset
                m.d.sync += one.eq(0)
        m.d.comb += [
            read.en.eq(0),
            read.addr.eq(Mux(reads | goes, code.address, place)),
            self.write.ready.eq(started & ~reads),
            write.en.eq(stores | (self.write.valid & self.write.ready)),
            write.data.eq(Mux(reads, a, self.write.payload.value)),
            write.addr.eq(Mux(reads, code.address[: (VARIABLES - 1).bit_length()], self.write.payload.address)),
        ]
        with m.FSM():
            with m.State("Operand"):
                m.d.comb += [read.en.eq(1), reads.eq(1), stores.eq(does.store)]
                m.next = "Fetch"

            with m.State("Fetch"):
                m.d.comb += self.waiting.eq(does.wait)
                m.d.sync += [b.eq(word), left.eq(code.steps), second.eq(0)]
                with m.If(does.load):
                    m.d.sync += a.eq(0)
                with m.If(~self.waiting | self.event):
                    m.d.comb += [read.en.eq(1), self.resumed.eq(self.waiting)]
                    m.d.sync += place.eq(read.addr + 1)
                    m.next = "Execute"

            with m.State("Execute"):
                stepped = ~does.divide | second
                m.d.sync += second.eq(~second)
                with m.If(stepped):
                    m.d.sync += left.eq(left - 1)
                    with m.If(left == 0):
                        m.d.sync += code.eq(read.data)
                        m.next = "Operand"
                with m.If(does.arithmetic):
                    m.d.sync += a.eq(adder.result)
                with m.If(does.low & stepped):
                    m.d.sync += low.eq(adder.next_low)
                with m.If(does.output):
                    m.d.comb += self.output.eq(code.address)

        with m.If(self.waiting):
            m.d.sync += started.eq(1)
        return m
