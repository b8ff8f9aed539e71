"""One scan, from opening the port to the cloud on disk: what ``magtrak-recv`` does."""

import sys
from dataclasses import replace
from pathlib import Path

from .calibration import Calibration
from .cloud.ply import write_ply
from .discover import resolve
from .errors import OutputError, SettingsError
from .receiver import Interrupt, Limits, Receiver
from .recording import Recorder, require_mcap
from .scan import Scan
from .settings import Settings
from .settings_file import load_settings, settings_text

__all__ = ["Limits", "check_outputs", "receive", "write_cloud"]


def receive(
    *,
    port: str,
    baud: int,
    calibration: Path,
    settings: str,
    output: Path,
    picture: Path | None = None,
    record: Path | None = None,
    limits: Limits,
    min_quality: float = 0.0,
    bare: bool = False,
    reconnect_s: float = 0.0,
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
    check_outputs(output, picture, record)
    receiver = Receiver(chosen, limits, baud, reconnect_s)

    def recorder() -> Recorder | None:
        if record is None:
            return None
        options = {"angle": "bare" if bare else "rows", "min_quality": repr(min_quality)}
        return Recorder(record, calibration.read_text(encoding="utf-8"), settings_text(settings), options)

    try:
        receiver.connect(resolve(port, baud), recorder)
    except BaseException:
        receiver.discard()
        raise
    try:
        scan = Scan(loaded, receiver.card.identity.clock_hz, bare=bare, min_quality=min_quality)
        with Interrupt() as interrupt:
            failure = receiver.run(scan, interrupt)
            comments = [f"calibration {calibration.name}", f"settings {Path(settings).name}", "camera frame, mm"]
            write_cloud(scan, output, picture, [*comments, *receiver.time_comments])
    finally:
        receiver.close()
    print(receiver.summary(scan), flush=True)
    if failure is not None:
        raise type(failure)(f"{failure}; the cloud so far is in {output}")
    _warn_if_empty(scan)


def _with_counts_per_turn(settings: Settings, calibration: Calibration, name: str) -> Settings:
    """The card checks every turn against the calibration's counts; settings that say otherwise are a mistake."""
    wanted, given = calibration.laser.counts_per_turn, settings.encoder.counts_per_turn
    if given not in (0, wanted):
        raise SettingsError(f"{name}: encoder.counts_per_turn is {given}, the calibration has {wanted}: correct one")
    return replace(settings, encoder=replace(settings.encoder, counts_per_turn=wanted))


def check_outputs(output: Path, picture: Path | None, record: Path | None = None) -> None:
    """:exc:`MagtrakError` where one of the files could not be written, or not be made."""
    for path in filter(None, (output, picture, record)):
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
    if record is not None:
        require_mcap()


def write_cloud(scan: Scan, output: Path, picture: Path | None, comments: list[str]) -> None:
    """The cloud, and its picture where one is wanted and there are points."""
    write_ply(output, scan.chunks, comments)
    if picture is not None and scan.counts.points:
        from .cloud.picture import draw

        draw(scan.cloud(), picture)


def _warn_if_empty(scan: Scan) -> None:
    counts = scan.counts
    if counts.points:
        return
    if not counts.frames:
        hint = "no frame came: is the camera connected?"
    elif counts.unsubtracted_frames + counts.dark_frames == counts.frames:
        hint = "no frame had a background to subtract: go on for longer, or set ambient.mode to 'off'"
    elif counts.unreferenced_frames + counts.unsubtracted_frames + counts.dark_frames == counts.frames:
        hint = "the index was never passed, so no angle is known: does the motor turn, is the index barrier connected?"
    else:
        hint = "no row gave a point: is the laser on, do the settings' gate and floor fit it?"
    print(f"magtrak-recv: the cloud is empty; {hint}", file=sys.stderr)
