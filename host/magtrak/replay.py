"""Recordings read again: repaired where they were cut short, and made into a cloud, the same bit by bit."""

import json
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .calibration import Calibration
from .clock import CardClock
from .errors import CalibrationError, MagtrakError
from .frames import DamagedFrameError, Frame, decode_frame
from .protocol import Packet, PacketType
from .recording import CALIBRATION, CARD, EVENTS, TYPES, WIRE, require_mcap
from .scan import Scan
from .stream import PacketStream, Statistics

_MAGIC = b"\x89MCAP0\r\n"


class RecordingError(MagtrakError):
    """A recording that cannot be used."""


@dataclass
class Session:
    """From the opening of a link to the next.

    Attributes
    ----------
    generation : of the settings that its frames have; None where it was never started
    away_s : from the last frame before it to its first
    """

    generation: int | None = None
    away_s: float = 0.0


@dataclass
class Recording:
    """What a recording holds besides the bytes of the wire.

    Attributes
    ----------
    path : the file
    attachments : texts by name
    card : what was written of card and options
    sessions : each opening of a link
    clock_hz : the card's clock; 0 where no link was ever started
    frames : how many frames the receiver used; None where it was killed before it could say so
    cut : bytes at the end that belonged to no whole record, where the recording was cut short; else None
    damaged : chunks and messages in the middle that cannot be read
    """

    path: Path
    attachments: dict[str, str] = field(default_factory=dict)
    card: dict[str, str] = field(default_factory=dict)
    sessions: list[Session] = field(default_factory=list)
    clock_hz: int = 0
    frames: int | None = None
    cut: int | None = None
    damaged: int = 0

    @property
    def calibration(self) -> Calibration:
        """The one that was used."""
        where = f"the calibration in {self.path}"
        try:
            values = json.loads(self.attachments[CALIBRATION])
        except (json.JSONDecodeError, RecursionError) as error:
            raise CalibrationError(f"{where} is no JSON: {error}") from None
        return Calibration.parse(values, where)

    def messages(self) -> Iterator[tuple[str, int, Any]]:
        """Topic, time (ns since 1970) and content: bytes of the wire, and events as parsed."""
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_HUMBLE)
        topics: dict[int, str] = {}
        for record in self.records():
            kind = type(record).__name__
            if kind == "Channel":
                topics[record.id] = record.topic
            elif kind == "Message" and topics.get(record.channel_id) in (WIRE, EVENTS):
                topic = topics[record.channel_id]
                try:
                    message: Any = store.deserialize_cdr(record.data, TYPES[topic])
                    content = message.data.tobytes() if topic == WIRE else dict(json.loads(message.data))
                except Exception:  # whatever a library makes of bytes that another program wrote
                    self.damaged += 1
                    continue
                yield topic, record.log_time, content

    def records(self) -> Iterator[Any]:
        """Everything in the file, in order, up to damage of its structure; damaged chunks are left out and counted."""
        import zstandard
        from mcap.exceptions import McapError
        from mcap.stream_reader import StreamReader, breakup_chunk

        # What damage does to lengths, texts and compressed data.
        errors = (
            McapError,
            struct.error,
            EOFError,
            ValueError,
            KeyError,
            MemoryError,
            OverflowError,
            zstandard.ZstdError,
        )
        self.damaged = 0
        with self.path.open("rb") as file:
            records = iter(StreamReader(file, emit_chunks=True).records)
            while True:
                try:
                    record = next(records, None)
                except errors:
                    return
                if record is None:
                    return
                if type(record).__name__ != "Chunk":
                    yield record
                    continue
                try:
                    inside = breakup_chunk(record, validate_crc=True)
                except errors:
                    self.damaged += 1
                    continue
                yield from inside


def open_recording(path: Path) -> Recording:
    """Look what is in a recording; one that was cut short is repaired in its place, and loses nothing whole.

    Raises
    ------
    RecordingError
        It is none, or not one of this program, or cannot be repaired.
    """
    require_mcap()
    recording = Recording(path)
    try:
        if not _is_whole(path):
            recording.cut = _repair(recording)
    except FileNotFoundError:
        raise RecordingError(f"recording {path} does not exist: check the path") from None
    except OSError as error:
        raise RecordingError(f"recording {path} cannot be read or repaired: {error.strerror}") from None
    for record in recording.records():
        kind = type(record).__name__
        if kind == "Attachment":
            recording.attachments[record.name] = record.data.decode("utf-8", "replace")
        elif kind == "Metadata" and record.name == CARD:
            recording.card |= record.metadata
    if CALIBRATION not in recording.attachments or not recording.card:
        raise RecordingError(f"{path} is no recording of magtrak, or was cut short before its first frame")
    for topic, _, content in recording.messages():
        if topic == EVENTS:
            _note(recording, content)
    return recording


@dataclass(frozen=True)
class RecordedFrame:
    """A frame of a recording.

    Attributes
    ----------
    frame : the frame
    arrival_s : when it came, s since 1970
    away_s : how long the card had been away before it; 0 for all but the first of a later session
    """

    frame: Frame
    arrival_s: float
    away_s: float


