"""The registers, made from the map in :mod:`magtrak.protocol`."""

from amaranth.hdl import Cat, Const, Module, Mux, Shape, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from magtrak import protocol
from magtrak.protocol import LUT_WORDS, REGISTERS, Access, AnswerCode, Register, Scope

from .features import EVERYTHING, Features
from .layouts import FrameSettings, LutWrite, NowSettings, SettingWrite
from .link.packet import Answer, Command
from .memory import BlockRam
from .register_map import BANK_BIT, NOWHERE, NUMBER_BITS, PAGE_BITS, PAGES, TABLE_BASE, TABLES, built, number
from .select import Picked

_CONSTANT = ("magic", "version", "map_hash", "max_columns", "max_rows", "background_cells", "features")
_OWN = ("generation", "pending")

CardStatus = data.StructLayout(
    {r.name: Shape(r.bits, r.signed) for r in REGISTERS if r.scope is Scope.CARD and r.name not in (*_CONSTANT, *_OWN)}
)
"""What the rest of the card shows in its registers."""

_LIVE = (*_OWN, *CardStatus.members)
assert len(_LIVE) <= 32
assert TABLE_BASE % 4 == 0, "the axis of a table is the lowest bits of its number"

TABLE_CLOCKS = 8
"""How long a word that is written to a gate table stays, from ``lut.valid`` on."""


class _Low(data.Struct):
    """About a register: one less than the least value that it takes; 0 where there is none."""

    value: 32
    readable: 1
    writable: 1
    setting: 1
    signed: 1


class _High(data.Struct):
    """The greatest value that it takes; or its value if it is ``constant``; or if ``live`` a bit for what it shows.

    Limits have their top bit inverted where they are signed: then comparing without sign is right for both kinds.
    ``from_least``: every value down to the least one is taken.
    """

    value: 32
    constant: 1
    live: 1
    kept: 1
    from_least: 1


