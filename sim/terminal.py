"""The virtual card's serial port: a pseudo-terminal with a name of its own."""

import array
import contextlib
import fcntl
import os
import pty
import termios
import time
import tty
from pathlib import Path

from .errors import SimError


class Terminal:
    """A pseudo-terminal whose slave side is what a host opens.

    It is raw before anyone opens it and stays so, since one descriptor of the slave side is kept open;
    for the same reason it does not notice a host that comes or goes. Writing never blocks.

    Parameters
    ----------
    link : where to put a symbolic link to the slave side; a stale one is replaced

    Attributes
    ----------
    name : what a host has to open
    """

    def __init__(self, link: Path | None = None) -> None:
        if link is not None:
            if link.exists():
                raise SimError(f"--link {link} exists already: remove it, or choose another path.")
            if not link.parent.is_dir():
                raise SimError(f"--link {link}: there is no folder {link.parent}.")
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self._link = link
        self._unsent = bytearray()
        self.name = os.ttyname(self._slave)
        if link is not None:
            link.unlink(missing_ok=True)  # a stale link: its target is gone
            link.symlink_to(self.name)
            self.name = str(link)

    def close(self) -> None:
        """Hang up and remove the link."""
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()
        os.close(self._master)
        os.close(self._slave)

    def read(self) -> bytes:
        """What the host has sent, without waiting."""
        with contextlib.suppress(BlockingIOError):
            return os.read(self._master, 1 << 16)
        return b""

    def write(self, data: bytes) -> bool:
        """Take bytes for the host; True if all bytes taken so far went out."""
        self._unsent += data
        with contextlib.suppress(BlockingIOError):
            while self._unsent:
                del self._unsent[: os.write(self._master, self._unsent[: 1 << 16])]
        return not self._unsent

    def drain(self, patience_s: float) -> bool:
        """Wait until the host has read everything; False if it read nothing for ``patience_s``."""
        quiet = 0
        before, since = -1, time.monotonic()
        while quiet < 5:  # the kernel refills the slave's queue from another one: look more than once
            time.sleep(0.02)
            sent = self.write(b"")
            waiting = array.array("i", [0])
            fcntl.ioctl(self._slave, termios.FIONREAD, waiting)
            left = len(self._unsent) + waiting[0]
            quiet = quiet + 1 if sent and left == 0 else 0
            if left != before:
                before, since = left, time.monotonic()
            elif left and time.monotonic() - since > patience_s:
                return False
        return True
