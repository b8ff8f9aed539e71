"""The whole card on small images, in Amaranth's simulator; ``tests/cocotb`` has more and larger ones."""

import random
import re

import numpy as np
import pytest

from boards.simulation import SimulationTop
from gateware.core import Core
from gateware.features import Features
from gateware.verilog import verilog
from magtrak import protocol
from magtrak.protocol import (
    COMMAND,
    FEATURES,
    FRAME,
    FRAME_FLAGS,
    FULL_ROW,
    Access,
    AmbientMode,
    AnswerCode,
    Deframer,
    Packet,
    PacketType,
    Phase,
    Scope,
)
from magtrak.reference import Background, measure, mix
from tests.support.simulation import simulate
from tests.support.streams import send

SETTINGS = {r.name: r.init for r in protocol.REGISTERS if r.scope is Scope.FRAME and r.access is Access.BOTH}
CLOCK_HZ = 100_000
SMALL = Features(64, 16)


def line_image(rows=3, columns=32, seed=0):
    """A green line on a dark background."""
    rng = np.random.default_rng(seed)
    x = np.arange(columns)
    light = 200 * np.exp(-((x - np.linspace(10, 20, rows)[:, None]) ** 2) / 4.5)
    return (light[..., None] * [0.2, 1.0, 0.3] + rng.integers(0, 5, (rows, columns, 3))).clip(0, 255).astype(np.uint8)


class Rig:
    """Host and camera of a core."""

    def __init__(self, ctx, dut):
        self.ctx = ctx
        self.dut = dut
        self.packets = []
        self.sequence = 0
        ctx.set(dut.clock_hz, CLOCK_HZ)
        ctx.set(dut.interlock, 1)

    async def write(self, name, value, word=0):
        payload = COMMAND.pack({"address": protocol.register(name).address + word, "value": value & 0xFFFF_FFFF})
        return await self.command(PacketType.WRITE, payload)

    async def read(self, name):
        payload = COMMAND.pack({"address": protocol.register(name).address, "value": 0})
        answer = await self.command(PacketType.READ, payload)
        assert answer["code"] == AnswerCode.DONE
        return protocol.register(name).decode(answer["value"])

    async def command(self, kind, payload):
        self.sequence += 1
        await send(self.ctx, self.dut.rx, protocol.frame_packet(Packet(kind, self.sequence, payload)))
        answer = protocol.ANSWER.unpack((await self.packet(PacketType.ANSWER)).payload)
        assert answer["to"] == self.sequence
        return answer

    async def packet(self, kind):
        """The next packet of a type; the others wait."""
        while not any(packet.type == kind for packet in self.packets):
            await self.ctx.tick()
        return self.packets.pop(next(n for n, packet in enumerate(self.packets) if packet.type == kind))

    async def frame(self):
        """Header and rows of the next frame."""
        payload = (await self.packet(PacketType.FRAME)).payload
        header = FRAME.unpack(payload[: FRAME.size])
        rows = payload[FRAME.size + header["edges"] * protocol.EDGE.size :]
        assert len(rows) == header["rows"] * FULL_ROW.size
        return header, [FULL_ROW.unpack(rows[at : at + FULL_ROW.size]) for at in range(0, len(rows), FULL_ROW.size)]

    async def show(self, image):
        ctx, video = self.ctx, self.dut.video
        rows, columns = image.shape[:2]
        for y in range(rows):
            for x in range(columns):
                r, g, b = map(int, image[y, x])
                places = {"row_first": x == 0, "row_last": x == columns - 1, "frame_first": x == y == 0}
                ctx.set(video.pixel.payload, {"r": r, "g": g, "b": b, **places})
                ctx.set(video.pixel.valid, 1)
                await ctx.tick()
            ctx.set(video.pixel.valid, 0)
            for _ in range(max(16, 48 - columns)):
                await ctx.tick()
        ctx.set(video.frame_end, 1)
        await ctx.tick()
        ctx.set(video.frame_end, 0)
        for _ in range(64):
            await ctx.tick()


def run(test, clocks=30_000, features=SMALL):
    """Run ``test(rig)`` on a core after reset, whose host always reads."""
    dut = Core(features)
    rigs = []

    async def testbench(ctx):
        rigs.append(Rig(ctx, dut))
        await test(rigs[0])

    async def listen(ctx):
        deframer = Deframer()
        ctx.set(dut.tx.ready, 1)
        while True:
            _, _, valid, byte = await ctx.tick().sample(dut.tx.valid, dut.tx.payload)
            if valid:
                rigs[0].packets += deframer.feed(bytes([byte]))
                assert not deframer.damaged

    simulate(dut, testbench, listen, clocks=clocks)