class RegisterFile(wiring.Component):
    """Executes commands: checks, writes, reads, and answers each one.

    Settings of the measurement (scope ``FRAME``) are written into shadows. Writing ``commit`` marks
    them; the next ``frame_start`` brings them in force, all in one clock, with their generation
    number and the other bank of those gate tables that were written since their last swap. A setting or a table word
    that is written while marked settings wait takes the mark off again: settings never come in force half written, and
    need another commit. The answer is ``PENDING`` to a commit, and to reading a setting while a commit waits.

    A value that needs what the card is not built with is out of range.

    What a register takes and shows stands in a ROM, and values that were written are read from a memory that goes
    along with the registers proper. Settings have two words there, in force and shadow; the next shadow is a copy of
    what came in force, made before the first write to it. After reset the memory gets its initial values.

    Latency: 10 clocks from a command to its answer, 2 if it comes refused; 80 more for the first write of a setting
    after a commit came in force, 270 after reset. Throughput: one command at a time, 11 clocks each; others wait.

    Parameters
    ----------
    features : what the card is built with
    keep : a command is kept here while it is executed, and the next one may wait behind it; what is written to the
        tables is kept as well. Without it a command is taken when its answer is, which is :data:`TABLE_CLOCKS` later
        for a table; nothing may come between ``command`` and where it waits that lets go of it sooner. And what the
        ROM says goes through no register, which clocks above some 50 MHz need

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

    def __init__(self, features: Features = EVERYTHING, *, keep: bool = True) -> None:
        self.features = features
        self.keep = keep
        super().__init__(
            {
                "command": In(stream.Signature(Command)),
                "answer": Out(stream.Signature(Answer)),
                "frame_start": In(1),
                "now": Out(NowSettings, init=self._inits(Scope.NOW)),
                "write": Out(stream.Signature(SettingWrite)),
                "frame": Out(FrameSettings, init=self._inits(Scope.FRAME)),
                "generation": Out(16),
                "lut": Out(LutWrite()),
                "status": In(CardStatus),
                "arm": Out(1),
                "arm_key": Out(16),
            }
        )

    def elaborate(self, platform):
        m = Module()
        shadow = Signal(FrameSettings, init=self._inits(Scope.FRAME))
        pending = Signal()
        marked = Signal(16)  # the generation that waits
        written = self.lut.written  # since their last swap
        bank = Signal()  # which words of settings are in force
        stale = Signal()  # the others are older
        comes = self.lut.swap
        m.d.comb += comes.eq(self.frame_start & pending)
        with m.If(comes):
            m.d.sync += [
                *(self.frame.eq(shadow), self.generation.eq(marked)),
                *(pending.eq(0), written.eq(0), bank.eq(~bank), stale.eq(1)),
            ]

        # Neither memory has a word read and written at once: a command reads after it wrote.
        m.submodules.rom = rom = BlockRam(_Low.as_shape().size, 2 << NUMBER_BITS, self._rom())
        m.submodules.values = values = BlockRam(32, 2 << NUMBER_BITS, self._initial())

        command = Signal(Command)
        if not self.keep:
            m.d.comb += command.eq(self.command.payload)
        at = Signal(NUMBER_BITS)  # number of the addressed register
        # The word about it that was read last, flags of the first one, and what it shows.
        fetched = Signal(data.UnionLayout({"low": _Low, "high": _High}))
        about = Signal(4)
        low, high = data.View(_Low, Cat(Const(0, 32), about)), fetched.high
        live = Signal(len(_LIVE))
        above = Signal()
        above_low = Signal()
        inside = Signal()
        m.d.comb += [
            rom.read.addr.eq(Cat(at, 1)),
            above.eq((command.value ^ (low.signed << 31)) > fetched.high.value),
        ]
        m.d["sync" if self.keep else "comb"] += fetched.eq(rom.read.data)

        # Copies, with the word that is read a clock behind its address: of the initial values, which stand above all
        # others, or of the settings in force.
        booting = Signal(init=1)
        step = Signal(NUMBER_BITS + 1)
        copied = Signal(NUMBER_BITS)
        m.d.sync += copied.eq(step)

        def place(number, its_bank):
            """Where the value of a register is."""
            is_setting = ~number[BANK_BIT:].any()
            return Cat(number[:BANK_BIT], number[BANK_BIT] | (is_setting & its_bank), number[BANK_BIT + 1 :])

        m.d.comb += [
            self.write.payload.address.eq(command.address),
            self.write.payload.value.eq(command.value),
        ]
        with m.If(self.write.ready):
            m.d.sync += self.write.valid.eq(0)
        m.d.sync += [self.arm.eq(0), self.lut.valid.eq(0)]
        answer = Signal(Answer)
        code = answer.code
        own = {"generation": self.generation, "pending": pending}
        shown = [own[name] if name in own else self.status[name] for name in _LIVE]
        m.submodules.value = value = Picked(32, len(shown) + 2)
        m.d.comb += [
            *(value.i[n].eq(_extended(one)) for n, one in enumerate([*shown, high.value, values.read.data])),
            *(self.answer.payload.eq(answer), self.answer.payload.value.eq(value.o)),
        ]
        table_left = Signal(range(TABLE_CLOCKS))  # clocks in which what is written to a table has to stay
        if not self.keep:
            m.d.comb += [
                *(self.lut.axis.eq(at), self.lut.word.eq(command.address), self.lut.data.eq(command.value)),
                *(self.arm_key.eq(command.value), _to(self.answer.payload, command)),
            ]
            with m.If(self.lut.valid):
                m.d.sync += table_left.eq(TABLE_CLOCKS - 1)
            with m.Elif(table_left != 0):
                m.d.sync += table_left.eq(table_left - 1)
        m.d.comb += values.read.en.eq(0)
        with m.FSM():
            with m.State("Copy"):
                m.d.comb += [
                    values.read.en.eq(1),
                    values.read.addr.eq(Mux(booting, Cat(step[:NUMBER_BITS], 1), Cat(step[:BANK_BIT], bank))),
                    values.write.en.eq(step != 0),
                    values.write.addr.eq(Mux(booting, copied, Cat(copied[:BANK_BIT], ~bank))),
                    values.write.data.eq(values.read.data),
                ]
                m.d.sync += step.eq(step + 1)
                with m.If(step == Mux(booting, 1 << NUMBER_BITS, 1 << BANK_BIT)):
                    m.d.sync += [booting.eq(0), stale.eq(0), step.eq(0)]
                    m.next = "Find"
                    with m.If(booting):
                        m.next = "Wait"

            with m.State("Wait"):
                if self.keep:
                    m.d.comb += self.command.ready.eq(1)
                    m.d.sync += [command.eq(self.command.payload), _to(answer, self.command.payload)]
                m.d.comb += value.enable.eq(1)
                m.d.sync += code.eq(self.command.payload.refusal)
                with m.If(self.command.valid):
                    m.next = "Find"
                    with m.If(self.command.payload.refusal != AnswerCode.DONE):
                        m.next = "Answer"

            with m.State("Find"):
                self._find(m, command.address, at)
                m.next = "Low"
            with m.State("Low"):
                m.d.comb += rom.read.addr.eq(Cat(at, 0))
                m.next = "High"
            with m.State("High"):
                if not self.keep:
                    m.d.comb += rom.read.addr.eq(Cat(at, 0))  # once more, for its flags stand in `about` a clock later
                m.d.sync += about.eq(rom.read.data[32:])
                m.next = "Above"
            with m.State("Above"):
                m.d.sync += above_low.eq(above)
                m.next = "Below"
            with m.State("Below"):
                m.d.sync += inside.eq((above_low | high.from_least) & ~above)
                m.next = "Execute"

            with m.State("Execute"):
                m.next = "Fetch"
                with m.If(~low.readable & ~low.writable):
                    m.d.sync += code.eq(AnswerCode.UNKNOWN_ADDRESS)
                with m.Elif(~Mux(command.write, low.writable, low.readable)):
                    m.d.sync += code.eq(AnswerCode.NOT_ALLOWED)
                with m.Elif(~command.write):
                    m.d.sync += code.eq(Mux(low.setting & pending, AnswerCode.PENDING.value, AnswerCode.DONE.value))
                with m.Elif(~inside):
                    m.d.sync += code.eq(AnswerCode.OUT_OF_RANGE)
                with m.Elif(low.setting & comes):  # the shadow is in force in the next clock, and not to be written
                    m.next = "Execute"
                with m.Elif(low.setting & stale):
                    m.next = "Copy"
                with m.Else():
                    m.d.comb += [
                        values.write.en.eq(high.kept),
                        values.write.addr.eq(place(at, ~bank)),
                        values.write.data.eq(command.value),
                    ]
                    with m.If(low.setting):
                        m.d.sync += pending.eq(0)
                    with m.Switch(at):
                        for register in REGISTERS:
                            if register.access is not Access.READ:
                                with m.Case(number(register)):
                                    self._write(m, register, command, shadow, pending, marked, written, code)
                                    if register.scope is Scope.NOW and register.access is Access.BOTH:
                                        m.d.sync += self.write.valid.eq(1)

            # What was written shows in what is read.
            with m.State("Fetch"):
                m.d.comb += [values.read.en.eq(1), values.read.addr.eq(place(at, bank))]
                m.d.sync += live.eq(high.value)
                with m.If(~high.live):
                    m.d.sync += live.eq(0)
                m.next = "Read"
            with m.State("Read"):
                m.d.comb += [value.enable.eq(1), value.which.eq(Cat(live, high.constant, high.kept))]
                m.next = "Answer"
            with m.State("Answer"):
                m.d.comb += self.answer.valid.eq(~self.write.valid & (table_left == 0))
                with m.If(self.answer.valid & self.answer.ready):
                    if not self.keep:
                        m.d.comb += self.command.ready.eq(1)
                    m.next = "Wait"

        return m

    @staticmethod
    def _find(m, address, at):
        """Statements that set the number of the register at ``address``, if there is one."""
        m.d.sync += at.eq(NOWHERE)
        within = address[:PAGE_BITS]
        with m.Switch(address[PAGE_BITS:]):
            for page, (base, size) in PAGES.items():
                with m.Case(page):
                    with m.If(within < size):
                        m.d.sync += at.eq(base | within)
        with m.Switch(address):
            for axis, table in enumerate(TABLES):
                bits = (LUT_WORDS - 1).bit_length()
                with m.Case(f"{table.address >> bits:0{16 - bits}b}" + "-" * bits):
                    m.d.sync += at.eq(TABLE_BASE + axis)

    def _write(self, m, register, command, shadow, pending, marked, written, code):
        """Statements that write the command's value into ``register``; one that has but one value takes no cells."""
        lowest, highest, _ = built(register, self.features)
        if register in TABLES:
            axis = TABLES.index(register)
            m.d.sync += [self.lut.valid.eq(1), written[axis].eq(1)]
            if self.keep:
                m.d.sync += [
                    *(self.lut.axis.eq(axis), self.lut.word.eq(command.address)),
                    self.lut.data.eq(command.value),
                ]
        elif register.name == "commit":
            m.d.sync += [pending.eq(1), marked.eq(command.value), code.eq(AnswerCode.PENDING)]
        elif register.name == "laser_arm":
            m.d.sync += self.arm.eq(1)
            if self.keep:
                m.d.sync += self.arm_key.eq(command.value)
        elif lowest != highest:
            values = shadow if register.scope is Scope.FRAME else self.now
            m.d.sync += values[register.name].eq(command.value)

    def _inits(self, scope: Scope) -> dict[str, int]:
        return {r.name: built(r, self.features)[2] for r in REGISTERS if r.scope is scope and r.access is Access.BOTH}

    def _initial(self) -> list[int]:
        """The memory of values, with those after reset in its upper half."""
        words = [0] * (2 << NUMBER_BITS)
        for r in REGISTERS:
            if r.access is Access.BOTH:
                places = [number(r)] if r.scope is Scope.NOW else [number(r), number(r) | 1 << BANK_BIT]
                for place in places:
                    words[place | 1 << NUMBER_BITS] = r.encode(built(r, self.features)[2])
        return words

    def _rom(self) -> list[int]:
        """All about each register."""
        features = self.features
        constants = {
            "magic": protocol.MAGIC,
            "version": protocol.VERSION,
            "map_hash": protocol.map_hash(),
            "max_columns": features.max_columns,
            "max_rows": features.max_rows,
            "background_cells": features.background_cells,
            "features": sum(getattr(features, name) << bit for bit, name in enumerate(protocol.FEATURES)),
        }
        lows, highs = ([0] * (1 << NUMBER_BITS) for _ in range(2))
        for r in REGISTERS:
            lowest, highest, _ = built(r, features)
            low = {
                "value": max(_biased(r, lowest) - 1, 0) if r.access is not Access.READ else 0,
                "readable": r.access is not Access.WRITE,
                "writable": r.access is not Access.READ,
                "setting": r.scope is Scope.FRAME or r.name == "commit",
                "signed": r.signed,
            }
            high = {
                "value": 1 << _LIVE.index(r.name) if r.name in _LIVE else constants.get(r.name, _biased(r, highest)),
                "constant": r.name in constants,
                "live": r.name in _LIVE,
                "kept": r.access is Access.BOTH,
                "from_least": _biased(r, lowest) == 0,
            }
            lows[number(r)] = _Low.as_shape().const(low).as_value().value
            highs[number(r)] = _High.as_shape().const(high).as_value().value
        return lows + highs


def _to(answer, command):
    """Statements by which an answer tells what it answers."""
    return [answer.to.eq(command.sequence), answer.address.eq(command.address)]


def _biased(register: Register, value: int) -> int:
    return value & 0xFFFF_FFFF ^ register.signed << 31


def _extended(value):
    """With its sign, to the 32 bits of an answer."""
    return Cat(value, (value[-1] if value.shape().signed else Const(0)).replicate(32 - len(value)))