class Replay:
    """Takes the frames of a recording as the receiver did: the same frames give the same points.

    Attributes
    ----------
    link : what the wire had in losses, from each start of the card on
    damaged_frames : frames intact on the wire whose content cannot be
    time_zero : the moment of the scan's time 0, as in :meth:`magtrak.clock.Mapping.text`; None without frames
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.link = Statistics()
        self.damaged_frames = 0
        self.time_zero: str | None = None

    def run(self, scan: Scan) -> None:
        """Push all frames into ``scan``, which has the recording's clock, and finish it."""
        clock, zero_s = CardClock(epoch_s=0.0), 0.0
        for recorded in self.frames():
            if scan.counts.frames == self.recording.frames:
                continue  # the wire is read to its end, for its losses
            if recorded.away_s:
                scan.restart(recorded.away_s)
            first = scan.counts.frames == 0
            scan.push(recorded.frame, more=True)
            if not scan.counts.restarts:  # time 0 is in the first session
                header = recorded.frame.header
                zero_s = header["first_time"] / scan.clock_hz if first else zero_s
                clock.add(header["last_time"] / scan.clock_hz, recorded.arrival_s)
        scan.finish()
        if clock.mapping is not None:
            self.time_zero = clock.mapping.text(zero_s)

    def frames(self) -> Iterator[RecordedFrame]:
        """The frames that the receiver took, and those that came after its last.

        As in the receiver, the first frame of a session has the generation that it was started with.
        """
        sessions = iter(self.recording.sessions)
        session, stream, begun, before = Session(), PacketStream(), False, Statistics()
        for topic, time_ns, content in self.recording.messages():
            if topic == EVENTS and content.get("event") == "open":
                self.link += stream.statistics() - before
                session, stream, begun, before = next(sessions), PacketStream(), False, Statistics()
            elif topic == EVENTS and content.get("event") == "start":
                before = stream.statistics()
            if topic != WIRE:
                continue
            for packet in stream.feed(content):
                frame = self._decode(packet)
                if frame is not None and (begun or frame.header["generation"] == session.generation):
                    yield RecordedFrame(frame, time_ns * 1e-9, 0.0 if begun else session.away_s)
                    begun = True
        self.link += stream.statistics() - before

    def _decode(self, packet: Packet) -> Frame | None:
        if packet.type != PacketType.FRAME:
            return None
        try:
            return decode_frame(packet.payload)
        except DamagedFrameError:
            self.damaged_frames += 1
            return None


def _note(recording: Recording, event: Any) -> None:
    match event:
        case {"event": "open"}:
            recording.sessions.append(Session())
        case {"event": "start", "generation": int(generation), "clock_hz": int(clock_hz)} if recording.sessions:
            recording.sessions[-1].generation = generation
            recording.clock_hz = clock_hz
        case {"event": "resume", "away_s": float(away_s)} if recording.sessions:
            recording.sessions[-1].away_s = away_s
        case {"event": "end", "frames": int(count)}:
            recording.frames = count


def _is_whole(path: Path) -> bool:
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise RecordingError(f"{path} is no MCAP recording")
        file.seek(-len(_MAGIC), os.SEEK_END)
        return file.tell() > 0 and file.read() == _MAGIC


def _repair(recording: Recording) -> int:
    """Write the file anew with everything that is whole; returns the bytes given up."""
    from mcap.writer import Writer

    path = recording.path
    partial = path.with_name(path.name + ".part")
    with partial.open("wb") as file:
        writer = Writer(file)
        schemas: dict[int, int] = {0: 0}
        channels: dict[int, int] = {}
        started = False
        for record in recording.records():
            match type(record).__name__:
                case "Header":
                    writer.start(record.profile, record.library)
                    started = True
                case "Schema" if record.id not in schemas:
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                case "Channel" if record.id not in channels:
                    schema = schemas.get(record.schema_id, 0)
                    channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, schema, record.metadata
                    )
                case "Message" if record.channel_id in channels:
                    channel = channels[record.channel_id]
                    writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
                case "Attachment":
                    kind = record.media_type
                    writer.add_attachment(record.create_time, record.log_time, record.name, kind, record.data)
                case "Metadata":
                    writer.add_metadata(record.name, record.metadata)
        if started:
            writer.finish()
        file.flush()
        os.fsync(file.fileno())
    if not started:
        partial.unlink()
        raise RecordingError(f"{path} was cut short before anything was recorded")
    cut = path.stat().st_size - _whole_bytes(path)
    partial.replace(path)
    return cut


def _whole_bytes(path: Path) -> int:
    """Length of the part of a file that consists of whole records: each is opcode, length (8 bytes) and content."""
    size = path.stat().st_size
    at = len(_MAGIC)
    with path.open("rb") as file:
        while True:
            file.seek(at)
            head = file.read(9)
            end = at + 9 + int.from_bytes(head[1:], "little")
            if len(head) < 9 or end > size:
                return at
            at = end
