"""Cameras at the pins of their buses, modelled after their data sheets as far as they are known: the sheets were not at
hand, and what is assumed wrongly in a register table may be assumed here, too.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DvpTiming:
    """Vertical and horizontal timing of a DVP camera; lines and pixels, a pixel being two PCLK.

    The defaults are those of the OV7670's data sheet for VGA, figure "VGA frame timing": 784 pixels a line, VSYNC for
    3 lines, 17 more before the first row, 10 after the last.
    """

    blanking: int = 144
    sync_lines: int = 3
    lines_before: int = 17
    lines_after: int = 10


TIGHT = DvpTiming(blanking=20, sync_lines=1, lines_before=1, lines_after=1)
"""Short, for simulations."""


def rgb565_bytes(image: np.ndarray, *, high_byte_first: bool = True) -> np.ndarray:
    """(rows, columns, 3) uint8 to (rows, 2 * columns) bytes: R7..R3 G7..G5, then G4..G2 B7..B3."""
    r, g, b = (image[..., channel].astype(int) for channel in range(3))
    first, second = (r & 0xF8) | g >> 5, (g << 3 & 0xE0) | b >> 3
    pair = (first, second) if high_byte_first else (second, first)
    return np.stack(pair, axis=-1).reshape(image.shape[0], -1)


def dvp_frame(data: np.ndarray | list, timing: DvpTiming = TIGHT) -> Iterator[tuple[int, int, int]]:
    """HREF, VSYNC and D for each PCLK of a frame, from the vertical sync on; rows may differ in length."""
    line = 2 * timing.blanking + len(data[0])
    yield from ((0, 1, 0) for _ in range(timing.sync_lines * line))
    yield from ((0, 0, 0) for _ in range(timing.lines_before * line))
    for row in data:
        yield from ((1, 0, int(byte)) for byte in row)
        yield from ((0, 0, 0) for _ in range(2 * timing.blanking))
    yield from ((0, 0, 0) for _ in range(timing.lines_after * line))


@dataclass(frozen=True)
class RgbTiming:
    """Timing of parallel video in the order of CEA-861: front porch, sync, back porch; pixels, and lines.

    ``half_line``: the vertical sync begins in the middle of a line, as that of every second field does.
    """

    front: int = 8
    sync: int = 8
    back: int = 8
    lines_front: int = 1
    lines_sync: int = 2
    lines_back: int = 2
    half_line: bool = False


def rgb_frame(image: np.ndarray, timing: RgbTiming = RgbTiming()) -> Iterator[tuple[int, int, int, tuple]]:
    """HS, VS, DE and (r, g, b) for each clock of a frame, from the begin of a vertical sync's line on, active high.

    A line begins with its horizontal sync. VS comes and goes with HS, or half a line later.
    """
    rows, columns = image.shape[:2]
    line = columns + timing.front + timing.sync + timing.back
    late = line // 2 if timing.half_line else 0
    first_row = timing.lines_sync + timing.lines_back
    for number in range(first_row + rows + timing.lines_front):
        for clock in range(line):
            at = number * line + clock
            vs = late <= at < late + timing.lines_sync * line
            column = clock - timing.sync - timing.back
            de = 0 <= number - first_row < rows and 0 <= column < columns
            pixel = tuple(map(int, image[number - first_row, column])) if de else (0, 0, 0)
            yield int(clock < timing.sync), int(vs), int(de), pixel


class SccbCamera:
    """A camera's end of the two-wire bus, level by level, as the SCCB specification has it.

    A write's first byte after the device selects the register; one more is data. A read gives the selected register's
    data. Registers of a bank are kept apart, where there are banks.

    Parameters
    ----------
    device, address_bytes : as the camera has them
    registers : what stands in it after reset
    reset : address and bit whose setting resets all registers
    bank : address of the register that selects the bank; None: there are none
    acknowledges : the ninth bit; False: it is left high, "don't care"
    deaf : numbers of bytes, counted from 0 over all transmissions, that it does not acknowledge and ignores
    stuck : registers that keep their value whatever is written

    Attributes
    ----------
    registers : by (bank, address)
    written : (bank, address, data) in order
    faults : what no master may do, in words
    """

    def __init__(
        self,
        device: int,
        address_bytes: int,
        registers: dict[int | tuple[int, int], int],
        reset: tuple[int, int],
        *,
        bank: int | None = None,
        acknowledges: bool = True,
        deaf: frozenset[int] | set[int] | range = frozenset(),
        stuck: frozenset[int] | set[int] = frozenset(),
    ) -> None:
        self.device = device
        self.address_bytes = address_bytes
        self._initial = {(key if isinstance(key, tuple) else (0, key)): value for key, value in registers.items()}
        self.registers = dict(self._initial)
        self.reset = reset
        self.bank_at = bank
        self.bank = 0
        self.acknowledges = acknowledges
        self.deaf = deaf
        self.stuck = stuck
        self.written: list[tuple[int, int, int]] = []
        self.faults: list[str] = []
        self.bytes = 0
        self._scl = self._sda = 1
        self._pull = False
        self._listening = False
        self._bits: list[int] = []
        self._received: list[int] = []
        self._address = 0
        self._reading = False
        self._out = 0

    def step(self, scl: int, master_sda: int) -> bool:
        """One look at the lines; whether the camera pulls the data line low."""
        sda = master_sda & (not self._pull)
        if scl and self._scl and sda != self._sda:
            # The clock has risen for a start's or stop's own sake: that one bit is none.
            if self._listening and len(self._bits) > 1:
                self.faults.append("data changed while the clock was high")
            self._bits = []
            self._pull = False
            self._listening = not sda
            self._received = []
            self._reading = False
        elif self._listening and scl and not self._scl:
            self._bits.append(sda)
        elif self._listening and not scl and self._scl:
            self._falls()
        self._scl, self._sda = scl, master_sda & (not self._pull)
        return self._pull

    def _falls(self) -> None:
        self._pull = False
        if len(self._bits) == 8 and not (self._reading and self._received):
            # The ninth bit: the camera's own.
            self._pull = self._take(sum(bit << 7 - n for n, bit in enumerate(self._bits)))
        elif len(self._bits) == 9:
            if self._reading and len(self._received) > 1:
                if not self._bits[8]:
                    self.faults.append("the master wants more than one byte")
                self._listening = False  # its turn is over
                return
            self._bits = []
        if self._reading and self._received and len(self._bits) < 8:
            if not self._bits and len(self._received) == 1:
                self._received.append(self._out)
            self._pull = not self._out >> 7 - len(self._bits) & 1

    def _take(self, byte: int) -> bool:
        """A whole byte came; whether to acknowledge it."""
        number, self.bytes = self.bytes, self.bytes + 1
        if number in self.deaf:
            self._listening = False
            return False
        if not self._received:
            if byte >> 1 != self.device:
                self._listening = False
                return False
            self._reading = bool(byte & 1)
            self._out = self.registers.get((self.bank, self._address), 0)
        self._received.append(byte)
        if self._reading:
            return self.acknowledges
        if len(self._received) == 1 + self.address_bytes:
            self._address = int.from_bytes(bytes(self._received[1:]), "big")
        elif len(self._received) == 2 + self.address_bytes:
            self._write(byte)
        return self.acknowledges

    def _write(self, data: int) -> None:
        self.written.append((self.bank, self._address, data))
        if self._address == self.bank_at:
            self.bank = data & 1
        if self._address == self.reset[0] and data & self.reset[1]:
            self.registers = dict(self._initial)
        elif self._address not in self.stuck:
            self.registers[self.bank, self._address] = data
            if self._address == self.bank_at:
                self.registers[0, self._address] = self.registers[1, self._address] = data


def ov7670(**options) -> SccbCamera:
    return SccbCamera(0x21, 1, {0x0A: 0x76, 0x0B: 0x73, 0x13: 0x8F, 0x12: 0}, (0x12, 0x80), **options)


def ov2640(**options) -> SccbCamera:
    return SccbCamera(0x30, 1, {(1, 0x0A): 0x26, (1, 0x0B): 0x42}, (0x12, 0x80), bank=0xFF, **options)


def ov5640(**options) -> SccbCamera:
    return SccbCamera(0x3C, 2, {0x300A: 0x56, 0x300B: 0x40, 0x3008: 0x02}, (0x3008, 0x80), **options)
