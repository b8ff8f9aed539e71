"""Serial ports: opening one, and one kind of error for all the ways in which a port fails or dies."""

import fcntl
import os
import termios
from collections.abc import Iterator
from pathlib import Path

import serial

from .errors import LinkError

BAUD = 3_000_000
"""Baud rate of the boards' UART; on USB CDC and pseudo-terminals it means nothing."""

PORT_ERRORS = (serial.SerialException, OSError, termios.error)
"""Unplugging raises one or another of these, depending on the call; ``termios.error`` is no OSError."""


def is_pseudo_terminal(port: str) -> bool:
    """Whether a virtual card's port is meant: only there is a hang-up the orderly end of a card."""
    return str(Path(port).resolve()).startswith("/dev/pts/")  # so they are named on Linux


def open_port(port: str, baud: int = BAUD, write_timeout_s: float = 2.0) -> serial.Serial:
    """The port, open and locked.

    Raises
    ------
    LinkError
        It is not there, is none, is in use, or does not take the baud rate.
    """
    if not Path(port).exists():
        raise LinkError(f"port {port} does not exist: is the card plugged in, or magtrak-sim running?")
    try:
        opened = serial.Serial(port, baud, timeout=0, write_timeout=write_timeout_s, exclusive=True)
        if not is_pseudo_terminal(port):
            # The lock above keeps out only programs that ask for it; this keeps out all. Not on a pseudo-terminal,
            # where it would outlive a program that was killed.
            fcntl.ioctl(opened.fileno(), termios.TIOCEXCL)
    except PORT_ERRORS as error:
        raise LinkError(f"port {port} cannot be opened: {_cure(error, port)}") from None
    except ValueError as error:
        raise LinkError(f"port {port} cannot be opened at {baud} baud: {error}") from None
    return opened


def users(port: str) -> list[tuple[int, str]]:
    """Process number and name of each program that has the port open, as far as this user may see them.

    Not the processes that such a program started, and not a virtual card, which has its own port open on both sides.
    """
    wanted = os.path.realpath(port)
    found: dict[int, tuple[str, int]] = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if any(os.path.realpath(file) == wanted for file in (entry / "fd").iterdir()):
                name = (entry / "comm").read_text().strip()
                # The parent is the second field behind the name, which may hold anything.
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                found[int(entry.name)] = name, parent
        except OSError:  # another user's, or ended meanwhile
            continue
    return [
        (pid, name)
        for pid, (name, parent) in found.items()
        if parent not in found and not (is_pseudo_terminal(port) and name == "magtrak-sim")
    ]


def _cure(error: BaseException, port: str) -> str:
    causes = list(_chain(error))
    numbers = {cause.errno for cause in causes if isinstance(cause, OSError)}
    if any(isinstance(cause, PermissionError) for cause in causes):
        return "this user may not open it; run `magtrak doctor` for the way"
    busy = any(isinstance(cause, BlockingIOError) for cause in causes) or "exclusively lock" in str(error)
    if busy or 16 in numbers:  # EBUSY
        others = ", ".join(f"{name} ({pid})" for pid, name in users(port) if pid != os.getpid())
        return f"another program has it open{f', {others}' if others else ''}; close that first"
    return "it is no serial port, or broken; check the name"


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
