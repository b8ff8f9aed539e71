"""The board of the virtual card: the core with every port under a flat name.

``python -m boards.simulation [max_columns [max_rows]]`` prints it as Verilog.
Verilator renames double underscores, so no port has one.
"""

import sys

from amaranth.hdl import ClockDomain, ClockSignal, DomainRenamer, Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from gateware.camera.pattern import Pattern
from gateware.core import Core
from gateware.features import EVERYTHING, Features
from gateware.verilog import verilog

_WIRES = {
    "encoder_a": In(1),
    "encoder_b": In(1),
    "index": In(1),
    "interlock": In(1),
    "clock_hz": In(32),
    "serial": In(64),
    "link_baud": In(32),
    "line_errors": In(16),
    "pwm": Out(1),
    "direction": Out(1),
    "brake": Out(1),
    "laser": Out(1),
    "lamp": Out(1),
    "run": Out(1),
}


class SimulationTop(wiring.Component):
    """:class:`~gateware.core.Core`, flat, with the clock ``clk``.

    There is no reset: a simulation starts with every register at its initial value, as an FPGA does after
    configuration. (A reset port would be an input of nearly all logic, and Verilator would compute that logic twice a
    clock.)

    Parameters
    ----------
    features : what it is built with
    own_clock : pixels come, and are measured, with the clock ``pixel_clk``
    pattern : the card's own test picture instead of a camera: the ``video`` ports are not connected then, and the
        motor's outputs are wired to the encoder's inputs, PWM to A, direction to B, brake to the index

    Members
    -------
    video_valid, video_r, video_g, video_b, video_row_first, video_row_last, video_frame_first :
        a pixel, taken in every clock in which it is valid; the core sees it a clock later
    video_frame_end : strobe after the last pixel of an image
    video_field : which rows it has
    pixel_clk : clock of the above, with ``own_clock``
    rx_valid, rx_data, rx_ready, tx_valid, tx_data, tx_ready : bytes; one moves in each clock
        in which valid and ready are both high
    encoder_a, encoder_b, index, interlock, clock_hz, serial, link_baud, line_errors, pwm, direction, brake, laser,
    lamp, run :
        as in :class:`~gateware.core.Core`
    """

    def __init__(
        self, features: Features = EVERYTHING, pattern: Pattern | None = None, *, own_clock: bool = False
    ) -> None:
        self.core = Core(features, "pixel" if own_clock else "sync")
        self.pattern = pattern
        super().__init__(
            {
                "clk": In(1),
                **({"pixel_clk": In(1)} if own_clock else {}),
                "video_valid": In(1),
                "video_r": In(8),
                "video_g": In(8),
                "video_b": In(8),
                "video_row_first": In(1),
                "video_row_last": In(1),
                "video_frame_first": In(1),
                "video_frame_end": In(1),
                "video_field": In(2),
                "rx_valid": In(1),
                "rx_data": In(8),
                "rx_ready": Out(1),
                "tx_valid": Out(1),
                "tx_data": Out(8),
                "tx_ready": In(1),
                **_WIRES,
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.domains.sync = ClockDomain(reset_less=True)
        m.d.comb += ClockSignal().eq(self.clk)
        m.submodules.core = core = self.core
        pixels = core.pixel_domain
        if pixels != "sync":
            m.domains += ClockDomain(pixels, reset_less=True)
            m.d.comb += ClockSignal(pixels).eq(self.pixel_clk)
        if self.pattern is None:
            pixel = core.video.pixel
            # Pixels go through a register: Verilator computes twice a clock what depends on an input.
            m.d[pixels] += [
                pixel.valid.eq(self.video_valid),
                core.video.frame_end.eq(self.video_frame_end),
                core.video.field.eq(self.video_field),
            ]
            for name in ("r", "g", "b", "row_first", "row_last", "frame_first"):
                m.d[pixels] += pixel.payload[name].eq(getattr(self, f"video_{name}"))
        else:
            pattern = self.pattern
            m.submodules.pattern = DomainRenamer(pixels)(pattern)
            wiring.connect(m, pattern.video, core.video)
            m.d.comb += pattern.run.eq(core.run)
        m.d.comb += [
            core.rx.valid.eq(self.rx_valid),
            core.rx.payload.eq(self.rx_data),
            self.rx_ready.eq(core.rx.ready),
            self.tx_valid.eq(core.tx.valid),
            self.tx_data.eq(core.tx.payload),
            core.tx.ready.eq(self.tx_ready),
        ]
        looped = {"encoder_a": core.pwm, "encoder_b": core.direction, "index": core.brake}
        for name, member in _WIRES.items():
            inner, outer = getattr(core, name), getattr(self, name)
            if self.pattern is not None and name in looped:
                m.d.comb += inner.eq(outer | looped[name])
            else:
                m.d.comb += inner.eq(outer) if member.flow is In else outer.eq(inner)
        return m


if __name__ == "__main__":
    print(verilog(SimulationTop(Features(*map(int, sys.argv[1:])))), end="")
