"""The registers, made from the map in :mod:`magtrak.protocol`."""

from collections.abc import Iterable
from functools import reduce
from operator import or_

from amaranth.hdl import Const, Module, Mux, Shape, Signal, ValueLike
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak import protocol
from magtrak.protocol import REGISTERS, Access, AnswerCode, Register, Scope

from .layouts import FrameSettings, LutWrite, NowSettings
from .link.packet import Answer, Command

_OWN = ("magic", "version", "map_hash", "max_columns", "max_rows", "generation", "pending")
"""Registers of scope ``CARD`` that the register file itself answers."""

_TABLES = tuple(r for r in REGISTERS if r.words > 1)
"""The gate tables, in the order of :class:`~gateware.layouts.LutWrite`'s axes."""

_GROUP = 8  # values merged in one clock

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
        hits = Signal(len(REGISTERS))  # which register is addressed: one bit at most

        # About the addressed register. Limits have their top bit inverted where it is signed: then
        # comparing without sign is right for both kinds.
        readable = _merge(m, hits, 1, "readable", (r.access is not Access.WRITE for r in REGISTERS))
        writable = _merge(m, hits, 1, "writable", (r.access is not Access.READ for r in REGISTERS))
        setting = _merge(m, hits, 1, "setting", (r.scope is Scope.FRAME for r in REGISTERS))
        signed = _merge(m, hits, 1, "signed", (r.signed for r in REGISTERS))
        low = _merge(m, hits, 32, "low", (_biased(r, r.range[0]) for r in REGISTERS))
        high = _merge(m, hits, 32, "high", (_biased(r, r.range[1]) for r in REGISTERS))
        current = _merge(m, hits, 32, "current", (self._value(r, pending) for r in REGISTERS))

        biased = Signal(32)
        inside = Signal()
        m.d.comb += [
            biased.eq(command.value ^ (signed << 31)),
            self.lut.swap.eq(self.frame_start & pending),
        ]
        with m.If(self.lut.swap):
            m.d.sync += [self.frame.eq(shadow), self.generation.eq(marked), pending.eq(0)]

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
                for hit, register in zip(hits, REGISTERS, strict=True):
                    m.d.sync += hit.eq(_addresses(command.address, register))
                m.next = "Group"
            with m.State("Group"):
                m.next = "Merge"
            with m.State("Merge"):
                m.next = "Compare"
            with m.State("Compare"):
                m.d.sync += inside.eq((biased >= low) & (biased <= high))
                m.next = "Execute"

            with m.State("Execute"):
                with m.If(~hits.any()):
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
                    for hit, register in zip(hits, REGISTERS, strict=True):
                        if register.access is not Access.READ:
                            with m.If(hit):
                                self._write(m, register, command, shadow, pending, marked, code)
                m.next = "Regroup"

            # What was written shows in what is read.
            with m.State("Regroup"):
                m.next = "Remerge"
            with m.State("Remerge"):
                m.next = "Read"
            with m.State("Read"):
                with m.If(readable):
                    m.d.sync += self.answer.payload.value.eq(current)
                m.next = "Answer"
            with m.State("Answer"):
                m.d.comb += self.answer.valid.eq(1)
                with m.If(self.answer.ready):
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


def _addresses(address: ValueLike, register: Register) -> ValueLike:
    """Whether ``address`` is one of the register's; tables stand at multiples of their size."""
    bits = (register.words - 1).bit_length()
    assert register.words == 1 << bits and register.address % register.words == 0, register
    return address[bits:] == register.address >> bits


def _biased(register: Register, value: int) -> int:
    return value & 0xFFFF_FFFF ^ register.signed << 31


def _merge(m: Module, hits: Signal, width: int, name: str, values: Iterable[ValueLike]) -> Signal:
    """The value whose bit in ``hits`` is set, 0 without one, 2 clocks later."""
    words = []
    for number, value in enumerate(values):
        word = Const(value, width) if isinstance(value, int) else Signal(width, name=f"{name}{number}")
        if isinstance(word, Signal):
            m.d.comb += word.eq(value)  # with its sign
        words.append(Mux(hits[number], word, 0))
    groups = []
    for start in range(0, len(words), _GROUP):
        group = Signal(width, name=f"{name}_group{start // _GROUP}")
        m.d.sync += group.eq(reduce(or_, words[start : start + _GROUP]))
        groups.append(group)
    merged = Signal(width, name=name)
    m.d.sync += merged.eq(reduce(or_, groups))
    return merged
