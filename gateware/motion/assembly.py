"""Programs for the :class:`~gateware.motion.sequencer.Sequencer`, written in Python."""

import enum
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

WORD_BITS = 34
"""Bits of accumulator, operands and variables: the difference of two differences of counts."""

LOW_BITS = 32
"""Bits of the register that holds multipliers, quotients and the low part of products."""

ADDRESS_BITS = 10
VARIABLES = 128
"""Words at the bottom of the memory, the only ones that are written; constants and program lie above."""


class Op(enum.IntEnum):
    """What an instruction does; see :class:`Program`."""

    LOAD = 0
    LOAD_NEGATIVE = 1
    ADD = 2
    SUBTRACT = 3
    MULTIPLY = 4
    DIVIDE = 5
    WRAP = 6
    STORE = 8
    TO_LOW = 9
    OUTPUT = 10
    JUMP = 11
    WAIT = 12


@dataclass(frozen=True)
class Instruction:
    """One instruction. ``operand`` is a variable, a constant or an input; of a jump, the place it goes to.

    ``flag`` and ``unless`` are a jump's condition, ``steps`` those of a product or quotient.
    """

    op: Op
    operand: str | int = 0
    flag: str = "always"
    unless: bool = False
    steps: int = 1


class Program:
    """Builds a program, instruction by instruction.

    The machine has an accumulator ``A`` and a register ``L`` (low), which together hold products and dividends. An
    operand is a variable or an input by its name, or a constant. All numbers are signed, of :data:`WORD_BITS`.

    ======================== ==========================================================================================
    ``load(x)``              A = x
    ``load_negative(x)``     A = -x
    ``add(x)``               A = A + x
    ``subtract(x)``          A = A - x
    ``store(v)``             variable v = A
    ``wrap()``               A = its low 32 bits, signed
    ``to_low()``             L = low 32 bits of A
    ``multiply(x, n)``       n times: if L is odd, A = A + x; then A and L together move right by a bit, with A's sign
    ``divide(x, n)``         n times: A and L together move left by a bit; A = A - x, or A + x if A is negative; then
                             L = L + 1 unless A is negative
    ``output(o)``            A appears at output o
    ``jump(l)``              goes on at label l
    ``wait()``               stops until something has happened
    ======================== ==========================================================================================

    So ``load(f); to_low(); load(0); multiply(x, 24)`` leaves ``f * x >> 24`` in A, for f below 2**24, and its low 24
    bits at the top of L; and ``load(f); to_low(); load(0); divide(x, 32)`` leaves ``f // x`` in L: a division that
    never restores. ``multiply(0, n)`` and ``divide(0, n)`` only shift; so ``load_low()``, which is ``load(0);
    divide(0, 32)``, leaves L in A, and L unknown.

    ``with when(flag):`` runs what is in it if the flag is set, ``unless(flag)`` if it is not; ``otherwise()`` may
    follow. The flag ``negative`` is A's sign.

    Parameters
    ----------
    inputs, flags, outputs : names of what the machine is connected to
    """

    def __init__(self, inputs: Sequence[str], flags: Sequence[str], outputs: Sequence[str]) -> None:
        self.inputs = tuple(inputs)
        self.flags = ("always", "negative", *flags)
        self.outputs = tuple(outputs)
        self.variables: dict[str, int] = {}
        self._free = list(range(VARIABLES))
        self.instructions: list[Instruction] = []
        self.labels: dict[str, int] = {}
        self._constants: dict[int, int] = {}
        self._blocks = 0
        self._ended = ""  # label at the end of the last block

    def variable(self, *names: str, address: int | None = None) -> None:
        """Make variables, at an address where it matters. Their values are unknown at first."""
        for name in names:
            if name in self.variables or name in self.inputs:
                raise ValueError(f"{name} is there already")
            if not self._free:
                raise ValueError(f"{name} is one variable too many; {VARIABLES} are possible")
            self.variables[name] = self._free[-1] if address is None else address
            self._free.remove(self.variables[name])

    def load(self, operand: str | int) -> None:
        self._emit(Op.LOAD, operand)

    def load_negative(self, operand: str | int) -> None:
        self._emit(Op.LOAD_NEGATIVE, operand)

    def add(self, operand: str | int) -> None:
        self._emit(Op.ADD, operand)

    def subtract(self, operand: str | int) -> None:
        self._emit(Op.SUBTRACT, operand)

    def store(self, variable: str) -> None:
        if variable not in self.variables:
            raise ValueError(f"{variable} is no variable")
        self._emit(Op.STORE, variable)

    def wrap(self) -> None:
        self._emit(Op.WRAP)

    def to_low(self) -> None:
        self._emit(Op.TO_LOW)

    def multiply(self, operand: str | int, steps: int) -> None:
        self._emit(Op.MULTIPLY, operand, steps=steps)

    def load_low(self) -> None:
        """A = L, without sign; L is lost."""
        self.load(0)
        self.divide(0, LOW_BITS)

    def divide(self, operand: str | int, steps: int) -> None:
        self._emit(Op.DIVIDE, operand, steps=steps)

    def output(self, name: str) -> None:
        self._emit(Op.OUTPUT, name)

    def jump(self, label: str) -> None:
        self._emit(Op.JUMP, label)

    def wait(self) -> None:
        self._emit(Op.WAIT)

    def label(self, name: str) -> None:
        """The next instruction's name, for :meth:`jump`."""
        self.labels[name] = len(self.instructions)

    def put(self, value: int, *variables: str) -> None:
        """Variables become a constant; A does, too."""
        self.load(value)
        for variable in variables:
            self.store(variable)

    @contextmanager
    def when(self, flag: str) -> Iterator[None]:
        with self._block(flag, unless=True):
            yield

    @contextmanager
    def unless(self, flag: str) -> Iterator[None]:
        with self._block(flag, unless=False):
            yield

    @contextmanager
    def otherwise(self) -> Iterator[None]:
        before = self._ended
        if self.labels.get(before) != len(self.instructions):
            raise ValueError("otherwise() does not follow a block")
        end = self._block_label()
        self.jump(end)
        self.label(before)
        yield
        self.label(end)

    @contextmanager
    def _block(self, flag: str, *, unless: bool) -> Iterator[None]:
        end = self._block_label()
        self._emit(Op.JUMP, end, flag=flag, unless=unless)
        yield
        self.label(end)
        self._ended = end

    def _block_label(self) -> str:
        self._blocks += 1
        return f"end of block {self._blocks}"

    def at_most(self, bound: str | int, scratch: str) -> None:
        """A = min(A, bound)."""
        self.store(scratch)
        self.subtract(bound)
        with self.unless("negative"):
            self.put_copy(bound, scratch)
        self.load(scratch)

    def at_least(self, bound: str | int, scratch: str) -> None:
        """A = max(A, bound)."""
        self.store(scratch)
        self.subtract(bound)
        with self.when("negative"):
            self.put_copy(bound, scratch)
        self.load(scratch)

    def put_copy(self, operand: str | int, variable: str) -> None:
        """variable = A = operand."""
        self.load(operand)
        self.store(variable)

    def load_magnitude(self, variable: str) -> None:
        """A = abs(variable)."""
        self.load(variable)
        with self.when("negative"):
            self.load_negative(variable)

    def _emit(
        self, op: Op, operand: str | int = 0, *, flag: str = "always", unless: bool = False, steps: int = 1
    ) -> None:
        if flag not in self.flags:
            raise ValueError(f"{flag} is no flag")
        self.instructions.append(Instruction(op, operand, flag, unless, steps))

    def assemble(self) -> list[dict[str, int]]:
        """The memory above the variables: fields of each instruction, then ``{"constant": value}``.

        Raises
        ------
        ValueError
            A name is unknown, or the program is too long.
        """
        begin = VARIABLES
        constants = sorted({i.operand for i in self.instructions if isinstance(i.operand, int)})
        places = {value: begin + len(self.instructions) + at for at, value in enumerate(constants)}
        words = []
        for instruction in self.instructions:
            operand, outside, address = instruction.operand, 0, 0
            condition = self.flags.index(instruction.flag)
            if instruction.op is Op.JUMP:
                address = begin + self.labels[str(operand)]
            elif instruction.op is Op.OUTPUT:
                address = 1 << self.outputs.index(str(operand))
            elif isinstance(operand, int):
                address = places[operand]
            elif operand in self.variables:
                address = self.variables[operand]
            elif operand in self.inputs:
                outside, address = 1, 1 << self.inputs.index(operand)
            else:
                raise ValueError(f"{operand} is neither a variable nor an input")
            words.append(
                {
                    "op": int(instruction.op),
                    "address": address,
                    "outside": outside,
                    "condition": condition,
                    "unless": int(instruction.unless),
                    "steps": instruction.steps - 1,
                }
            )
        words += [{"constant": value} for value in constants]
        if begin + len(words) > 1 << ADDRESS_BITS:
            raise ValueError(f"the program has {len(words)} words; {(1 << ADDRESS_BITS) - begin} are possible")
        return words

    def run(
        self,
        state: dict[str, int],
        inputs: Mapping[str, int],
        flags: Mapping[str, int],
        begin: str,
    ) -> list[tuple[str, int]]:
        """The definition: goes on at label ``begin``, with A and L at 0, until it waits; ``state`` is the variables.

        Returns
        -------
        what appears at the outputs, in order

        Raises
        ------
        OverflowError
            The accumulator would wrap.
        """
        at, a, low = self.labels[begin], 0, 0
        outputs: list[tuple[str, int]] = []
        while True:
            one = self.instructions[at]
            at += 1
            x = one.operand
            if one.op is Op.WAIT:
                return outputs
            if one.op is Op.JUMP:
                flag = {"always": 1, "negative": int(a < 0)} | dict(flags)
                if bool(flag[one.flag]) != one.unless:
                    at = self.labels[str(x)]
                continue
            if one.op is Op.OUTPUT:
                outputs.append((str(x), a))
                continue
            if one.op is Op.STORE:
                state[str(x)] = a
                continue
            b = x if isinstance(x, int) else state[x] if x in self.variables else inputs[x]
            if one.op is Op.LOAD:
                a = b
            elif one.op is Op.LOAD_NEGATIVE:
                a = -b
            elif one.op is Op.ADD:
                a += b
            elif one.op is Op.SUBTRACT:
                a -= b
            elif one.op is Op.WRAP:
                a = _signed(a, 32)
            elif one.op is Op.TO_LOW:
                low = a & (1 << LOW_BITS) - 1
            elif one.op is Op.MULTIPLY:
                for _ in range(one.steps):
                    a += b if low & 1 else 0
                    low = (a & 1) << LOW_BITS - 1 | low >> 1
                    a >>= 1
            elif one.op is Op.DIVIDE:
                for _ in range(one.steps):
                    a = _signed(a << 1 | low >> LOW_BITS - 1, WORD_BITS)
                    a += b if a < 0 else -b
                    low = (low << 1 | (a >= 0)) & (1 << LOW_BITS) - 1
            if not -(1 << WORD_BITS - 1) <= a < 1 << WORD_BITS - 1:
                raise OverflowError(f"{one} makes {a}, which has no {WORD_BITS} bits")


def _signed(value: int, bits: int) -> int:
    value &= (1 << bits) - 1
    return value - (1 << bits) if value >> bits - 1 else value
