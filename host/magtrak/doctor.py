"""Finds out what keeps a card from being reached or from working well, and says what to do."""

import grp
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from .card import Card
from .discover import GREETING_S, candidates
from .errors import MagtrakError
from .link import Link
from .port import BAUD, is_pseudo_terminal, users
from .protocol import CAMERA_ERRORS
from .state import State
from .summary import median
from .udev import FILE

OTHER_BAUDS = (12_000_000, 6_000_000, 2_000_000, 1_000_000, 921_600, 460_800, 115_200)
TRAFFIC_READS = 400
SLOW_ANSWER_S = 8e-3
"""A card answers in a millisecond; an adapter that collects for 16 ms takes longer than this."""


@dataclass(frozen=True)
class Finding:
    """One thing looked at: whether it is well, and in one sentence what was seen, or what to do."""

    what: str
    well: bool
    text: str


@dataclass(frozen=True)
class System:
    """Where to look; tests look elsewhere."""

    sys: Path = Path("/sys")
    proc: Path = Path("/proc")
    rules: tuple[Path, ...] = tuple(Path(f"{folder}/udev/rules.d") for folder in ("/etc", "/run", "/usr/lib", "/lib"))


def examine(port: str | None, baud: int = BAUD, system: System | None = None) -> Iterator[Finding]:
    """Look at everything, as it is found; with the port None, at all that can be a card's."""
    system = system or System()
    ports = [port] if port is not None else [candidate.port for candidate in candidates()]
    # What concerns USB alone means nothing to a virtual card.
    if not all(is_pseudo_terminal(name) for name in ports) or not ports:
        yield from _rules(system)
        yield from _modem_manager(system)
    if not ports:
        yield Finding("port", False, "no USB port that can be a card's: plug the card in, or name its port with --port")
    for name in ports:
        yield from _port(name, baud, system)


def _rules(system: System) -> Iterator[Finding]:
    found = next((folder / FILE for folder in system.rules if (folder / FILE).exists()), None)
    cure = f"install it with `magtrak doctor --udev | sudo tee /etc/udev/rules.d/{FILE}`, and plug the card in anew"
    yield Finding("udev rules", found is not None, f"{found} is there" if found else f"{FILE} is not there: {cure}")


def _modem_manager(system: System) -> Iterator[Finding]:
    names = []
    for comm in system.proc.glob("[0-9]*/comm"):
        try:
            names.append(comm.read_text().strip())
        except OSError:  # ended meanwhile
            continue
    if "ModemManager" not in names:
        yield Finding("ModemManager", True, "does not run")
    elif any((folder / FILE).exists() for folder in system.rules):
        yield Finding("ModemManager", True, "runs, and is told to leave cards alone")
    else:
        text = "runs, and talks to ports for 20 s after they are plugged in: install the udev rules, or wait so long"
        yield Finding("ModemManager", False, text)


def _port(port: str, baud: int, system: System) -> Iterator[Finding]:
    path = Path(port)
    if not path.exists():
        stale = path.is_symlink()
        cure = "start magtrak-sim again" if stale else "plug the card in, or check the name"
        yield Finding(port, False, f"{'leads nowhere' if stale else 'does not exist'}: {cure}")
        return
    if not os.access(port, os.R_OK | os.W_OK):
        yield Finding(port, False, _permission(path))
        return
    yield from _latency(port, system)
    others = [(pid, name) for pid, name in users(port) if pid != os.getpid()]
    if others:
        names = ", ".join(f"{name} (process {pid})" for pid, name in others)
        yield Finding(port, False, f"is in use by {names}: end that first")
        return
    try:
        with Link(port, baud) as link:
            card = Card(link, GREETING_S)
            size = f"{card.identity.max_columns} x {card.identity.rows}"
            yield Finding(port, True, f"card {card.identity.serial_text}, images up to {size}")
            yield from _traffic(card)
            yield from _state(State.read(card), virtual=is_pseudo_terminal(port))
    except MagtrakError as error:
        yield Finding(port, False, _other_baud(port, baud) or str(error))