def expected(image, settings=SETTINGS, background=None):
    """Rows by the reference, all colours passing the gate."""
    records = measure(image, settings, np.ones((3, 256), bool), background)
    return [{name: int(record[name]) for name in record.dtype.names} for record in records]


async def open_gate(rig):
    """All colours pass."""
    for name in ("lut_hue", "lut_luminance", "lut_saturation"):
        for word in range(protocol.LUT_WORDS):
            assert (await rig.write(name, 0xFFFF_FFFF, word))["code"] == AnswerCode.DONE


def test_from_pixels_to_packets():
    async def test(rig):
        assert await rig.read("magic") == protocol.MAGIC
        assert (await rig.read("max_columns"), await rig.read("max_rows")) == (64, 16)
        await open_gate(rig)
        await rig.write("exposure_us", 1234)
        assert (await rig.write("commit", 5))["code"] == AnswerCode.PENDING
        await rig.show(line_image())  # nobody wants it yet
        assert await rig.read("pending") == 1
        await rig.write("run", 1)
        assert rig.ctx.get(rig.dut.run)
        image = line_image(seed=1)
        await rig.show(image)
        header, rows = await rig.frame()
        assert rows == expected(image)
        assert all(row["valid"] for row in rows)
        facts = {"frame": 0, "generation": 5, "rows": 3, "columns": 32, "camera_errors": 0, "exposure_us": 1234}
        assert facts.items() <= header.items()
        assert header["last_time"] - header["first_time"] == 2 * 48
        assert await rig.read("frames") == 1

    run(test)


