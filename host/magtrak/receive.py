"""One scan, from opening the port to the cloud on disk: what ``magtrak-recv`` does."""

import contextlib
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType

from .calibration import Calibration
from .card import Card
from .cloud.ply import write_ply
from .errors import EndOfStreamError, MagtrakError, OutputError, SettingsError
from .link import Link
from .scan import Scan
from .settings import Settings
from .settings_file import load_settings

PROGRESS_S = 0.2


@dataclass(frozen=True)
class Limits:
    """When to end: after so many frames, so many seconds, whichever comes first; None for never."""

    frames: int | None = None
    seconds: float | None = None


def receive(
    *,
    port: str,
    baud: int,
    calibration: Path,
    settings: str,
    output: Path,
    picture: Path | None = None,
    limits: Limits,
    min_quality: float = 0.0,
    bare: bool = False,
) -> None:
    """Receive a scan, write the cloud, print the summary.

    What can be wrong before the first frame is checked before the laser is armed. Whatever ends the stream, the cloud
    so far is written before an error is raised.

    Raises
    ------
    MagtrakError
        In one sentence.
    """
    loaded = Calibration.load(calibration)
    chosen = _with_counts_per_turn(load_settings(settings), loaded, settings)
    _check_outputs(output, picture)
    interrupt = _Interrupt()
    with Link(port, baud) as link:
        card = Card(link)
        scan = Scan(loaded, card.identity.clock_hz, bare=bare, min_quality=min_quality)
        failure: MagtrakError | None = None
        with interrupt:
            try:
                generation = card.apply(chosen)
                card.start(chosen)
                _take_frames(card, scan, generation, limits, interrupt)
            except EndOfStreamError:
                pass
            except MagtrakError as error:
                failure = error
            with contextlib.suppress(MagtrakError):
                card.stop()
            scan.finish()
            _write(scan, output, picture, calibration, settings)
    print(_summary(scan, card), flush=True)
    if failure is not None:
        raise type(failure)(f"{failure}; the cloud so far is in {output}")
    _warn_if_empty(scan)


class _Interrupt:
    """While entered, Ctrl-C and a request to end are noted, not raised: the cloud is written all the same."""

    def __init__(self) -> None:
        self.asked = False

    def __enter__(self) -> None:
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self.asked = True


def _take_frames(card: Card, scan: Scan, generation: int, limits: Limits, interrupt: _Interrupt) -> None:
    start = time.monotonic()
    with _progress(scan, card) as show:
        for frame in card.frames():
            # Frames of a run before, measured with other settings, may still be under way.
            if frame is not None and (scan.counts.frames or frame.header["generation"] == generation):
                scan.push(frame)
            show()
            if interrupt.asked or scan.counts.frames == limits.frames:
                return
            if limits.seconds is not None and time.monotonic() - start >= limits.seconds:
                return


class _Progress:
    def __init__(self, scan: Scan, card: Card) -> None:
        self._scan, self._card = scan, card
        self._start = self._last = time.monotonic()

    def __call__(self) -> None:
        now = time.monotonic()
        if now - self._last < PROGRESS_S:
            return
        self._last = now
        counts = self._scan.counts
        text = (
            f"{now - self._start:6.1f} s  {counts.frames} frames  {counts.points} points"
            f"  {counts.lost_frames} lost  {self._card.link.statistics.damaged} damaged"
        )
        print(f"\r{text}\x1b[K", end="", file=sys.stderr, flush=True)


@contextlib.contextmanager
def _progress(scan: Scan, card: Card) -> Iterator["_Progress | _Silence"]:
    """A line on a terminal that is written over and over; nothing elsewhere."""
    if not sys.stderr.isatty():
        yield _Silence()
        return
    try:
        yield _Progress(scan, card)
    finally:
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)


class _Silence:
    def __call__(self) -> None:
        """Show nothing."""


def _with_counts_per_turn(settings: Settings, calibration: Calibration, name: str) -> Settings:
    """The card checks every turn against the calibration's counts; settings that say otherwise are a mistake."""
    wanted, given = calibration.laser.counts_per_turn, settings.encoder.counts_per_turn
    if given not in (0, wanted):
        raise SettingsError(f"{name}: encoder.counts_per_turn is {given}, the calibration has {wanted}: correct one")
    return replace(settings, encoder=replace(settings.encoder, counts_per_turn=wanted))


def _check_outputs(output: Path, picture: Path | None) -> None:
    for path in filter(None, (output, picture)):
        if path.is_dir():
            raise OutputError(f"{path} is a folder: name a file in it")
        if not path.absolute().parent.is_dir():
            raise OutputError(f"{path} cannot be written: there is no folder {path.parent}")
        try:
            path.with_name(path.name + ".part").touch()
        except OSError as error:
            raise OutputError(f"{path} cannot be written: {error.strerror}") from None
        path.with_name(path.name + ".part").unlink()
    if picture is not None:
        from .cloud.picture import require_matplotlib

        require_matplotlib()


def _write(scan: Scan, output: Path, picture: Path | None, calibration: Path, settings: str) -> None:
    comments = [f"calibration {calibration.name}", f"settings {Path(settings).name}", "camera frame, mm"]
    write_ply(output, scan.chunks, comments)
    if picture is not None and scan.counts.points:
        from .cloud.picture import draw

        draw(scan.cloud(), picture)


def _summary(scan: Scan, card: Card) -> str:
    counts, link = scan.counts, card.link
    damaged = link.statistics.damaged + card.damaged_frames
    parts = [
        f"{counts.frames} frames",
        f"{counts.points} points",
        f"{counts.lost_frames} lost frames ({counts.dropped_frames} dropped by the card)",
        f"{damaged} damaged packets",
        f"{counts.encoder_errors} encoder errors",
    ]
    more = {
        "frames before the index": counts.unreferenced_frames,
        "points at standstill": counts.standing,
        "points below the least quality": counts.poor,
        "rays parallel to the laser plane": counts.parallel,
        "rays that meet it behind the camera": counts.behind,
    }
    return ", ".join(parts + [f"{number} {what}" for what, number in more.items() if number])


def _warn_if_empty(scan: Scan) -> None:
    counts = scan.counts
    if counts.points:
        return
    if not counts.frames:
        hint = "no frame came: is the camera connected?"
    elif counts.unreferenced_frames == counts.frames:
        hint = "the index was never passed, so no angle is known: does the motor turn, is the index barrier connected?"
    else:
        hint = "no row gave a point: is the laser on, do the settings' gate and floor fit it?"
    print(f"magtrak-recv: the cloud is empty; {hint}", file=sys.stderr)