def _permission(path: Path) -> str:
    try:
        group = grp.getgrgid(path.stat().st_gid)
    except (KeyError, OSError):
        return "may not be opened: install the udev rules"
    if os.environ.get("USER", "") in group.gr_mem:
        return f"may not be opened yet: you joined the group {group.gr_name} after logging in; log out and in again"
    return f"may not be opened: install the udev rules, or join its group by `sudo usermod -aG {group.gr_name} $USER`"


def _latency(port: str, system: System) -> Iterator[Finding]:
    timer = system.sys / "class/tty" / Path(os.path.realpath(port)).name / "device/latency_timer"
    try:
        waits_ms = int(timer.read_text())
    except (OSError, ValueError):
        return  # no FTDI adapter
    cure = f"the adapter waits {waits_ms} ms before it hands over data: install the udev rules, or write 1 to {timer}"
    yield Finding(f"{port} latency", waits_ms <= 2, f"{waits_ms} ms" if waits_ms <= 2 else cure)


def _other_baud(port: str, baud: int) -> str | None:
    """Where the card answers at another baud rate, what to do."""
    if is_pseudo_terminal(port):
        return None
    for other in OTHER_BAUDS:
        if other == baud:
            continue
        try:
            with Link(port, other) as link:
                Card(link, GREETING_S / 3)
            return f"the card answers at {other} baud, not at {baud}: use --baud {other}"
        except MagtrakError:
            continue
    return None


def _traffic(card: Card) -> Iterator[Finding]:
    """Many questions, and what became of them."""
    before = State.read(card)
    start = time.monotonic()
    for _ in range(TRAFFIC_READS // 8):
        card.read_all(["version"] * 8)
    span_s = time.monotonic() - start
    after = State.read(card)
    losses = {
        "packets lost on the way from the card": card.link.statistics.lost,
        "commands damaged on the way to it": after.values["damaged_commands"] - before.values["damaged_commands"],
        "bytes lost by its UART": after.values["line_errors"] - before.values["line_errors"],
    }
    seen = ", ".join(f"{number} {what}" for what, number in losses.items() if number)
    well = f"{TRAFFIC_READS} answers in {1e3 * span_s:.0f} ms, none lost"
    yield Finding("link", not seen, f"{seen}: try another cable and port, or a lower baud rate" if seen else well)
    answer_s = median(card.round_trips_s)
    slow = f"{1e3 * answer_s:.0f} ms for an answer: the adapter collects data; install the udev rules, or avoid a hub"
    yield Finding("answers", answer_s < SLOW_ANSWER_S, f"{1e3 * answer_s:.1f} ms" if answer_s < SLOW_ANSWER_S else slow)


def _state(state: State, *, virtual: bool) -> Iterator[Finding]:
    """What the card's own counters and states tell. A virtual card shows no image before it is asked to measure."""
    values = state.values
    waiting = virtual and not values["run"]
    looks = (
        (
            "images",
            values["frames"] > 0 or waiting,
            f"{values['frames']} seen, {values['dropped']} dropped because nobody read them in time",
            "none seen since the card's reset: check the camera's cable and power, and that it runs",
        ),
        (
            "camera",
            not values["camera_errors"],
            "keeps the card's contract",
            f"breaks the card's contract ({_names(values['camera_errors'])}): lower its clock or its frame rate",
        ),
        (
            "encoder",
            not state.encoder_errors,
            f"no errors, {values['index_passes']} passes of the index",
            f"{state.encoder_errors} errors since the card's reset: check A and B for a broken wire or noise",
        ),
        *state.sensor.looks(),
        ("interlock", bool(values["laser_state"] & 4), "closed", "open, so that the laser stays off: close it"),
        ("motor", not state.safety.stopped, state.motor(), str(state.safety.fault(armed=False))),
    )
    for what, well, good, bad in looks:
        yield Finding(what, well, good if well else bad)


def _names(word: int) -> str:
    fields = CAMERA_ERRORS.unpack(word.to_bytes(CAMERA_ERRORS.size, "little"))
    return ", ".join(name for name, value in fields.items() if value)
