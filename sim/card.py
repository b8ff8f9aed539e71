"""The virtual card: the compiled core, a world around it, and a serial port.

The world (a scene or a folder of pictures) says what the motor does and what the camera sees;
the core alone turns that into bytes. Time advances in slices of about half a millisecond: the
motor moves by the PWM of the slice before, its encoder's edges and the rows of the slice are queued,
and the core runs through the slice.
"""

import ctypes
import time
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .core import INTERLOCK, PIN, Outputs, SimulatedCore
from .errors import SimError
from .motor import Drive
from .terminal import Terminal
from .timing import Timing
from .trajectory import Floats

SLICE_S = 0.5e-3
BLANKING_CLOCKS = 32  # between two rows; the contract asks for 16
FRAME_GAP_CLOCKS = 160  # between two images; the contract asks for 64
MIN_CLOCK_HZ = 6_000_000
MAX_CLOCK_HZ = 400_000_000
BYTES_PER_SECOND = 1_200_000  # a UART at 12 Mbaud
ANSWERS_BYTES = 100  # in a millisecond: a host that goes on asking is answered, and no more than that
PATIENCE_S = 30.0
UNHEARD_S = 0.1
"""Card time without a byte from the host after which the card is no faster than the wall clock, whatever the pace:
or the host's lease, which counts card time, would lapse while the host is still busy with what it got."""


class World(Protocol):
    """What surrounds the card. Times are seconds of card time."""

    width: int
    height: int
    frames: int
    timing: Timing
    drive: Drive

    def start(self, at_s: float) -> float:
        """The host wants pictures from ``at_s`` on: gives the time of row 0 of the first one, then or later."""

    def rows(self, frame: int, first: int, times_s: Floats, lit: bool) -> NDArray[np.uint8]:
        """Rows ``first`` and following of a picture, which arrive at ``times_s``, with the laser on or off."""


def clock_hz(width: int, timing: Timing) -> int:
    """The card's clock: the slowest at which the pixels of a row, blanking and the frame gap fit.

    Raises
    ------
    SimError
        That is faster than any card.
    """
    wanted = max(width + BLANKING_CLOCKS, 64) / timing.row_period_s
    gap_s = timing.period_s - timing.row_period_s * timing.height
    if gap_s * wanted < FRAME_GAP_CLOCKS:  # the rows fill the period: the last row's blanking is all there is
        wanted = (width + FRAME_GAP_CLOCKS) / timing.row_period_s
    if wanted > MAX_CLOCK_HZ:
        raise SimError(
            f"{width} columns in {timing.row_period_s * 1e6:g} us need a clock of {wanted / 1e6:.0f} MHz, and"
            f" {MAX_CLOCK_HZ / 1e6:.0f} are possible: lower --frame-rate or raise --row-time."
        )
    return max(MIN_CLOCK_HZ, round(wanted))


