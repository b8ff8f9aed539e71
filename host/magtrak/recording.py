"""Recordings: the bytes of the wire as they came, and beside them what people want to look at in a viewer.

An MCAP file of profile ``ros2`` (https://mcap.dev/spec), which Foxglove, Lichtblick, rerun and PlotJuggler open:

=========== =============================== =================================================================
topic       type                            content
=========== =============================== =================================================================
/wire       std_msgs/UInt8MultiArray        bytes from the card; the log time is their arrival
/events     std_msgs/String                 JSON: ``open`` a link, ``start`` of a generation, ``end``
/profile    sensor_msgs/PointCloud2         a frame: x column, y row (px), peak, width (px), flags
/status     diagnostic_msgs/DiagnosticArray twice a second: counts, losses, delay
=========== =============================== =================================================================

Calibration and settings are attachments, the card's identity is metadata. The wire is the truth: :mod:`magtrak.replay`
makes the cloud again from it alone. Chunks are closed and written twice a second, so that a killed program loses half a
second at most.
"""

import json
import os
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from . import __version__
from .errors import MagtrakError, OutputError
from .frames import Frame
from .reader import Chunk

FLUSH_S = 0.5
CALIBRATION, SETTINGS, CARD = "calibration.json", "settings.toml", "magtrak"
"""Names of the attachments and of the metadata."""

WIRE, EVENTS, PROFILE, STATUS = "/wire", "/events", "/profile", "/status"

TYPES = {
    WIRE: "std_msgs/msg/UInt8MultiArray",
    EVENTS: "std_msgs/msg/String",
    PROFILE: "sensor_msgs/msg/PointCloud2",
    STATUS: "diagnostic_msgs/msg/DiagnosticArray",
}

_ROW = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("peak", "<f4"), ("width", "<f4"), ("flags", "<u4")])
_FLAGS = ("valid", "ambiguous", "saturated", "cut", "overflow")  # from bit 0 on
_FIELD_TYPES = {"<f4": 7, "<u4": 6}  # sensor_msgs/PointField


def require_mcap() -> None:
    """:exc:`MagtrakError` where the extra for recordings is not installed."""
    if any(find_spec(name) is None for name in ("mcap", "rosbags")):
        raise MagtrakError("recordings need more packages: pip install 'magtrak[record]'")


class Recorder:
    """Writes a recording.

    Parameters
    ----------
    path : the file; one of that name is replaced
    calibration, settings : texts, attached as they are
    options : what a replay needs besides, as text

    Attributes
    ----------
    bytes : of the wire so far

    Raises
    ------
    OutputError
        The file cannot be written; also from every method.
    """

    def __init__(self, path: Path, calibration: str, settings: str, options: Mapping[str, str]) -> None:
        require_mcap()
        from mcap.writer import Writer
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        self.bytes = 0
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        # Arrivals are of the monotonic clock; recordings have the calendar's.
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._sequence = dict.fromkeys(TYPES, 0)
        self._flushed = time.monotonic()
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise OutputError(f"recording {path} cannot be written: {error.strerror}") from None
        self._writer = Writer(self._file)
        with _Guard(path):
            self._writer.start(profile="ros2", library=f"magtrak {__version__}")
            now = time.time_ns()
            for name, kind, text in (
                (CALIBRATION, "application/json", calibration),
                (SETTINGS, "application/toml", settings),
            ):
                self._writer.add_attachment(now, now, name, kind, text.encode())
            self._writer.add_metadata(CARD, {"version": __version__, **options})
            self._channels = {topic: self._register(topic, kind) for topic, kind in TYPES.items()}
            self._writer.flush()

    def wire(self, chunk: Chunk) -> None:
        """Bytes from the card."""
        types = self._store.types
        layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
        data = np.frombuffer(chunk.data, np.uint8)
        self.bytes += len(data)
        self._add(WIRE, types[TYPES[WIRE]](layout, data), chunk.arrival_s)

    def event(self, kind: str, **values: Any) -> None:
        """Something that the host did."""
        text = json.dumps({"event": kind, **values})
        self._add(EVENTS, self._store.types[TYPES[EVENTS]](text), time.monotonic())

    def profile(self, frame: Frame) -> None:
        """A frame, for viewers."""
        rows = frame.rows
        table = np.zeros(len(rows.row), _ROW)
        table["x"], table["y"] = rows.column_px, rows.row
        table["peak"], table["width"] = rows.peak, rows.width_px
        for bit, name in enumerate(_FLAGS):
            table["flags"] |= getattr(rows, name).astype(np.uint32) << bit
        types = self._store.types
        field = types["sensor_msgs/msg/PointField"]
        fields = [field(name, _ROW.fields[name][1], _FIELD_TYPES[_ROW[name].str], 1) for name in _ROW.names or ()]  # type: ignore[index]
        size = _ROW.itemsize
        data = table.view(np.uint8).reshape(-1)
        now = time.monotonic()
        header = self._header(now, "picture")
        cloud = types[TYPES[PROFILE]](header, 1, len(table), fields, False, size, size * len(table), data, True)
        self._add(PROFILE, cloud, now)

    def flush(self, status: Callable[[], tuple[str, dict[str, str], bool]] | None = None) -> None:
        """Where half a second is over, write what waits, with a status of sentence, values, and whether it warns."""
        now = time.monotonic()
        if now - self._flushed < FLUSH_S:
            return
        self._flushed = now
        if status is not None:
            self._status(*status())
        with _Guard(self.path):
            self._writer.flush()

    def close(self) -> None:
        """Complete the file."""
        with _Guard(self.path), self._file:
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())

    def discard(self) -> None:
        """Remove the file: nothing was measured."""
        self._file.close()
        self.path.unlink(missing_ok=True)

    def _status(self, message: str, values: Mapping[str, str], warn: bool) -> None:
        types = self._store.types
        pairs = [types["diagnostic_msgs/msg/KeyValue"](name, value) for name, value in values.items()]
        now = time.monotonic()
        one = types["diagnostic_msgs/msg/DiagnosticStatus"](int(warn), "magtrak", message, "card", pairs)
        self._add(STATUS, types[TYPES[STATUS]](self._header(now, ""), [one]), now)

    def _register(self, topic: str, kind: str) -> int:
        text, _ = self._store.generate_msgdef(kind)
        schema = self._writer.register_schema(kind, "ros2msg", text.encode())
        return int(self._writer.register_channel(topic, "cdr", schema))

    def _header(self, at_s: float, frame: str) -> Any:
        seconds, rest = divmod(self._epoch_ns + round(at_s * 1e9), 10**9)
        types = self._store.types
        return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](seconds, rest), frame)

    def _add(self, topic: str, message: Any, at_s: float) -> None:
        data = bytes(self._store.serialize_cdr(message, TYPES[topic]))
        at_ns = self._epoch_ns + round(at_s * 1e9)
        self._sequence[topic] += 1
        with _Guard(self.path):
            self._writer.add_message(self._channels[topic], at_ns, data, at_ns, self._sequence[topic])


class _Guard:
    """A full disk is told in one sentence."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if isinstance(error, OSError):
            raise OutputError(f"recording {self._path} cannot be written: {error.strerror}") from None
