"""The registers, made from the map in :mod:`magtrak.protocol`."""

from collections.abc import Iterable

from amaranth.hdl import Module, Mux, Shape, Signal, ValueLike
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak import protocol
from magtrak.protocol import REGISTERS, Access, AnswerCode, Register, Scope

from .layouts import FrameSettings, LutWrite, NowSettings, SettingWrite
from .link.packet import Answer, Command

_OWN = ("magic", "version", "map_hash", "max_columns", "max_rows", "generation", "pending")
"""Registers of scope ``CARD`` that the register file itself answers."""

_TABLES = tuple(r for r in REGISTERS if r.words > 1)
"""The gate tables, in the order of :class:`~gateware.layouts.LutWrite`'s axes."""

_GROUP_BITS = 3  # of a register's number: so many values are looked through in one clock

CardStatus = data.StructLayout(
    {r.name: Shape(r.bits, r.signed) for r in REGISTERS if r.scope is Scope.CARD and r.name not in _OWN}
)
"""What the rest of the card shows in its registers."""


class RegisterFile(wiring.Component):
    """Executes commands: checks, writes, reads, and answers each one.

    Settings of the measurement (scope ``FRAME``) are written into shadows. Writing ``commit`` marks
    them; the next ``frame_start`` brings them in force, all in one clock, with their generation
    number and the other bank of the gate tables. A setting or a table word that is written while marked
    settings wait takes the mark off again: settings never come in force half written, and need
    another commit. The answer is ``PENDING`` to a commit, and to reading a setting while a commit waits.

    Latency: 9 clocks from a command to its answer, 2 if it comes refused. Throughput: one command at a
    time, 10 clocks each; others wait.

    Parameters
    ----------
    max_columns, max_rows : what the registers of these names say

    Members
    -------
    command : intact commands; those that come refused are only answered
    answer : one for each command, in order
    frame_start : strobe: the first pixel of an image is taken in this clock
    now : settings of scope ``NOW`` in force
    write : stream of :class:`~gateware.layouts.SettingWrite`, what ``now`` has been given; its answer waits for it
    frame : settings of scope ``FRAME`` in force, new in the clock after ``frame_start``
    generation : generation in force
    lut : writes to the gate tables; ``swap`` comes with ``frame_start``
    status : values of the read-only registers
    arm, arm_key : strobe and value of a write to ``laser_arm``
    """

    def __init__(self, max_columns: int, max_rows: int) -> None:
        self.max_columns = max_columns
        self.max_rows = max_rows
        super().__init__(
            {
                "command": In(stream.Signature(Command)),
                "answer": Out(stream.Signature(Answer)),
                "frame_start": In(1),
                "now": Out(NowSettings, init=_inits(Scope.NOW)),
                "write": Out(stream.Signature(SettingWrite)),
                "frame": Out(FrameSettings, init=_inits(Scope.FRAME)),
                "generation": Out(16),
                "lut": Out(LutWrite()),
                "status": In(CardStatus),
                "arm": Out(1),
                "arm_key": Out(16),
            }
        )

    def elaborate(self, platform):
        m = Module()
        shadow = Signal(FrameSettings, init=_inits(Scope.FRAME))
        pending = Signal()
        marked = Signal(16)  # the generation that waits

        command = Signal(Command)
        number = Signal(range(len(REGISTERS)))  # which register is addressed
        known = Signal()

        # About the addressed register. Limits have their top bit inverted where it is signed: then
        # comparing without sign is right for both kinds.
        facts = {
            "readable": _Looked(1, (r.access is not Access.WRITE for r in REGISTERS), "readable"),
            "writable": _Looked(1, (r.access is not Access.READ for r in REGISTERS), "writable"),
            "setting": _Looked(1, (r.scope is Scope.FRAME for r in REGISTERS), "setting"),
            "signed": _Looked(1, (r.signed for r in REGISTERS), "signed"),
            "low": _Looked(32, (_biased(r, r.range[0]) for r in REGISTERS), "low"),
            "high": _Looked(32, (_biased(r, r.range[1]) for r in REGISTERS), "high"),
        }
        readable, writable, setting, signed, low, high = (fact.value for fact in facts.values())
        content = _Looked(32, (self._value(r, pending) for r in REGISTERS), "current")
        current = content.value

        biased = Signal(32)
        inside = Signal()
        m.d.comb += [
            biased.eq(command.value ^ (signed << 31)),
            self.lut.swap.eq(self.frame_start & pending),
        ]
        with m.If(self.lut.swap):
            m.d.sync += [self.frame.eq(shadow), self.generation.eq(marked), pending.eq(0)]

        m.d.comb += [
            self.write.payload.address.eq(command.address),
            self.write.payload.value.eq(command.value),
        ]
        with m.If(self.write.ready):
            m.d.sync += self.write.valid.eq(0)
        m.d.sync += [self.arm.eq(0), self.lut.valid.eq(0)]
        code = self.answer.payload.code
        with m.FSM():
            with m.State("Wait"):
                m.d.comb += self.command.ready.eq(1)
                m.d.sync += [
                    command.eq(self.command.payload),
                    self.answer.payload.to.eq(self.command.payload.sequence),
                    self.answer.payload.address.eq(self.command.payload.address),
                    self.answer.payload.value.eq(0),
                    code.eq(self.command.payload.refusal),
                ]
                with m.If(self.command.valid):
                    m.next = "Find"
                    with m.If(self.command.payload.refusal != AnswerCode.DONE):
                        m.next = "Answer"

            with m.State("Find"):
                m.d.sync += [known.eq(0), number.eq(0)]
                with m.Switch(command.address):
                    for at, register in enumerate(REGISTERS):
                        with m.Case(_pattern(register)):
                            m.d.sync += [known.eq(1), number.eq(at)]
                m.next = "Group"
            with m.State("Group"):
                for looked in (*facts.values(), content):
                    looked.group(m, number)
                m.next = "Merge"
            with m.State("Merge"):
                for looked in (*facts.values(), content):
                    looked.merge(m, number)
                m.next = "Compare"
            with m.State("Compare"):
                m.d.sync += inside.eq((biased >= low) & (biased <= high))
                m.next = "Execute"

            with m.State("Execute"):
                with m.If(~known):
                    m.d.sync += code.eq(AnswerCode.UNKNOWN_ADDRESS)
                with m.Elif(~Mux(command.write, writable, readable)):
                    m.d.sync += code.eq(AnswerCode.NOT_ALLOWED)
                with m.Elif(~command.write):
                    m.d.sync += code.eq(Mux(setting & pending, AnswerCode.PENDING.value, AnswerCode.DONE.value))
                with m.Elif(~inside):
                    m.d.sync += code.eq(AnswerCode.OUT_OF_RANGE)
                with m.Else():
                    with m.If(setting):
                        m.d.sync += pending.eq(0)
                    with m.Switch(number):
                        for at, register in enumerate(REGISTERS):
                            if register.access is not Access.READ:
                                with m.Case(at):
                                    self._write(m, register, command, shadow, pending, marked, code)
                                    if register.scope is Scope.NOW and register.access is Access.BOTH:
                                        m.d.sync += self.write.valid.eq(1)
                m.next = "Regroup"

            # What was written shows in what is read.
            with m.State("Regroup"):
                content.group(m, number)
                m.next = "Remerge"
            with m.State("Remerge"):
                content.merge(m, number)
                m.next = "Read"
            with m.State("Read"):
                with m.If(known & readable):
                    m.d.sync += self.answer.payload.value.eq(current)
                m.next = "Answer"
            with m.State("Answer"):
                m.d.comb += self.answer.valid.eq(~self.write.valid)
                with m.If(self.answer.valid & self.answer.ready):
                    m.next = "Wait"

        return m

    def _value(self, register: Register, pending: Signal) -> ValueLike:
        """What reading ``register`` gives."""
        own = {
            "magic": protocol.MAGIC,
            "version": protocol.VERSION,
            "map_hash": protocol.map_hash(),
            "max_columns": self.max_columns,
            "max_rows": self.max_rows,
            "generation": self.generation,
            "pending": pending,
        }
        if register.name in own:
            return own[register.name]
        if register.access is Access.WRITE:
            return 0
        return {Scope.CARD: self.status, Scope.NOW: self.now, Scope.FRAME: self.frame}[register.scope][register.name]

    def _write(self, m, register, command, shadow, pending, marked, code):
        """Statements that write the command's value into ``register``."""
        if register in _TABLES:
            m.d.sync += [
                self.lut.valid.eq(1),
                self.lut.axis.eq(_TABLES.index(register)),
                self.lut.word.eq(command.address),
                self.lut.data.eq(command.value),
            ]
        elif register.name == "commit":
            m.d.sync += [pending.eq(1), marked.eq(command.value), code.eq(AnswerCode.PENDING)]
        elif register.name == "laser_arm":
            m.d.sync += [self.arm.eq(1), self.arm_key.eq(command.value)]
        else:
            values = shadow if register.scope is Scope.FRAME else self.now
            m.d.sync += values[register.name].eq(command.value)