class VirtualCard:
    """Runs a world through the core and moves bytes between core and terminal.

    Parameters
    ----------
    world : scene or pictures
    terminal : where the host is
    clock_hz : of the card, see :func:`clock_hz`
    compiled : its gateware
    real_time : keep to the wall clock where the machine is fast enough, and drop what the host does
        not read, as hardware does; otherwise run as fast as possible, and let card time stand still while
        the host does not read
    serial : the card's serial number

    Attributes
    ----------
    pictures : shown so far
    """

    def __init__(
        self,
        world: World,
        terminal: Terminal,
        clock_hz: int,
        compiled: ctypes.CDLL,
        *,
        real_time: bool,
        serial: int = 0,
    ) -> None:
        self._world = world
        self._terminal = terminal
        self._real_time = real_time
        self._core = SimulatedCore(clock_hz, BYTES_PER_SECOND, serial, compiled)
        levels = [(0, signal, level) for signal, level in world.drive.levels().items()]
        self._core.pins(np.array([*levels, (0, INTERLOCK, 1)], PIN))
        self._outputs = Outputs(0, 0, 0, laser=False, lamp=False, run=False)
        self._wall_start = time.monotonic()
        self._heard_s = 0.0
        self._heard_at = time.monotonic()
        self.pictures = 0

    def close(self) -> None:
        self._core.close()

    def run(self, loop: bool = False) -> None:
        """Wait for the host, then show all pictures (again and again if ``loop``) and send all their results.

        Raises
        ------
        SimError
            The host stopped reading before it had everything.
        """
        while not self._outputs.run:
            self._slice(self._now_s + SLICE_S)
            if not self._real_time:
                time.sleep(SLICE_S)  # nothing to do but wait: leave the processor to others
        start_s = self._now_s
        while True:
            start_s = self._world.start(start_s)
            for _ in range(self._world.frames):
                self._picture(self.pictures, start_s)
                self.pictures += 1
                start_s += self._world.timing.period_s
            if not loop:
                break
        self._finish()

    def _clock(self, time_s: float) -> int:
        return round(time_s * self._core.clock_hz)

    @property
    def _now_s(self) -> float:
        return self._core.clock / self._core.clock_hz

    def _picture(self, frame: int, first_s: float) -> None:
        timing = self._world.timing
        times = timing.rows(first_s)
        while self._core.clock < self._clock(first_s):
            self._slice(min(first_s, self._now_s + SLICE_S))
        clocks = np.round(times * self._core.clock_hz).astype(np.int64)
        # Nothing may lie in the past; rounding of the slice's end can put the first row half a clock there.
        clocks = np.maximum(clocks, self._core.clock)
        batch = max(1, round(SLICE_S / timing.row_period_s))
        for first in range(0, timing.height, batch):
            last = min(first + batch, timing.height)
            until_s = float(times[last - 1]) + timing.row_period_s
            self._move(until_s)
            rgb = self._world.rows(frame, first, times[first:last], self._outputs.laser)
            end = int(clocks[-1]) + self._world.width + 1 if last == timing.height else None
            self._core.rows(clocks[first:last], rgb, frame_first=first == 0, end=end)
            self._advance(until_s)

    def _slice(self, until_s: float) -> None:
        self._move(until_s)
        self._advance(until_s)

    def _move(self, until_s: float) -> None:
        events = self._world.drive.advance(until_s, self._outputs.drive)
        changes = [(self._clock(event.time_s), event.signal, event.level) for event in events]
        self._core.pins(np.array(changes, PIN))

    def _advance(self, until_s: float) -> None:
        self._listen()
        self._outputs = self._core.run(self._clock(until_s))
        self._pass_on()
        if self._real_time:
            ahead = self._now_s - (time.monotonic() - self._wall_start)
            if ahead > 0:
                time.sleep(ahead)
            else:
                self._wall_start -= ahead  # the machine is slower than the card: no hurry to catch up

    def _listen(self) -> None:
        """Pass on what the host says; while the laser is armed, wait for it where card time runs ahead."""
        data = self._terminal.read()
        self._core.send(data)
        if data:
            self._heard_s, self._heard_at = self._now_s, time.monotonic()
        elif self._outputs.lamp and not self._real_time:
            ahead = self._now_s - self._heard_s - UNHEARD_S - (time.monotonic() - self._heard_at)
            if ahead > 0:
                time.sleep(ahead)

    def _pass_on(self) -> bytes:
        """Give the host what the card has sent; what it does not read backs up into the card."""
        if not self._terminal.write(b""):
            if self._real_time:
                return b""
            self._wait_for_host()
        data = self._core.receive()
        self._terminal.write(data)
        return data

    def _wait_for_host(self) -> None:
        since = time.monotonic()
        while not self._terminal.write(b""):
            if time.monotonic() - since > PATIENCE_S:
                raise SimError(
                    f"The host has read nothing for {PATIENCE_S:.0f} s: stopped at picture {self.pictures}."
                    " Start magtrak-sim again, or use --pace real, which drops what nobody reads."
                )
            time.sleep(1e-3)

    def _finish(self) -> None:
        """Send what is still in the card, until it has been silent for longer than any packet's start takes."""
        silent = 0
        while silent < 20:
            until_s = self._now_s + 1e-3
            self._move(until_s)
            self._listen()
            self._outputs = self._core.run(self._clock(until_s))
            silent = 0 if len(self._pass_on()) > ANSWERS_BYTES else silent + 1
        if not self._terminal.drain(PATIENCE_S):
            raise SimError(f"All pictures were sent, but the host has not read the rest for {PATIENCE_S:.0f} s.")
