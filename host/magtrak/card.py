"""A card at the end of a link: who it is, its registers, its frames."""

import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from . import protocol
from .built import Built
from .clock import CardClock
from .errors import CardError, CardResetError, LinkError, RefusedError
from .frames import DamagedFrameError, Frame, decode_frame
from .link import Link
from .protocol import AnswerCode, Packet, PacketType, Register, register
from .safety import Safety
from .settings import Settings

WINDOW = 8
"""Commands that may be under way at once; so many fit any card's buffer."""

ANSWER_TIMEOUT_S = 2.0
ATTEMPTS = 3
SILENCE_S = 10.0
"""A card that neither sends nor answers for so long is taken for dead."""

CHECK_S = 1.0
"""How often the card is asked whether it still runs: after a reset it would answer, and never send a frame."""

_SAFETY = register("safety").address
_RUN = register("run").address

_REFUSALS = {
    AnswerCode.UNKNOWN_TYPE: "does not know this kind of command",
    AnswerCode.UNKNOWN_ADDRESS: "has no such register",
    AnswerCode.NOT_ALLOWED: "does not allow it",
    AnswerCode.OUT_OF_RANGE: "finds the value out of range",
    AnswerCode.MALFORMED: "cannot read the command",
    AnswerCode.NO_CLOCK: "has no pixel clock, which the gate's tables need; is the camera connected and on?",
}