@pytest.mark.parametrize(
    ("mode", "sequence"),
    [(AmbientMode.ALTERNATE, "UBMBM"), (AmbientMode.SKIP, "USBSMSBSM")],
)
def test_backgrounds_are_dark_and_subtracted(mode, sequence):
    """Laser, flag, phase and rows of each image; the first one brings the mode in force."""

    async def test(rig):
        ctx, dut = rig.ctx, rig.dut
        await rig.write("laser_delay_ms", 0)
        await rig.write("laser_arm", protocol.LASER_KEY)
        await open_gate(rig)
        await rig.write("ambient_mode", mode)
        await rig.write("commit", 1)
        await rig.write("run", 1)
        for _ in range(2 * CLOCK_HZ // 1000):
            await ctx.tick()
        room = line_image(seed=3)[:, ::-1] // 2
        for number, name in enumerate(sequence):
            lit = ctx.get(dut.laser)
            image = np.maximum(room, line_image(seed=number)) if lit else room
            await rig.show(image)
            header, rows = await rig.frame()
            phase = next(phase for phase in Phase if phase.name.startswith(name))
            assert (header["frame"], header["phase"], header["columns"]) == (number, phase, 32)
            laser_on = FRAME_FLAGS.unpack(header["flags"].to_bytes(2, "little"))["laser_on"]
            if phase in (Phase.MEASURED, Phase.UNSUBTRACTED):
                assert lit and laser_on
                mixed = mix(room, SETTINGS)
                background = Background.of(mixed, 0) if phase == Phase.MEASURED else None
                assert rows == expected(image, background=background)
            else:
                assert rows == []
                assert phase == Phase.SKIPPED or not (lit or laser_on)
        assert await rig.read("dropped") == 0

    run(test, clocks=60_000)


def test_a_camera_that_makes_noise_does_not_stop_the_card():
    async def test(rig):
        ctx, video = rig.ctx, rig.dut.video
        rng = random.Random(6)
        await open_gate(rig)
        await rig.write("commit", 1)
        await rig.write("run", 1)
        for _ in range(2500):
            begins = rng.random() < 0.02
            places = {
                "row_first": begins or rng.random() < 0.05,
                "row_last": rng.random() < 0.05,
                "frame_first": begins,
            }
            colour = {name: rng.randrange(256) for name in "rgb"}
            ctx.set(video.pixel.payload, {**colour, **places})
            ctx.set(video.pixel.valid, rng.random() < 0.8)
            ctx.set(video.frame_end, rng.random() < 0.02)
            await ctx.tick()
        ctx.set(video.pixel.valid, 0)
        ctx.set(video.frame_end, 1)
        await ctx.tick()
        ctx.set(video.frame_end, 0)
        for _ in range(1500):
            await ctx.tick()
        assert await rig.read("camera_errors") != 0
        rig.packets.clear()
        before = await rig.read("frames")
        image = line_image(seed=2)
        await rig.show(image)
        header, rows = await rig.frame()
        assert header["frame"] == before
        assert header["camera_errors"] == 0
        assert rows == expected(image)

    run(test)


def test_the_laser_needs_commands_that_arrive_intact():
    async def test(rig):
        ctx, dut = rig.ctx, rig.dut
        damaged = bytearray(protocol.frame_packet(Packet(PacketType.READ, 1, bytes(6))))
        damaged[4] ^= 0x10
        clocks_per_ms = CLOCK_HZ // 1000
        await rig.write("laser_delay_ms", 0)
        await rig.write("laser_lease_ms", 10)
        assert not ctx.get(dut.laser)
        await rig.write("laser_arm", protocol.LASER_KEY)
        for _ in range(2 * clocks_per_ms):  # a lease of 10 ms may end after 9: it counts ticks
            await ctx.tick()
        assert ctx.get(dut.laser)
        for _ in range(4):  # each renews the lease
            for _ in range(6 * clocks_per_ms):
                await ctx.tick()
            assert ctx.get(dut.laser)
            await rig.read("magic")
        for _ in range(4):
            for _ in range(3 * clocks_per_ms):
                await ctx.tick()
            await send(ctx, dut.rx, damaged)
        assert not ctx.get(dut.laser)
        assert await rig.read("damaged_commands") == 4
        assert await rig.read("laser_cause") == 3

    run(test)


def test_a_second_commit_leaves_the_gate_as_it_is():
    """Tables that were not written since they came in force are not exchanged for the older ones."""

    async def test(rig):
        await open_gate(rig)
        await rig.write("run", 1)
        for generation, floor in ((1, 20), (2, 30), (3, 25)):
            await rig.write("floor", floor)
            await rig.write("commit", generation)
            await rig.show(line_image())
            header, rows = await rig.frame()
            assert header["generation"] == generation
            assert rows == expected(line_image(), SETTINGS | {"floor": floor})
            assert rows[0]["gated"]

    run(test)


@pytest.mark.parametrize("runs", [True, False])
def test_the_smallest_card_measures_and_refuses_the_rest(runs):
    """With grey values, and without, by the paper's detector."""
    last = {"runs": runs, "edge_log": False, "close_images": runs, "fast_clock": runs}
    built = {"detector": 1, "floor": 20} if runs else {"detector": 0, "floor": 255}

    async def test(rig):
        assert await rig.read("features") >> FEATURES.index("runs") & 1 == runs
        assert await rig.read("background_cells") == 0
        answer = await rig.write("snapshot", 1)
        assert answer["code"] == AnswerCode.OUT_OF_RANGE
        await open_gate(rig)
        await rig.write("commit", 1)
        await rig.write("run", 1)
        await rig.show(line_image())
        header, rows = await rig.frame()
        assert (header["frame"], header["detector"]) == (0, built["detector"])
        assert rows == expected(line_image(), SETTINGS | {"centroid_window": 0, **built})
        assert all(row["gated"] for row in rows)
        assert header["edges"] == 0

    run(test, features=Features(64, 16, 0, isolate=False, window=False, speed_loop=False, snapshot=False, **last))


def test_what_needs_grey_values_is_not_built_without_them():
    with pytest.raises(ValueError, match="background_cells, window cannot be built without runs"):
        Features(isolate=False, snapshot=False, runs=False)


@pytest.mark.parametrize(("columns", "rows"), [(31, 16), (2049, 16), (64, 12), (64, 4096), (64, 1)])
def test_sizes_that_are_not_possible_are_refused(columns, rows):
    with pytest.raises(ValueError, match=f"is {columns if columns != 64 else rows};"):
        Features(columns, rows)


def test_the_simulation_has_flat_ports():
    text = verilog(SimulationTop(Features(32, 2)))
    ports = text.split("module top(")[1].split(")")[0].replace("\n", "").replace(" ", "")
    video = ("valid", "r", "g", "b", "row_first", "row_last", "frame_first", "frame_end", "field")
    wires = ("encoder_a", "encoder_b", "index", "interlock", "pwm", "direction", "brake", "laser", "lamp", "run")
    pins = [*wires, "clock_hz", "serial", "link_baud", "line_errors", "clk"]
    stream = [f"{end}_{name}" for end in ("rx", "tx") for name in ("valid", "data", "ready")]
    assert sorted(ports.split(",")) == sorted([*(f"video_{name}" for name in video), *pins, *stream])
    # One clock, and nothing of what a second one needs.
    assert set(re.findall(r"@\(posedge (\S+)\)", text)) == {"clk"}
    assert "top.core.pixels.vision" in text
    assert not re.search(r"^module \\top\.core\.\S*(handover|exchange|strobes|results|guard)", text, re.MULTILINE)
