"""The gateware's core, compiled: pins and pixels in, bytes out, by the clock."""

import ctypes
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import verilator

PIN = np.dtype([("clock", "<u8"), ("pin", "<u4"), ("level", "<u4")])
"""A pin takes a level: clock since reset, number of the pin, 0 or 1."""

ENCODER_A, ENCODER_B, INDEX, INTERLOCK = range(4)
"""Numbers of the pins."""


class _Outputs(ctypes.Structure):
    _fields_ = (
        ("clock", ctypes.c_uint64),
        ("drive", ctypes.c_double),
        ("braked", ctypes.c_double),
        ("lit", ctypes.c_double),
        ("laser", ctypes.c_uint8),
        ("lamp", ctypes.c_uint8),
        ("run", ctypes.c_uint8),
    )


@dataclass(frozen=True)
class Outputs:
    """What the card's pins did since the last look.

    Attributes
    ----------
    drive : mean of the signed PWM, -1 to 1
    braked, lit : part of the time that the brake and the laser were on
    laser, lamp, run : levels now
    """

    drive: float
    braked: float
    lit: float
    laser: bool
    lamp: bool
    run: bool


@cache
def library(pattern: tuple[int, int, int] | None = None, board: str = "") -> ctypes.CDLL:
    """The compiled card; the first call on a machine compiles it, which takes a while.

    ``pattern`` and ``board`` as in :func:`sim.verilator.card_verilog`; with a
    pattern it is compiled quickly, and slower.
    """
    harness = Path(__file__).with_name("harness.cpp")
    return load(
        verilator.compile_library(verilator.card_verilog(pattern, board), harness, "" if pattern else "sim.training")
    )


def load(path: Path) -> ctypes.CDLL:
    """A compiled card from its file."""
    loaded = ctypes.CDLL(str(path))
    pointer, u64, size = ctypes.c_void_p, ctypes.c_uint64, ctypes.c_size_t
    loaded.card_new.argtypes = [ctypes.c_uint32, ctypes.c_double, ctypes.c_uint64]
    loaded.card_new.restype = pointer
    loaded.card_delete.argtypes = [pointer]
    loaded.card_pins.argtypes = [pointer, pointer, size]
    loaded.card_row.argtypes = [pointer, u64, pointer, size, ctypes.c_int]
    loaded.card_frame_end.argtypes = [pointer, u64]
    loaded.card_send.argtypes = [pointer, ctypes.c_char_p, size]
    loaded.card_receive.argtypes = [pointer, ctypes.c_char_p, size]
    loaded.card_receive.restype = size
    loaded.card_waiting.argtypes = [pointer]
    loaded.card_waiting.restype = size
    loaded.card_run.argtypes = [pointer, u64, ctypes.POINTER(_Outputs)]
    return loaded


class SimulatedCore:
    """One card, just after reset. Times are clocks since reset.

    Parameters
    ----------
    clock_hz : frequency that the card is told it runs at
    bytes_per_second : speed of the link in each direction; at most a byte a clock
    serial : the card's serial number
    compiled : the card, if not the usual one
    """

    def __init__(
        self, clock_hz: int, bytes_per_second: float, serial: int = 0, compiled: ctypes.CDLL | None = None
    ) -> None:
        self.clock_hz = clock_hz
        self.clock = 0
        self._library = compiled or library()
        self._card = self._library.card_new(clock_hz, min(bytes_per_second / clock_hz, 1.0), serial)
        self._buffer = ctypes.create_string_buffer(1 << 16)

    def close(self) -> None:
        """Free the card; nothing may be called after."""
        if self._card:
            self._library.card_delete(self._card)
            self._card = None

    def pins(self, changes: NDArray[np.void]) -> None:
        """Queue changes of pins, an array of :data:`PIN` in order of time, none before one queued earlier."""
        changes = np.ascontiguousarray(changes, PIN)
        self._library.card_pins(self._card, changes.ctypes.data, len(changes))

    def rows(self, starts: NDArray[np.int64], rgb: NDArray[np.uint8], *, frame_first: bool, end: int | None) -> None:
        """Queue rows of an image.

        Parameters
        ----------
        starts : clock of column 0 of each row, shape (n,)
        rgb : pixels, shape (n, columns, 3); one a clock
        frame_first : the first row given is the image's first
        end : clock at which the image is reported complete, where these are its last rows
        """
        rgb = np.ascontiguousarray(rgb, np.uint8)
        for number, (start, row) in enumerate(zip(starts.tolist(), rgb, strict=True)):
            self._library.card_row(self._card, start, row.ctypes.data, row.shape[0], frame_first and number == 0)
        if end is not None:
            self._library.card_frame_end(self._card, end)

    def send(self, data: bytes) -> None:
        """Queue bytes for the card."""
        self._library.card_send(self._card, data, len(data))

    @property
    def waiting(self) -> int:
        """Bytes that the card has not taken yet."""
        return int(self._library.card_waiting(self._card))

    def run(self, until: int) -> Outputs:
        """Let the card run up to a clock."""
        raw = _Outputs()
        self._library.card_run(self._card, until, ctypes.byref(raw))
        self.clock = raw.clock
        return Outputs(raw.drive, raw.braked, raw.lit, bool(raw.laser), bool(raw.lamp), bool(raw.run))

    def receive(self) -> bytes:
        """Bytes that the card sent. While 4096 of them wait here the card's link stands still."""
        count = self._library.card_receive(self._card, self._buffer, len(self._buffer))
        return self._buffer.raw[:count]