@dataclass(frozen=True)
class Identity:
    """What the card says of itself."""

    version: int
    map_hash: int
    clock_hz: int
    max_columns: int
    max_rows: int
    built: Built
    serial: int = 0
    link_baud: int = 0

    @property
    def rows(self) -> int:
        """Rows that an image may have: in the full form, or in the compact one on a card that has no other."""
        if self.built.has("full_rows"):
            return self.max_rows
        return min(self.max_rows * (protocol.FULL_ROW.size // protocol.COMPACT_ROW.size), 2048)

    @property
    def serial_text(self) -> str:
        """The serial number as people write it; "-" for a card without."""
        return f"{self.serial:X}" if self.serial else "-"


@dataclass(frozen=True)
class _Command:
    kind: PacketType
    register: Register
    address: int
    value: int

    def describe(self) -> str:
        if self.kind is PacketType.READ:
            return f"reading {self.register.name}"
        return f"writing {self.register.decode(self.value)} to {self.register.name}"


class Card:
    """Registers and frames of a card. Greets it first, and refuses one that it does not understand.

    Parameters
    ----------
    link : open link; the caller closes it
    answer_timeout_s : how long an answer may take before the command is sent again

    Attributes
    ----------
    identity : what the card says of itself
    damaged_frames : frames intact on the wire whose content cannot be
    clock : the card's clock against the computer's, from the frames given out
    delays_s : how much later than the quickest ones the frames given out last came
    on_snapshot : called with each packet of a snapshot
    round_trips_s : how long the last answers took, while commands were waited for

    Raises
    ------
    CardError
        Nobody answers, or somebody that is no card of this version.
    """

    def __init__(self, link: Link, answer_timeout_s: float = ANSWER_TIMEOUT_S) -> None:
        self.link = link
        self.answer_timeout_s = answer_timeout_s
        self.damaged_frames = 0
        self.clock = CardClock()
        self.on_snapshot: Callable[[Packet], None] | None = None
        self.delays_s: deque[float] = deque(maxlen=1000)
        self.round_trips_s: deque[float] = deque(maxlen=100)
        self._frames: deque[tuple[Packet, float]] = deque()
        self._lease_s = 1.0
        self._last_command = time.monotonic()
        self._last_packet = time.monotonic()
        self._card_time_s = self._heard_s = 0.0
        self._armed = False
        self._fault: CardError | None = None
        self._before_fault = 0
        self._running = False
        self._checked_s = time.monotonic()
        self.identity = self._greet()
        link.begin()

    def read(self, name: str) -> int:
        """The value of a register: for settings of the measurement, the one in force."""
        return self.read_all([name])[0]

    def read_all(self, names: Sequence[str]) -> list[int]:
        """The values of registers, several commands under way at once."""
        entries = [register(name) for name in names]
        answers = self._run([_Command(PacketType.READ, entry, entry.address, 0) for entry in entries])
        return [entry.decode(answer["value"]) for entry, answer in zip(entries, answers, strict=True)]

    def write(self, name: str, value: int) -> None:
        """Write a register; :exc:`CardError` where the card refuses, :exc:`ValueError` where no card could take it."""
        self.write_all([(name, [value])])

    def write_all(self, values: Sequence[tuple[str, Sequence[int]]]) -> None:
        """Write registers in order, tables with all their words, several commands under way at once.

        :exc:`SettingsError` where one needs what the card is built without; then none is written.
        """
        self.identity.built.check(values)
        commands = []
        for name, words in values:
            entry = register(name)
            for number, word in enumerate(words):
                commands.append(_Command(PacketType.WRITE, entry, entry.address + number, entry.encode(word)))
        self._run(commands)

    def ask(self, kind: int, address: int, value: int = 0) -> Mapping[str, int]:
        """One command as it is, even a wrong one, and its answer, even a refusal; :exc:`CardError` without one."""
        payload = protocol.COMMAND.pack({"address": address, "value": value & 0xFFFF_FFFF})
        for _ in range(ATTEMPTS):
            sequence = self.link.send(kind, payload)
            deadline = time.monotonic() + self.answer_timeout_s
            while (left := deadline - time.monotonic()) > 0:
                answer = self._receive(left)
                if answer is not None and answer["to"] == sequence:
                    return answer
        raise CardError(f"the card at {self.link.port} does not answer: check port and baud rate")

    def commit(self) -> int:
        """Put what was written in force from the next image on; returns the generation that it will have."""
        generation = self.read("generation") % 0xFFFF + 1
        self.write("commit", generation)
        return generation

    def wait_in_force(self, generation: int, timeout_s: float) -> bool:
        """Whether settings of that generation are in force before ``timeout_s`` is over; without images they wait."""
        deadline = time.monotonic() + timeout_s
        while True:
            if self.read_all(["generation", "pending"]) == [generation, 0]:
                return True
            if time.monotonic() >= deadline:
                return False
            time.sleep(0.01)

    def apply(self, settings: Settings) -> int:
        """Write all settings and commit them; returns the generation under which frames will have them.

        The laser stays off and the motor stands: see :meth:`start`.
        """
        built = self.identity.built
        built.check([("motor_mode", [settings.motor.mode_word()])])  # sooner than when the motor is to start
        values = built.fitted({name: words[0] for name, words in settings.register_values(self.identity.clock_hz)})
        self.write_all([*((name, [value]) for name, value in values.items()), *settings.tables()])
        self._lease_s = settings.laser.lease_s
        return self.commit()

    def start(self, settings: Settings) -> None:
        """Arm the laser, start the motor, send frames, as the settings have it."""
        self._fault = None
        if settings.laser.arm:
            self.write("laser_arm", protocol.LASER_KEY)
            self._armed = True
        mode = settings.motor.mode_word()
        self.write_all([("motor_duty", [settings.motor.duty_word()]), ("motor_mode", [mode]), ("run", [1])])
        self._running = True

    def safety(self) -> Safety:
        """State of laser and motor, and what ended them last."""
        return Safety.of(self.read("safety"))

    def stop(self) -> None:
        """Laser disarmed, motor off, no more frames."""
        self._armed = self._running = False
        self.write_all([("laser_arm", [0]), ("motor_mode", [0]), ("run", [0])])

    def frames(self, poll_s: float = 0.1) -> Iterator[Frame | None]:
        """Frames as they come, and None whenever none came for ``poll_s``. Keeps the laser's lease alive.

        Raises
        ------
        EndOfStreamError, LinkError
            The stream ended, after all frames that came.
        CardError
            The card has fallen silent, or it has stopped laser or motor, or was reset; in one sentence, why. All frames
            that came before were given out.
        """
        while True:
            self._keep_lease()
            if not self._frames and self._fault is None:
                self._receive(poll_s)
            if self._fault is not None and self._before_fault == 0:
                raise self._fault
            if not self._frames:
                if time.monotonic() - self._last_packet > SILENCE_S:
                    raise CardError(f"the card at {self.link.port} fell silent: switch it off and on, then start again")
                yield None
                continue
            packet, arrival_s = self._frames.popleft()
            self._before_fault = max(self._before_fault - 1, 0)
            try:
                frame = decode_frame(packet.payload)
            except DamagedFrameError:
                self.damaged_frames += 1
                continue
            self._note_time(frame, arrival_s)
            if frame.flags["motor_stopped"]:
                with contextlib.suppress(LinkError):
                    self._ask_safety()
            yield frame

    @property
    def waiting(self) -> bool:
        """Further frames have come already."""
        return bool(self._frames)

    def _note_time(self, frame: Frame, arrival_s: float) -> None:
        card_s = frame.header["last_time"] / self.identity.clock_hz
        if card_s < self._card_time_s:
            self.clock.reset()
        self._card_time_s = card_s
        self.clock.add(card_s, arrival_s)
        delay_s = self.clock.delay_s(card_s, arrival_s)
        if delay_s is not None:
            self.delays_s.append(delay_s)

    def _keep_lease(self) -> None:
        """Any intact command renews the lease; the one that asks how laser and motor are. The answer is not waited
        for. The card's clock may run faster than this computer's, as the virtual card's does: either counts.
        """
        silent_s = max(time.monotonic() - self._last_command, self._card_time_s - self._heard_s)
        if silent_s > min(self._lease_s / 5, 1.0):
            # Where the port died, that is told once all that was received has been given out.
            with contextlib.suppress(LinkError):
                self._ask_safety()
                if self._running and time.monotonic() - self._checked_s > CHECK_S:
                    self._checked_s = time.monotonic()
                    self._send(_Command(PacketType.READ, register("run"), _RUN, 0))

    def _ask_safety(self) -> None:
        self._send(_Command(PacketType.READ, register("safety"), _SAFETY, 0))

    def _send(self, command: _Command) -> int:
        self._last_command, self._heard_s = time.monotonic(), self._card_time_s
        return self.link.send(command.kind, protocol.COMMAND.pack({"address": command.address, "value": command.value}))

    def _receive(self, timeout_s: float) -> dict[str, int] | None:
        """Take the next packet: an answer is returned, a frame kept."""
        packet = self.link.receive(timeout_s)
        if packet is None:
            return None
        self._last_packet = time.monotonic()
        if packet.type == PacketType.FRAME:
            self._frames.append((packet, self.link.arrival_s))
        elif packet.type == PacketType.SNAPSHOT and self.on_snapshot is not None:
            self.on_snapshot(packet)
        elif packet.type == PacketType.ANSWER and len(packet.payload) == protocol.ANSWER.size:
            answer = protocol.ANSWER.unpack(packet.payload)
            self._look_for_fault(answer)
            return answer
        return None

    def _look_for_fault(self, answer: dict[str, int]) -> None:
        fault: CardError | None = None
        if answer["address"] == _SAFETY and (text := Safety.of(answer["value"]).fault(self._armed)):
            fault = CardError(text)
        elif answer["address"] == _RUN and self._running and answer["code"] == AnswerCode.DONE and not answer["value"]:
            fault = CardResetError("the card was reset during the scan: check its power, then start again")
        if fault is not None and self._fault is None:
            self._fault, self._before_fault = fault, len(self._frames)

    def _run(self, commands: Sequence[_Command]) -> list[Mapping[str, int]]:
        """Have commands carried out in order; their answers.

        At most :data:`WINDOW` are under way. One whose answer does not come is sent again, and all after it: writing
        twice does no harm, and so the order stays.
        """
        answers: list[Mapping[str, int]] = []
        attempts = 0
        while len(answers) < len(commands):
            done = len(answers)
            answers += self._attempt(commands[done:])
            if len(answers) > done:
                attempts = 0
                continue
            attempts += 1
            if attempts == ATTEMPTS:
                raise CardError(
                    f"the card at {self.link.port} does not answer ({commands[done].describe()}):"
                    " check port and baud rate, or switch it off and on"
                )
        return answers

    def _attempt(self, commands: Sequence[_Command]) -> list[Mapping[str, int]]:
        """Send commands until an answer fails to come; the answers until then."""
        under_way: deque[tuple[int, _Command, float]] = deque()
        answers: list[Mapping[str, int]] = []
        sent = 0
        deadline = time.monotonic() + self.answer_timeout_s
        while len(answers) < len(commands):
            while sent < len(commands) and len(under_way) < WINDOW:
                under_way.append((self._send(commands[sent]), commands[sent], time.monotonic()))
                sent += 1
            left = deadline - time.monotonic()
            if left <= 0:
                return answers
            answer = self._receive(left)
            if answer is None or answer["to"] not in [sequence for sequence, _, _ in under_way]:
                continue
            if answer["to"] != under_way[0][0]:
                return answers  # one before it was damaged on the way
            _, command, since = under_way.popleft()
            self.round_trips_s.append(self.link.arrival_s - since)
            self._check(command, answer)
            answers.append(answer)
            deadline = time.monotonic() + self.answer_timeout_s
        return answers

    def _check(self, command: _Command, answer: dict[str, int]) -> None:
        if answer["code"] in (AnswerCode.DONE, AnswerCode.PENDING):
            return
        try:
            reason = _REFUSALS[AnswerCode(answer["code"])]
        except ValueError:
            reason = f"answers {answer['code']}, which this host does not know"
        if command.register.name == "laser_arm":
            reason += "; is the interlock closed?"
        raise RefusedError(f"the card refuses {command.describe()}: it {reason}", answer["code"])

    def _greet(self) -> Identity:
        port = self.link.port
        # Ends whatever half a command the card may have received before.
        self.link.send_bytes(b"\0")
        try:
            magic = self.read("magic")
        except CardError:
            heard = self.link.statistics
            if heard.bytes and not heard.packets:
                raise CardError(
                    f"{port} sends data, but no Magtrak packets: it is another device, or has another baud rate"
                ) from None
            raise CardError(f"{port} does not answer as a Magtrak card: check port and baud rate") from None
        if magic != protocol.MAGIC:
            raise CardError(f"{port} is no Magtrak card: it calls itself 0x{magic:08X}, not 0x{protocol.MAGIC:08X}")
        version = self.read("version")
        if version != protocol.VERSION:
            older = "magtrak on this computer" if version > protocol.VERSION else "the card's bitstream"
            raise CardError(
                f"the card at {port} speaks version {version} of the protocol, this host {protocol.VERSION}:"
                f" update {older}"
            )
        map_hash = self.read("map_hash")
        if map_hash != protocol.map_hash():
            raise CardError(
                f"the card at {port} has another register map (0x{map_hash:08X}, not 0x{protocol.map_hash():08X}):"
                " use bitstream and magtrak of the same release"
            )
        names = ("clock_hz", "max_columns", "max_rows", "serial_low", "serial_high", "link_baud")
        clock_hz, columns, rows, low, high, baud = self.read_all(names)
        built = Built(*self.read_all(("features", "background_cells")))
        return Identity(version, map_hash, clock_hz, columns, rows, built, low | high << 32, baud)
