"""Starts the modules that run inside the simulator, each test with a card just after power-up."""

import re
from pathlib import Path

import pytest

from sim.verilator import card_verilog
from tests.support.cocotb import simulate_cocotb

FASTER, SAME, SLOWER = 4014, 9966, 25_038
"""Periods of the pixels in ps, beside 10 ns of the card; the phase drifts through all there are."""

NAMES = re.findall(r"^async def (test_\w+)", Path(__file__).with_name("tb_core.py").read_text(), re.MULTILINE)


@pytest.mark.parametrize("name", NAMES)
def test_core(name):
    simulate_cocotb(card_verilog(), "tests.cocotb.tb_core", name)


@pytest.mark.parametrize(
    ("name", "pixel_ps"),
    [
        *(("test_every_image_has_the_settings_of_its_generation", ps) for ps in (FASTER, SAME, SLOWER)),
        ("test_snapshots_are_whole", FASTER),
        ("test_a_clock_that_stands_still_holds_up_nothing_else", SLOWER),
        ("test_backgrounds_are_subtracted", FASTER),
        ("test_stamps_are_as_late_as_they_say", FASTER),
        ("test_noise_ends_with_the_noise", FASTER),
        ("test_a_clock_that_is_too_fast_is_told", 1102),
    ],
)
def test_two_clocks(name, pixel_ps):
    simulate_cocotb(card_verilog(own_clock=True), "tests.cocotb.tb_clocks", name, variables={"PIXEL_PS": str(pixel_ps)})
