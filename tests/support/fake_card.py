"""A card that is none: it speaks the protocol over a pseudo-terminal, for tests of the host."""

import os
import threading
import time
import tty
from collections.abc import Callable, Sequence
from types import TracebackType

from magtrak import protocol
from magtrak.protocol import AnswerCode, Deframer, Packet, PacketType, Scope, frame_packet

from .frames import CLOCK_HZ

_BY_ADDRESS = {r.address + word: r for r in protocol.REGISTERS for word in range(r.words)}


class FakeCard:
    """Answers commands, and sends given frame payloads one after the other once ``run`` is 1.

    Parameters
    ----------
    payloads : payloads of frame packets; the generation in force is put into each
    frame_s : time between two frames
    loop_for_ever : after the last frame stay silent instead of closing
    identity : registers that lie, by name
    refuse : registers whose writing is refused, by name
    drop_answers : numbers of commands, from 0 on, that get no answer
    cut_after : close in the middle of the frame of this number
    chatter : bytes to send all the time instead of answering anything
    line : what becomes of the bytes on the line, in each direction
    skip_sequence_at : sequence number after which one is left out
    reset_in : reset in the middle of the frame of this number, and be a card after power-up from then on

    Attributes
    ----------
    port : what to open
    registers : values as written, by address
    written : names of the registers written, in order
    frames_sent : so far
    """

    def __init__(
        self,
        payloads: Sequence[bytes] = (),
        *,
        frame_s: float = 0.0,
        loop_for_ever: bool = False,
        identity: dict[str, int] | None = None,
        refuse: Sequence[str] = (),
        drop_answers: Sequence[int] = (),
        cut_after: int | None = None,
        chatter: bytes = b"",
        line: Callable[[bytes], bytes] | None = None,
        reset_in: int | None = None,
        skip_sequence_at: int | None = None,
    ) -> None:
        self.payloads = list(payloads)
        self.frame_s = frame_s
        self.loop_for_ever = loop_for_ever
        self.refuse = refuse
        self.drop_answers = drop_answers
        self.cut_after = cut_after
        self.chatter = chatter
        self.line = line or (lambda data: data)
        self.reset_in = reset_in
        self.skip_sequence_at = skip_sequence_at
        self._known = {
            "magic": protocol.MAGIC,
            "version": protocol.VERSION,
            "map_hash": protocol.map_hash(),
            "clock_hz": CLOCK_HZ,
            "max_columns": 2048,
            "max_rows": 2048,
            "features": (1 << len(protocol.FEATURES)) - 1,
            "background_cells": 19200,
        }
        self._known |= identity or {}
        self._reset()
        self.written: list[tuple[str, int]] = []
        self.commands = 0
        self.frames_sent = 0
        self._stop = threading.Event()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def value(self, name: str) -> int:
        """A register as last written."""
        entry = protocol.register(name)
        return entry.decode(self.registers[entry.address])

    def join(self) -> None:
        """Wait until it has closed the port by itself."""
        self._thread.join(timeout=60)
        assert not self._thread.is_alive()

    def __enter__(self) -> "FakeCard":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join(timeout=60)
        assert not self._thread.is_alive()

    def _reset(self) -> None:
        self.registers = {address: r.init for address, r in _BY_ADDRESS.items()}
        for name, value in self._known.items():
            self.registers[protocol.register(name).address] = value
        self._sequence = 0

    def _run(self) -> None:
        deframer = Deframer()
        at, due = 0, 0.0
        while not self._stop.is_set():
            self._send(self.chatter)
            try:
                data = os.read(self._master, 4096)
            except BlockingIOError:
                data = b""
                time.sleep(0.001)
            for packet in deframer.feed(self.line(data)):
                if not self.chatter:
                    self._answer(packet)
            if not self.value("run") or time.monotonic() < due:
                continue
            due = (due or time.monotonic()) + self.frame_s  # one that is late does not delay the next
            if at < len(self.payloads):
                wire = self._frame(self.payloads[at])
                if at == self.reset_in:
                    self._send(wire[: len(wire) // 2] + b"\0")  # as the gateware does after a reset
                    self._reset()
                    at += 1
                    continue
                if at == self.cut_after:
                    self._send(wire[: len(wire) // 2])
                    break
                self._send(wire)
                at += 1
                self.frames_sent = at
            elif not self.loop_for_ever:
                break
        self._drain()
        os.close(self._master)
        os.close(self._slave)

    def _drain(self) -> None:
        """Closing throws away what the other end has not read."""
        import array
        import fcntl
        import termios

        quiet, deadline = 0, time.monotonic() + 3
        while quiet < 15 and time.monotonic() < deadline and not self._stop.is_set():
            waiting = array.array("i", [0])
            fcntl.ioctl(self._slave, termios.FIONREAD, waiting)
            quiet = quiet + 1 if waiting[0] == 0 else 0
            time.sleep(0.01)

    def _frame(self, payload: bytes) -> bytes:
        head = protocol.FRAME.unpack(payload[: protocol.FRAME.size])
        head["generation"] = self.registers[protocol.register("commit").address]
        return self._packet(PacketType.FRAME, protocol.FRAME.pack(head) + payload[protocol.FRAME.size :])

    def _packet(self, kind: PacketType, payload: bytes) -> bytes:
        self._sequence += 1 + (self._sequence == self.skip_sequence_at)
        return frame_packet(Packet(kind, (self._sequence - 1) & 0xFFFF, payload))

    def _answer(self, packet: Packet) -> None:
        number = self.commands
        self.commands += 1
        command = protocol.COMMAND.unpack(packet.payload)
        entry = _BY_ADDRESS[command["address"]]
        code = AnswerCode.DONE
        if packet.type == PacketType.WRITE:
            if entry.name in self.refuse:
                code = AnswerCode.NOT_ALLOWED
            else:
                self.registers[command["address"]] = command["value"]
                self.written.append((entry.name, entry.decode(command["value"])))
                if entry.scope is Scope.FRAME or entry.name == "commit":
                    code = AnswerCode.PENDING
        if number in self.drop_answers:
            return
        answer = {
            "to": packet.sequence,
            "code": code,
            "address": command["address"],
            "value": self.registers[command["address"]],
        }
        self._send(self._packet(PacketType.ANSWER, protocol.ANSWER.pack(answer)))

    def _send(self, data: bytes) -> None:
        data = self.line(data)
        while data and not self._stop.is_set():
            try:
                data = data[os.write(self._master, data) :]
            except BlockingIOError:
                time.sleep(0.001)
