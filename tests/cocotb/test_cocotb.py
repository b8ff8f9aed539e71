"""Starts the modules that run inside the simulator, each test with a card just after power-up."""

import re
from pathlib import Path

import pytest

from sim.verilator import card_verilog
from tests.support.cocotb import simulate_cocotb

NAMES = re.findall(r"^async def (test_\w+)", Path(__file__).with_name("tb_core.py").read_text(), re.MULTILINE)


@pytest.mark.parametrize("name", NAMES)
def test_core(name):
    simulate_cocotb(card_verilog(), "tests.cocotb.tb_core", name)
