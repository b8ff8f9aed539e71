"""The board files elaborate to a complete design; synthesis is left to ``make bitstream``."""

import pytest

from boards.ulx3s import Platform, card

SITES = ("B11", "A10", "A9", "B9", "A6", "A4", "A2", "C4", "F4")


@pytest.mark.parametrize(("link", "sites"), [("uart", ("M1", "L4")), ("usb", ("D15", "E15", "B12"))])
def test_ulx3s_is_complete(link, sites, monkeypatch, tmp_path):
    """Every resource is there, and Amaranth's own netlist of the card is written."""
    for tool in ("YOSYS", "NEXTPNR_ECP5", "ECPPACK", "OPENFPGALOADER"):
        monkeypatch.setenv(tool, "true")
    monkeypatch.chdir(tmp_path)
    plan = Platform().build(card(link), do_build=False)
    netlist = plan.files["top.il"]
    assert "core" in str(netlist)
    constraints = str(plan.files["top.lpf"])
    for site in (*SITES, *sites):
        assert f'SITE "{site}"' in constraints, site
