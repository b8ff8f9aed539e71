"""The virtual card: the compiled core, a world around it, and a serial port.

The world (a scene or a folder of pictures) says what the motor does and what the camera sees;
the core alone turns that into bytes. Time advances in slices of about half a millisecond: the
motor moves by the PWM of the slice before, its encoder's edges and the rows of the slice are queued,
and the core runs through the slice.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .core import PIN, Outputs, SimulatedCore
from .errors import SimError
from .terminal import Terminal

SLICE_S = 0.5e-3
BLANKING_CLOCKS = 32  # between two rows; the contract asks for 16
MIN_CLOCK_HZ = 6_000_000
MAX_CLOCK_HZ = 400_000_000
BYTES_PER_SECOND = 1_200_000  # a UART at 12 Mbaud
PATIENCE_S = 30.0

_EVENTS = np.dtype([("time_s", "<f8"), ("pin", "<u4"), ("level", "<u4")])


class World(Protocol):
    """What surrounds the card. Times are seconds of card time."""

    width: int
    height: int
    frames: int

    def prepare(self, now_s: float) -> float:
        """Called when the host first wants images; gives the time of row 0 of picture 0."""

    def advance(self, until_s: float, drive: float) -> NDArray[np.void]:
        """Let the motor go on with the mean PWM ``drive`` (-1 to 1).

        Gives the changes of the pins on the way, in order, with fields ``time_s``, ``pin`` and ``level``.
        """

    def rows(self, frame: int, first: int, times_s: NDArray[np.float64], *, lit: bool) -> NDArray[np.uint8]:
        """Rows ``first`` and following of a picture, which arrive at ``times_s``; the motor has been there."""


@dataclass(frozen=True)
class Timing:
    """When rows come.

    Parameters
    ----------
    width, height : size of the pictures, px
    frame_rate_hz : pictures per second
    row_time_s : from row to row; by default the rows fill 80 % of the period
    """

    width: int
    height: int
    frame_rate_hz: float = 50.0
    row_time_s: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.frame_rate_hz <= 100_000:
            raise SimError(f"--frame-rate {self.frame_rate_hz:g} is not possible: give pictures per second.")
        if self.row_time_s is not None and not self.row_time_s > 0:
            raise SimError(f"--row-time {self.row_time_s * 1e6:g} is not possible: give microseconds above 0.")
        period = 1 / self.frame_rate_hz
        if self.row_s * self.height > period * (1 + 1e-9):
            raise SimError(
                f"{self.height} rows of {self.row_s * 1e6:g} us take {self.row_s * self.height * 1e3:g} ms, longer than"
                f" a picture at {self.frame_rate_hz:g} Hz: lower --row-time or --frame-rate."
            )
        if self.clock_hz > MAX_CLOCK_HZ:
            raise SimError(
                f"{self.width} columns in {self.row_s * 1e6:g} us need a clock of {self.clock_hz / 1e6:.0f} MHz;"
                f" {MAX_CLOCK_HZ / 1e6:.0f} are possible: lower --frame-rate or raise --row-time."
            )

    @property
    def row_s(self) -> float:
        return 0.8 / self.frame_rate_hz / self.height if self.row_time_s is None else self.row_time_s

    @property
    def clock_hz(self) -> int:
        """The card's clock: the slowest at which a row and its blanking fit, and the frame gap."""
        gap_s = 1 / self.frame_rate_hz - self.row_s * self.height
        wanted = max((self.width + BLANKING_CLOCKS) / self.row_s, 64 / self.row_s)
        if gap_s < 64 / wanted:  # the rows fill the period: the blank row comes out of the last row's blanking
            wanted = (self.width + 160) / self.row_s
        return max(MIN_CLOCK_HZ, round(wanted))


