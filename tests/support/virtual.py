"""``magtrak-sim`` and ``magtrak-recv`` as a user starts them, for tests of the whole chain."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

BIN = Path(sys.executable).parent
START_S = 300.0
END_S = 60.0


@contextmanager
def virtual_card(link: Path, *options: str | Path) -> Iterator[subprocess.Popen[str]]:
    """A virtual card on the port ``link``, ended at the latest when the block is left.

    ``--pace max`` unless the options say otherwise. Its standard error is a pipe.
    """
    command = [BIN / "magtrak-sim", "--link", link, "--pace", "max", *options]
    card = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        until = time.monotonic() + START_S
        while not link.exists():
            assert card.poll() is None, f"magtrak-sim ended at once: {card.stderr.read() if card.stderr else ''}"
            assert time.monotonic() < until, f"magtrak-sim made no port in {START_S:.0f} s"
            time.sleep(0.02)
        yield card
    finally:
        if card.poll() is None:
            card.terminate()
        card.communicate(timeout=END_S)


def run(command: str, *options: str | Path, timeout_s: float = 300.0) -> subprocess.CompletedProcess[str]:
    """A command of the environment, to its end, with its output as text."""
    return subprocess.run([BIN / command, *options], capture_output=True, text=True, timeout=timeout_s, check=False)


def receive(link: Path, calibration: Path, cloud: Path, *options: str | Path) -> subprocess.CompletedProcess[str]:
    """``magtrak-recv`` until the end of the stream; it must succeed."""
    done = run("magtrak-recv", "--port", link, "--calibration", calibration, "--output", cloud, *options)
    assert done.returncode == 0, f"magtrak-recv: {done.stderr}"
    return done


def refused(done: subprocess.CompletedProcess[str]) -> str:
    """The one line with which a command has refused; no traceback, nothing on standard output."""
    assert done.returncode == 1, f"exit status {done.returncode}: {done.stderr}"
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    return lines[0]