def _inits(scope: Scope) -> dict[str, int]:
    return {r.name: r.init for r in REGISTERS if r.scope is scope and r.access is Access.BOTH}


def _pattern(register: Register) -> str:
    """The register's addresses, as a pattern; tables stand at multiples of their size."""
    bits = (register.words - 1).bit_length()
    assert register.words == 1 << bits and register.address % register.words == 0, register
    return f"{register.address >> bits:0{16 - bits}b}" + "-" * bits


def _biased(register: Register, value: int) -> int:
    return value & 0xFFFF_FFFF ^ register.signed << 31


class _Looked:
    """A value for each register, looked up by the register's number in two clocks: :meth:`group`, then :meth:`merge`.

    One clock for all would be too long a way. Nothing moves in other clocks, which spares a simulation much work.
    """

    def __init__(self, width: int, values: Iterable[ValueLike], name: str) -> None:
        listed = list(values)
        size = 1 << _GROUP_BITS
        self._groups = [
            (Signal(width, name=f"{name}_group{start // size}"), listed[start : start + size])
            for start in range(0, len(listed), size)
        ]
        self.value = Signal(width, name=name)

    def group(self, m: Module, number: ValueLike) -> None:
        """In the present clock each group takes the value whose number ends so."""
        for held, values in self._groups:
            with m.Switch(number[:_GROUP_BITS]):
                for at, value in enumerate(values):
                    with m.Case(at):
                        m.d.sync += held.eq(value)  # with its sign

    def merge(self, m: Module, number: ValueLike) -> None:
        """In the present clock ``value`` takes that of the right group."""
        with m.Switch(number[_GROUP_BITS:]):
            for at, (held, _) in enumerate(self._groups):
                with m.Case(at):
                    m.d.sync += self.value.eq(held)
