"""Fuzzes the card's command parser: ``python -m tests.fuzz.gateware --seconds N``.

Streams of intact, odd and damaged commands go into the compiled gateware. A model of the card reads the same bytes
with the protocol's own codec, and tells every answer that must come: a damaged command has none, an intact one that
comes later has its own. Images in between bring settings in force.
"""

import argparse
import random
import sys
import time
from pathlib import Path

import numpy as np

from magtrak import protocol
from magtrak.frames import decode_frame
from magtrak.protocol import REGISTERS, Access, AnswerCode, Packet, PacketType, Phase, Register, Scope, frame_packet
from magtrak.protocol.cobs import unframe_packet
from tests.support.card_link import CLOCK_HZ, CardLink

KEPT = Path("build/fuzz")
IMAGE = np.full((2, 16, 3), 90, np.uint8)

_BY_ADDRESS = {r.address + word: r for r in REGISTERS for word in range(r.words)}
_KNOWN = {
    "magic": protocol.MAGIC,
    "version": protocol.VERSION,
    "map_hash": protocol.map_hash(),
    "clock_hz": CLOCK_HZ,
    "max_columns": 2048,
    "max_rows": 2048,
    "serial_low": 0,
    "serial_high": 0,
    "link_baud": 0,
    "line_errors": 0,
}
"""What read-only registers say; of the others only that they answer."""


class Model:
    """What a card answers to a stream of bytes, by the protocol.

    Attributes
    ----------
    damaged, intact : commands so far
    """

    def __init__(self) -> None:
        self.now = {r.name: r.init for r in REGISTERS if r.scope is Scope.NOW}
        self.shadow = {r.name: r.init for r in REGISTERS if r.scope is Scope.FRAME}
        self.frame = dict(self.shadow)
        self.pending = False
        self.marked = self.generation = 0
        self.damaged = self.intact = 0
        self._rest = b""

    def answers(self, stream: bytes) -> list[dict[str, int | None]]:
        """Answers in order; a value that cannot be known is None."""
        *stretches, self._rest = (self._rest + stream).split(b"\0")
        answers = []
        for stretch in filter(None, stretches):
            try:
                packet = unframe_packet(stretch)
            except ValueError:
                packet = None
            if packet is None or packet.type < 0x80:
                self.damaged += 1
                continue
            self.intact += 1
            known = packet.type in (PacketType.READ, PacketType.WRITE)
            if known and len(packet.payload) == protocol.COMMAND.size:
                command = protocol.COMMAND.unpack(packet.payload)
                code, value = self._execute(packet.type, command["address"], command["value"])
                answers.append({"to": packet.sequence, "code": code, "address": command["address"], "value": value})
            else:
                code = AnswerCode.MALFORMED if known else AnswerCode.UNKNOWN_TYPE
                answers.append({"to": packet.sequence, "code": code, "address": 0, "value": 0})
        return answers

    def image(self) -> int | None:
        """An image begins; the generation of its frame, or None where it is not wanted."""
        if not self.now["run"]:
            return None
        if self.pending:
            self.frame, self.generation, self.pending = dict(self.shadow), self.marked, False
        return self.generation

    def _execute(self, kind: int, address: int, value: int) -> tuple[AnswerCode, int | None]:
        entry = _BY_ADDRESS.get(address)
        if entry is None:
            return AnswerCode.UNKNOWN_ADDRESS, 0
        code = AnswerCode.DONE
        if kind == PacketType.READ:
            if entry.access is Access.WRITE:
                return AnswerCode.NOT_ALLOWED, 0
            if entry.scope is Scope.FRAME and self.pending:
                code = AnswerCode.PENDING
        elif entry.access is Access.READ:
            code = AnswerCode.NOT_ALLOWED
        else:
            low, high = entry.range
            number = value - (1 << 32) if entry.signed and value >> 31 else value
            if low <= number <= high:
                code = self._write(entry, number)
            else:
                code = AnswerCode.OUT_OF_RANGE
        return code, self._value(entry)

    def _write(self, entry: Register, number: int) -> AnswerCode:
        if entry.scope is Scope.FRAME:
            self.pending = False
            self.shadow[entry.name] = number
        elif entry.name == "commit":
            self.pending, self.marked = True, number
            return AnswerCode.PENDING
        else:
            self.now[entry.name] = number
        return AnswerCode.DONE

    def _value(self, entry: Register) -> int | None:
        if entry.access is Access.WRITE:
            return 0
        if entry.scope is Scope.CARD:
            own = _KNOWN | {"generation": self.generation, "pending": int(self.pending)}
            return own.get(entry.name)
        return (self.now if entry.scope is Scope.NOW else self.frame)[entry.name] & 0xFFFF_FFFF