class VirtualCard:
    """Runs a world through the core and moves bytes between core and terminal.

    Parameters
    ----------
    world : scene or pictures
    timing : when rows come
    terminal : where the host is
    real_time : keep to the wall clock where the machine is fast enough, and drop what the host does
        not read, as hardware does; otherwise run as fast as possible, and let card time stand still while
        the host does not read
    truth : called for every picture with its number and the arrival times of its rows
    """

    def __init__(
        self,
        world: World,
        timing: Timing,
        terminal: Terminal,
        *,
        real_time: bool,
        truth: Callable[[int, NDArray[np.float64]], None] | None = None,
    ) -> None:
        self._world = world
        self._timing = timing
        self._terminal = terminal
        self._real_time = real_time
        self._truth = truth
        self._core = SimulatedCore(timing.clock_hz, BYTES_PER_SECOND)
        self._core.pins(np.array([(0, 3, 1)], PIN))  # the interlock is closed
        self._outputs = Outputs(0, 0, 0, laser=False, lamp=False, run=False)
        self._wall_start = time.monotonic()
        self.pictures = 0

    def close(self) -> None:
        self._core.close()

    def run(self, frames: int | None) -> None:
        """Wait for the host, then show so many pictures (None: without end) and send all their results.

        Raises
        ------
        SimError
            The host stopped reading before it had everything.
        """
        while not self._outputs.run:
            self._slice(self._now_s + SLICE_S)
            if not self._real_time:
                time.sleep(SLICE_S)  # nothing to do but wait: leave the processor to others
        start_s = self._world.prepare(self._now_s)
        while self._now_s < start_s:
            self._slice(min(start_s, self._now_s + SLICE_S))
        while frames is None or self.pictures < frames:
            first_s = start_s + self.pictures / self._timing.frame_rate_hz
            self._picture(self.pictures, first_s)
            self.pictures += 1
        self._finish()

    @property
    def _now_s(self) -> float:
        return self._core.clock / self._core.clock_hz

    def _picture(self, frame: int, first_s: float) -> None:
        timing = self._timing
        times: NDArray[np.float64] = first_s + np.arange(timing.height, dtype=np.float64) * timing.row_s
        if self._truth is not None:
            self._truth(frame, times)
        while self._now_s < first_s:
            self._slice(min(first_s, self._now_s + SLICE_S))
        clocks = np.round(times * self._core.clock_hz).astype(np.int64)
        # Nothing may lie in the past; rounding of the slice's end can put the first row half a clock there.
        clocks = np.maximum(clocks, self._core.clock)
        batch = max(1, round(SLICE_S / timing.row_s))
        for first in range(0, timing.height, batch):
            last = min(first + batch, timing.height)
            until_s = times[last - 1] + timing.row_s
            self._move(until_s)
            rgb = self._world.rows(frame, first, times[first:last], lit=self._outputs.laser)
            end = int(clocks[-1]) + timing.width + 1 if last == timing.height else None
            self._core.rows(clocks[first:last], rgb, frame_first=first == 0, end=end)
            self._advance(until_s)

    def _slice(self, until_s: float) -> None:
        self._move(until_s)
        self._advance(until_s)

    def _move(self, until_s: float) -> None:
        events = self._world.advance(until_s, self._outputs.drive)
        changes = np.empty(len(events), PIN)
        changes["clock"] = np.round(events["time_s"] * self._core.clock_hz)
        changes["pin"] = events["pin"]
        changes["level"] = events["level"]
        self._core.pins(changes)

    def _advance(self, until_s: float) -> None:
        self._core.send(self._terminal.read())
        self._outputs = self._core.run(round(until_s * self._core.clock_hz))
        self._pass_on()
        if self._real_time:
            ahead = self._now_s - (time.monotonic() - self._wall_start)
            if ahead > 0:
                time.sleep(ahead)
            else:
                self._wall_start -= ahead  # the machine is slower than the card: no hurry to catch up

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
            self._core.send(self._terminal.read())
            self._outputs = self._core.run(self._core.clock + self._core.clock_hz // 1000)
            silent = 0 if self._pass_on() else silent + 1
        if not self._terminal.drain(PATIENCE_S):
            raise SimError(f"All pictures were sent, but the host has not read the rest for {PATIENCE_S:.0f} s.")
