"""Frames of one card for a scan: from opening the port to its last frame, over as many links as it takes."""

import contextlib
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from types import FrameType

from .card import Card
from .discover import wait_for
from .errors import CardResetError, EndOfStreamError, LinkError, MagtrakError
from .frames import Frame
from .link import Link
from .recording import Recorder
from .scan import Scan
from .settings import Settings
from .stream import Statistics
from .summary import Rates, median, progress, summary

RETRY_S = 0.2


@dataclass(frozen=True)
class Limits:
    """When to end: after so many frames, so many seconds, whichever comes first; None for never."""

    frames: int | None = None
    seconds: float | None = None


class Interrupt:
    """While entered, Ctrl-C and a request to end are noted, not raised: the cloud is written all the same."""

    def __init__(self) -> None:
        self.asked = False

    def __enter__(self) -> "Interrupt":
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self.asked = True


class Receiver:
    """Links to one card, one after the other where it goes away and comes back, and the frames of a scan from them.

    Parameters
    ----------
    settings : what the card is told, again whenever it comes back
    limits : when to end
    baud : baud rate
    reconnect_s : how long to wait for a card that went away; 0: not at all

    Attributes
    ----------
    link, card : the last ones
    time_comments : when the scan's time 0 was, known once closed
    """

    def __init__(self, settings: Settings, limits: Limits, baud: int, reconnect_s: float) -> None:
        self._settings = settings
        self._limits = limits
        self._baud = baud
        self._reconnect_s = reconnect_s
        self._recorder: Recorder | None = None
        self._before = Statistics()
        self._damaged_frames_before = 0
        self._begun_s = self._start_s = self._last_s = time.monotonic()
        self._first_s: float | None = None  # card time of the scan's first row
        self.time_comments: list[str] = []
        self._open = False

    def connect(self, port: str, recorder: Callable[[], Recorder | None]) -> None:
        """Open the port, then the recording, then greet the card."""
        self.link = Link(port, self._baud)
        try:
            self._recorder = recorder()
            if self._recorder is not None:
                self._recorder.event("open", port=port)
                self.link.tap = self._recorder.wire
            self.card = Card(self.link)
        except BaseException:
            self.link.close()
            raise
        self._open = True

    def discard(self) -> None:
        """No card was found: leave no recording."""
        if self._recorder is not None:
            self._recorder.discard()

    def run(self, scan: Scan, interrupt: Interrupt) -> MagtrakError | None:
        """Take frames until the end; gives what went wrong."""
        self._begun_s = time.monotonic()
        while True:
            failure: MagtrakError | None = None
            try:
                self._take_frames(scan, interrupt)
            except EndOfStreamError:
                pass
            except MagtrakError as error:
                failure = error
            away = failure is None or isinstance(failure, LinkError | CardResetError)
            done = interrupt.asked or self._finished(scan)
            if done or not away or not self._reconnect(interrupt):
                break
        with contextlib.suppress(MagtrakError):
            self.card.stop()
        self.close()
        scan.finish()
        try:
            if self._recorder is not None:
                self._recorder.event("end", frames=scan.counts.frames)
                self._recorder.close()
        except MagtrakError as error:  # a full disk, which most likely was the failure before
            failure = failure or error
        return failure

    def close(self) -> None:
        """Close the link and keep what it counted; more than once does no harm."""
        if not self._open:
            return
        self._open = False
        mapping = self.card.clock.mapping
        if not self.time_comments and mapping is not None and self._first_s is not None:
            self.time_comments = [f"time 0 is {mapping.text(self._first_s)}"]
            if mapping.drift:
                self.time_comments.append(f"clock of the computer against the card's {1e6 * mapping.drift:+.1f} ppm")
        self._before += self.link.statistics
        self._damaged_frames_before += self.card.damaged_frames
        self.link.close()

    def summary(self, scan: Scan) -> str:
        """The last line for the user."""
        seconds = max(self._last_s - self._start_s, 1e-3)
        return summary(scan.counts, self._before, self._damaged_frames_before, self.card, seconds)

    def _take_frames(self, scan: Scan, interrupt: Interrupt) -> None:
        generation = self.card.apply(self._settings)
        if self._recorder is not None:
            identity = self.card.identity
            self._recorder.event(
                "start", generation=generation, clock_hz=identity.clock_hz, serial=identity.serial_text
            )
        self.card.start(self._settings)
        begun = False
        rates = Rates(time.monotonic())

        def line(seconds: float) -> str:
            counts, link = scan.counts, self.link.statistics
            frame_rate, byte_rate = rates.update(time.monotonic(), counts.frames, link.bytes)
            return (
                f"{seconds:6.1f} s  {counts.frames} frames  {counts.points} points  {counts.lost_frames} lost"
                f"  {link.damaged} damaged  {frame_rate:.0f} frames/s  {byte_rate / 1e3:.0f} kB/s"
            )

        with progress(line) as show:
            for frame in self.card.frames():
                # Frames of a run before, measured with other settings, may still be under way.
                if frame is not None and (begun or frame.header["generation"] == generation):
                    if not begun:
                        self._begin(scan, frame)
                        begun = True
                    scan.push(frame, more=self.card.waiting)
                    self._last_s = time.monotonic()
                    if self._recorder is not None:
                        self._recorder.profile(frame)
                if self._recorder is not None:
                    self._recorder.flush(lambda: self._status(scan))
                show()
                if interrupt.asked or self._finished(scan):
                    return

    def _begin(self, scan: Scan, frame: Frame) -> None:
        """The first frame of a link."""
        now = time.monotonic()
        if self._first_s is None:
            self._start_s = now
            self._first_s = frame.header["first_time"] / scan.clock_hz
            return
        away_s = now - self._last_s
        scan.restart(away_s)
        if self._recorder is not None:
            self._recorder.event("resume", away_s=away_s)

    def _finished(self, scan: Scan) -> bool:
        limits = self._limits
        late = limits.seconds is not None and time.monotonic() - self._begun_s >= limits.seconds
        return late or scan.counts.frames == limits.frames

    def _reconnect(self, interrupt: Interrupt) -> bool:
        """Whether the card came back in time."""
        if not self._reconnect_s:
            return False
        port, serial = self.link.port, self.card.identity.serial
        self.close()
        print(f"magtrak-recv: {port} went away; waiting {self._reconnect_s:g} s for it", file=sys.stderr)
        deadline = time.monotonic() + self._reconnect_s
        while time.monotonic() < deadline and not interrupt.asked:
            found = wait_for(port, serial, 0.0, self._baud)
            if found is not None:
                with contextlib.suppress(MagtrakError):  # gone again
                    self.connect(found, lambda: self._recorder)
                    return True
            time.sleep(RETRY_S)
        return False

    def _status(self, scan: Scan) -> tuple[str, dict[str, str], bool]:
        """Sentence, values, and whether it is a warning, for the recording."""
        link = self.link.statistics
        values = {**asdict(scan.counts), **{f"link {name}": value for name, value in asdict(link).items()}}
        values["delay (median, ms)"] = round(1e3 * median(self.card.delays_s), 3)
        bad = link.damaged or link.lost or scan.counts.lost_frames
        return "losses" if bad else "no losses", {name: str(value) for name, value in values.items()}, bool(bad)
