"""Cards on this computer: by the identity of their USB port, and by their answer to a greeting."""

import os
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from .card import Card, Identity
from .errors import LinkError, MagtrakError
from .link import Link
from .port import BAUD

USB_IDS = {
    (0x0403, 0x6010): "FTDI FT2232H",
    (0x0403, 0x6014): "FTDI FT232H",
    (0x0403, 0x6015): "FTDI FT231X",
    (0x1209, 0x0001): "Magtrak USB",
}
"""Vendor and product numbers of ports that a card can be behind. Others are not opened unless asked for: opening a port
resets some devices."""

PORTS_VARIABLE = "MAGTRAK_PORTS"
"""Environment variable with more ports to look at, as those of virtual cards, separated as in PATH."""

GREETING_S = 0.5
"""For an answer; a card needs a millisecond, the USB adapter 16."""


@dataclass(frozen=True)
class Candidate:
    """A port, and what USB tells of it.

    Attributes
    ----------
    port : name
    usb : "vendor:product", empty for what is not on USB
    product : what the device calls itself
    usb_serial : serial number in its USB descriptor, or ""
    """

    port: str
    usb: str = ""
    product: str = ""
    usb_serial: str = ""


@dataclass(frozen=True)
class Found:
    """A candidate that was greeted: its ``identity``, or the ``problem`` in one sentence."""

    candidate: Candidate
    identity: Identity | None
    problem: str = ""


def candidates(more: Iterable[str] = (), *, every: bool = False) -> list[Candidate]:
    """Ports on USB with one of :data:`USB_IDS` (or all that there are), those in the environment, and ``more``."""
    from serial.tools import list_ports

    ports = []
    for info in list_ports.comports():
        known = (info.vid, info.pid) in USB_IDS
        if known or every:
            usb = "" if info.vid is None else f"{info.vid:04x}:{info.pid:04x}"
            ports.append(Candidate(info.device, usb, info.product or "", info.serial_number or ""))
    named = [name for name in os.environ.get(PORTS_VARIABLE, "").split(os.pathsep) if name]
    seen = {candidate.port for candidate in ports}
    ports += [Candidate(name) for name in dict.fromkeys([*named, *more]) if name not in seen]
    return ports


def greet(candidate: Candidate, baud: int = BAUD) -> Found:
    """Ask who is there, by reading alone: nothing is changed in a card."""
    try:
        with Link(candidate.port, baud) as link:
            return Found(candidate, Card(link, GREETING_S).identity)
    except MagtrakError as error:
        return Found(candidate, None, str(error))


def greet_all(ports: Iterable[Candidate], baud: int = BAUD) -> list[Found]:
    """Greet all at once, so that silent ones do not add up; in the order given."""
    ports = list(ports)
    if not ports:
        return []
    with ThreadPoolExecutor(max_workers=len(ports)) as pool:
        return list(pool.map(lambda candidate: greet(candidate, baud), ports))


def resolve(name: str | None, baud: int = BAUD) -> str:
    """The port that is meant: a path as it is; a serial number, the port of that card; None, the only card there is.

    Raises
    ------
    LinkError
        There is no such card, or more than one.
    """
    if name is not None and ("/" in name or Path(name).exists()):
        return name
    found = [one for one in greet_all(candidates(), baud) if one.identity is not None]
    if name is not None:
        found = [one for one in found if name.upper() in (_serial(one), one.candidate.usb_serial.upper())]
    if len(found) == 1:
        return found[0].candidate.port
    what = "no card was found" if name is None else f"no card with the serial number {name} was found"
    if found:
        ports = ", ".join(f"{one.candidate.port} ({_serial(one)})" for one in found)
        raise LinkError(f"{len(found)} cards were found, {ports}: name one with --port")
    raise LinkError(f"{what}: plug it in, or name its port with --port; `magtrak doctor` tells what is wrong")


def wait_for(port: str, serial: int, timeout_s: float, baud: int = BAUD) -> str | None:
    """The port of the card with that serial number, once it is back; None where it is not in time.

    A card without a serial number (0) is taken for the one that it was if it comes back on the same port.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        # Ports that are in use or do not answer yet are looked at again.
        there = [Candidate(port)] if Path(port).exists() else []
        there += [candidate for candidate in candidates() if candidate.port != port] if serial else []
        for found in greet_all(there, baud):
            if found.identity is not None and found.identity.serial == serial:
                return found.candidate.port
        if time.monotonic() >= deadline:
            return None
        time.sleep(0.2)


def _serial(found: Found) -> str:
    return found.identity.serial_text if found.identity is not None else ""
