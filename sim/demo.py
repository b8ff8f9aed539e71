"""A scan from nothing: what ``make scan`` does. Prints each command, so that it can be typed as well.

``python -m sim.demo OUT [--scene NAME]`` scans a scene twice with the virtual card, with the card's own detector
and with the paper's way, and judges both clouds by the scene's truth.
"""

import shlex
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO

import click

from magtrak.cli import fail

BIN = Path(sys.executable).parent
START_S = 600.0  # the first start compiles the card, and on a new machine Yosys as well


class CommandError(Exception):
    """A command ended with an error, which it has told itself."""


def show(command: list[str], log: IO[str]) -> None:
    print(f"\n$ {shlex.join(command)}", file=log, flush=True)


def call(command: list[str], log: IO[str] = sys.stdout) -> None:
    """Run a command of this environment to its end; what it says goes to ``log``."""
    show(command, log)
    if subprocess.run([BIN / command[0], *command[1:]], stdout=log, stderr=_errors(log), check=False).returncode:
        raise CommandError(command[0])


def scan(card: list[str], receiver: list[str], link: Path, log: IO[str] = sys.stdout) -> None:
    """Run the virtual card and, as soon as its port is there, the receiver."""
    link.unlink(missing_ok=True)
    card = [*card, "--link", f"{link}"]
    show([*card, "&"], log)
    process = subprocess.Popen([BIN / card[0], *card[1:]], stdout=log, stderr=_errors(log))
    try:
        until = time.monotonic() + START_S
        while not link.exists():
            if process.poll() is not None or time.monotonic() > until:
                raise CommandError(card[0])
            time.sleep(0.05)
        call([*receiver, "--port", f"{link}"], log)
        if process.wait(timeout=60):
            raise CommandError(card[0])
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait()


def _errors(log: IO[str]) -> IO[str] | None:
    """Standard error stays what it is for a person; for a log, it goes there too."""
    return None if log is sys.stdout else log


@click.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option("--scene", default="default", show_default=True)
def main(out: Path, scene: str) -> None:
    """Scan SCENE with the virtual card; cloud, picture and errors go to the folder OUT."""
    out.mkdir(parents=True, exist_ok=True)
    calibration = out / "calibration.json"
    cloud, truth = out / "scan.ply", out / "scan-truth.npz"
    settings, paper_settings = out / "scan.toml", out / "paper.toml"
    paper, paper_truth = out / "paper.ply", out / "paper-truth.npz"
    card = ["magtrak-sim", "--scene", scene, "--pace", "max", "--truth"]
    receiver = ["magtrak-recv", "--calibration", f"{calibration}", "--output"]
    picture = ["--picture", f"{cloud.with_suffix('.png')}"]
    judge = ["python", "-m", "sim.evaluate", "--scene", scene, "--truth", f"{truth}", f"{cloud}"]
    compare = ["--compare", f"{paper}", "--compare-truth", f"{paper_truth}"]
    try:
        call(["python", "-m", "sim.scene", scene, "--calibration", f"{calibration}", "--settings", f"{settings}"])
        paper_settings.write_text(settings.read_text() + '[peak]\ndetector = "binary"\n')
        in_its_way = ["--settings", f"{paper_settings}", "--angle", "bare"]
        # Beside each other: each needs a processor for a minute or two.
        with ThreadPoolExecutor() as pool, (out / "paper.log").open("w+") as log:
            second = pool.submit(
                scan, [*card, f"{paper_truth}"], [*receiver, f"{paper}", *in_its_way], out / "card2", log
            )
            mine = [*receiver, f"{cloud}", "--settings", f"{settings}", *picture]
            scan([*card, f"{truth}"], mine, out / "card")
            print("\nThe same scan in the paper's way: mean of the gated pixels, one bare encoder count for an image.")
            try:
                second.result()
            finally:
                log.seek(0)
                print(log.read(), end="", flush=True)
        call([*judge, *compare])
    except CommandError as error:
        fail(f"{error} failed; what it said is above.")


if __name__ == "__main__":
    main()