def stream(rng: random.Random, packets: int) -> bytes:
    """Commands, most of them intact, and what may become of commands on a bad line."""
    out = bytearray()
    for _ in range(packets):
        wire = bytearray(_packet(rng))
        for _ in range(rng.choice([0, 0, 0, 0, 1, 1, 3])):
            at = rng.randrange(len(wire) or 1)
            match rng.randrange(7):
                case 0:
                    wire[at:at] = rng.randbytes(rng.choice([1, 1, 5]))
                case 1:
                    del wire[at : at + rng.choice([1, 1, 4])]
                case 2:
                    del wire[at:]  # cut off, delimiter and all
                case 3:
                    wire[at:at] = _packet(rng)[: rng.randrange(12)]
                case 4:
                    wire += bytes(rng.randrange(4))
                case _ if wire:
                    wire[at] ^= 1 << rng.randrange(8)
        out += wire
    return bytes(out)


def _packet(rng: random.Random) -> bytes:
    kind = rng.choice([PacketType.READ, PacketType.WRITE, PacketType.WRITE, PacketType.WRITE, rng.randrange(256)])
    entry = rng.choice(REGISTERS)
    address = rng.choice([entry.address + rng.randrange(entry.words)] * 8 + [rng.randrange(1 << 16)])
    low, high = entry.range
    value = rng.choice([low, high, entry.init, rng.randint(low, high), low - 1, high + 1, rng.getrandbits(32)])
    payload = protocol.COMMAND.pack({"address": address, "value": value & 0xFFFF_FFFF})
    if rng.random() < 0.08:
        payload = rng.choice([payload[:-1], payload + b"\0", b"", rng.randbytes(rng.choice([3, 40, 260, 600]))])
    return frame_packet(Packet(kind, rng.getrandbits(16), payload))


class Session:
    """A card and its model side by side."""

    def __init__(self) -> None:
        self.card = CardLink()
        self.model = Model()
        self.commands = 0

    def batch(self, data: bytes) -> None:
        """Send ``data``, end them with a zero, and compare; :exc:`AssertionError` where card and model differ."""
        card, model = self.card, self.model
        wanted = model.answers(data + b"\0")
        card.core.send(data + b"\0")
        card.settle()
        self.commands += len(wanted)
        got = list(card.answers)
        card.answers.clear()
        for number, (answer, expected) in enumerate(zip(got, wanted, strict=False)):
            known = {name: value for name, value in expected.items() if value is not None}
            assert answer.items() >= known.items(), f"answer {number} is {answer}, not {expected}"
        assert len(got) == len(wanted), f"{len(got)} answers, not {len(wanted)}"
        model.intact += 2  # the two that follow
        assert card.read("damaged_commands") == min(model.damaged, 0xFFFF)
        assert card.read("commands") == model.intact & 0xFFFF
        assert card.deframer.damaged == 0

    def image(self) -> None:
        """Show an image: it gives a frame with the generation in force, or none."""
        card = self.card
        generation = self.model.image()
        card.frames.clear()
        card.show(IMAGE)
        card.settle()
        assert len(card.frames) == (generation is not None)
        for payload in card.frames:
            frame = decode_frame(payload)
            assert frame.header["generation"] == generation
            dark = frame.header["phase"] in (Phase.BACKGROUND, Phase.SKIPPED)
            assert frame.header["rows"] == (0 if dark else len(IMAGE))

    def close(self) -> None:
        self.card.close()


def fuzz(seed: int, batches: int) -> Session:
    """A card's life of so many batches; what made it fail is kept in ``build/fuzz``."""
    rng = random.Random(seed)
    session = Session()
    try:
        for number in range(batches):
            data = stream(rng, rng.choice([1, 5, 40, 200]))
            try:
                session.batch(data)
                if rng.random() < 0.5:
                    session.image()
            except AssertionError as error:
                KEPT.mkdir(parents=True, exist_ok=True)
                place = KEPT / f"gateware-{seed}-{number}.bin"
                place.write_bytes(data)
                raise AssertionError(f"seed {seed}, batch {number} (kept as {place}): {error}") from error
    finally:
        session.close()
    return session


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--seconds", type=float, default=60, help="how long to go on (default 60)")
    parser.add_argument("--seed", type=int, default=random.randrange(1 << 30), help="of the first card")
    options = parser.parse_args()
    started = time.monotonic()
    cards = commands = damaged = 0
    while time.monotonic() < started + options.seconds:
        try:
            session = fuzz(options.seed + cards, 20)
        except AssertionError as error:
            sys.exit(str(error))
        cards, commands, damaged = cards + 1, commands + session.commands, damaged + session.model.damaged
    print(f"{cards} cards from seed {options.seed}, {commands} commands answered, {damaged} damaged ones not")


if __name__ == "__main__":
    main()
