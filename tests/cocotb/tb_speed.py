"""The whole card with a pixel at each clock, timed; started by ``tests.bench.virtual_card``."""

import json
import os
import time
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import FallingEdge, Timer

from magtrak import protocol
from tests.bench.virtual_card import CLOCK_HZ, ROW_CLOCKS, RUN, WIDTH, picture

ROWS = 60


@cocotb.test()
async def test_speed(dut):
    image = picture()[:ROWS].tolist()
    for port in ("video_valid", "video_frame_end", "encoder_a", "encoder_b", "index", "rx_valid"):
        getattr(dut, port).value = 0
    dut.clock_hz.value = CLOCK_HZ
    dut.interlock.value = 1
    dut.tx_ready.value = 1
    Clock(dut.clk, 10, unit="ns").start()
    await FallingEdge(dut.clk)
    for byte in protocol.frame_packet(RUN):
        dut.rx_valid.value = 1
        dut.rx_data.value = byte
        taken = False
        while not taken:
            await Timer(2, "ns")  # settled: what holds now holds at the rising edge
            taken = bool(dut.rx_ready.value)
            await FallingEdge(dut.clk)
    dut.rx_valid.value = 0
    for _ in range(600):  # the registers get their first values before
        await FallingEdge(dut.clk)
    assert dut.run.value == 1
    started = time.perf_counter()
    for y, row in enumerate(image):
        for x, (r, g, b) in enumerate(row):
            dut.video_valid.value = 1
            dut.video_r.value = r
            dut.video_g.value = g
            dut.video_b.value = b
            dut.video_row_first.value = x == 0
            dut.video_row_last.value = x == WIDTH - 1
            dut.video_frame_first.value = x == 0 and y == 0
            await FallingEdge(dut.clk)
        dut.video_valid.value = 0
        for _ in range(ROW_CLOCKS - WIDTH):
            await FallingEdge(dut.clk)
    speed = ROWS * ROW_CLOCKS / (time.perf_counter() - started)
    Path(os.environ["MAGTRAK_SPEED"]).write_text(json.dumps({"clocks_per_second": speed}))
