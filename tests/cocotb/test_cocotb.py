"""Starts the modules that run inside the simulator."""

from sim.verilator import card_verilog
from tests.support.cocotb import simulate_cocotb


def test_core():
    simulate_cocotb(card_verilog(), "tests.cocotb.tb_core")
