"""Every register, read and written, and when settings come in force."""

import random

import pytest
from amaranth.hdl import ResetInserter, Signal

from gateware.features import Features
from gateware.registers import CardStatus, RegisterFile
from magtrak import protocol
from magtrak.protocol import REGISTERS, Access, AnswerCode, Scope, register
from tests.support.simulation import simulate

FEATURES = Features(640, 512, background_cells=1000)
CODES = AnswerCode


class Host:
    """The commanding end of a register file."""

    def __init__(self, ctx, dut):
        self.ctx = ctx
        self.dut = dut
        self.sequence = 0
        ctx.set(dut.write.ready, 1)

    async def command(self, address, value=0, *, write=0, refusal=0):
        """The answer's code and value."""
        ctx, dut = self.ctx, self.dut
        self.sequence = self.sequence + 1 & 0xFFFF
        fields = {"sequence": self.sequence, "write": write, "address": address, "value": value, "refusal": refusal}
        ctx.set(dut.command.payload, fields)
        ctx.set(dut.command.valid, 1)
        if dut.keep:
            await ctx.tick().until(dut.command.ready)
            ctx.set(dut.command.valid, 0)
        ctx.set(dut.answer.ready, 1)
        answer, ready = await ctx.tick().sample(dut.answer.payload, dut.command.ready).until(dut.answer.valid)
        assert ready == (not dut.keep)
        ctx.set(dut.command.valid, 0)
        ctx.set(dut.answer.ready, 0)
        assert (answer.to, answer.address) == (self.sequence, address)
        return CODES(answer.code), answer.value

    async def read(self, name):
        code, word = await self.command(register(name).address)
        return code, register(name).decode(word)

    async def write(self, name, value):
        code, word = await self.command(register(name).address, value & 0xFFFF_FFFF, write=1)
        return code, register(name).decode(word)

    async def frame(self):
        """The first pixel of an image."""
        self.ctx.set(self.dut.frame_start, 1)
        await self.ctx.tick()
        self.ctx.set(self.dut.frame_start, 0)


def run(test, clocks=200_000):
    """Run ``test(host)`` on a register file after reset."""
    for keep in (True, False):
        dut = RegisterFile(FEATURES, keep=keep)

        async def testbench(ctx, dut=dut):
            await test(Host(ctx, dut))

        simulate(dut, testbench, clocks=clocks)


def values_of(r):
    """Values worth a try: the limits, zero, the reset value and some others."""
    rng = random.Random(r.name)
    low, high = r.range
    return sorted({low, high, r.init, min(max(0, low), high), *(rng.randint(low, high) for _ in range(2))})


def test_every_register_reads_its_value_after_reset():
    rng = random.Random(1)
    status = {r.name: rng.randint(*r.range) for r in REGISTERS if r.name in dict(CardStatus)}
    own = {
        "magic": protocol.MAGIC,
        "version": protocol.VERSION,
        "map_hash": protocol.map_hash(),
        "max_columns": 640,
        "max_rows": 512,
        "background_cells": 1000,
        "features": 0x3FF,
    }

    async def test(host):
        host.ctx.set(host.dut.status, status)
        for r in REGISTERS:
            if r.access is Access.WRITE:
                for word in range(r.words):
                    assert await host.command(r.address + word) == (CODES.NOT_ALLOWED, 0)
            else:
                assert await host.read(r.name) == (CODES.DONE, {**own, **status}.get(r.name, r.init)), r.name
                _, word = await host.command(r.address)
                assert word == r.encode(r.decode(word)), f"{r.name} is not sign-extended"

    run(test)


def test_every_unused_address_is_unknown():
    used = {r.address + word for r in REGISTERS for word in range(r.words)}
    near = {a + d & 0xFFFF for a in used for d in (-1, 1, 8, 0x1000, 0x8000)}

    async def test(host):
        for address in sorted(near - used):
            assert await host.command(address) == (CODES.UNKNOWN_ADDRESS, 0), hex(address)
            assert await host.command(address, 1, write=1) == (CODES.UNKNOWN_ADDRESS, 0), hex(address)

    run(test)


def test_card_registers_cannot_be_written():
    async def test(host):
        for r in REGISTERS:
            if r.access is Access.READ:
                _, before = await host.read(r.name)
                assert await host.write(r.name, before ^ 1) == (CODES.NOT_ALLOWED, before), r.name

    run(test)


@pytest.mark.parametrize("scope", [Scope.NOW, Scope.FRAME])
def test_every_register_takes_its_range_and_nothing_else(scope):
    async def test(host):
        for r in REGISTERS:
            if r.scope is not scope or r.access is not Access.BOTH:
                continue
            before = r.init
            for value in values_of(r):
                code, answered = await host.write(r.name, value)
                if scope is Scope.FRAME:
                    assert (code, answered) == (CODES.DONE, before), r.name
                    await host.write("commit", 1)
                    await host.frame()
                    assert await host.read(r.name) == (CODES.DONE, value), r.name
                else:
                    assert (code, answered) == (CODES.DONE, value), r.name
                before = value
            low, high = r.range
            wide = (-(1 << 31), (1 << 31) - 1) if r.signed else (0, (1 << 32) - 1)
            for value in {low - 1, high + 1, *wide} - {low, high}:
                if wide[0] <= value <= wide[1]:
                    assert await host.write(r.name, value) == (CODES.OUT_OF_RANGE, before), (r.name, value)
            assert await host.read(r.name) == (CODES.DONE, before)

    run(test)


def test_settings_come_in_force_together_at_the_next_frame():
    async def test(host):
        dut, ctx = host.dut, host.ctx
        before = {r.name: r.init for r in REGISTERS if r.scope is Scope.FRAME and r.access is Access.BOTH}
        after = {name: next((v for v in values_of(register(name)) if v != init), init) for name, init in before.items()}

        def in_force():
            settings = ctx.get(dut.frame)
            return {name: settings[name] for name in before}

        for name, value in after.items():
            assert await host.write(name, value) == (CODES.DONE, before[name])
        await host.frame()
        assert in_force() == before, "in force without a commit"
        assert await host.write("commit", 0xBEEF) == (CODES.PENDING, 0)
        for name in after:
            assert await host.read(name) == (CODES.PENDING, before[name])
        assert await host.read("pending") == (CODES.DONE, 1)
        assert await host.read("generation") == (CODES.DONE, 0)
        assert in_force() == before
        assert not ctx.get(dut.lut.swap)
        ctx.set(dut.frame_start, 1)
        assert ctx.get(dut.lut.swap)
        await ctx.tick()
        assert not ctx.get(dut.lut.swap), "a second swap"
        ctx.set(dut.frame_start, 0)
        assert in_force() == after
        assert ctx.get(dut.generation) == 0xBEEF
        for name, value in after.items():
            assert await host.read(name) == (CODES.DONE, value)
        assert await host.read("pending") == (CODES.DONE, 0)
        await host.frame()
        assert in_force() == after

    run(test)


@pytest.mark.parametrize("name", ["floor", "lut_hue"])
def test_writing_while_a_commit_waits_withdraws_it(name):
    async def test(host):
        await host.write("weight_r", -3)
        await host.write("commit", 1)
        await host.write(name, 7)
        assert await host.read("pending") == (CODES.DONE, 0)
        await host.frame()
        assert await host.read("weight_r") == (CODES.DONE, 85)
        assert await host.read("generation") == (CODES.DONE, 0)
        await host.write("commit", 2)
        await host.frame()
        assert await host.read("weight_r") == (CODES.DONE, -3)
        assert await host.read("generation") == (CODES.DONE, 2)

    run(test)


def test_a_refused_write_does_not_withdraw_a_commit():
    async def test(host):
        await host.write("commit", 1)
        assert (await host.write("floor", 256))[0] is CODES.OUT_OF_RANGE
        assert await host.read("pending") == (CODES.DONE, 1)

    run(test)


def test_a_frame_may_start_in_any_clock_of_a_commit():
    """Either the whole of the settings is in force afterwards, with its generation, or nothing of it."""
    for delay in range(12):

        async def test(host, delay=delay):
            ctx, dut = host.ctx, host.dut
            await host.write("floor", 77)
            await host.write("weight_g", -77)
            frame = {"sequence": 1, "write": 1, "address": register("commit").address, "value": 9, "refusal": 0}
            ctx.set(dut.command.payload, frame)
            ctx.set(dut.command.valid, 1)
            ctx.set(dut.answer.ready, 1)
            for clock in range(16):
                ctx.set(dut.frame_start, clock == delay)
                ctx.set(dut.command.valid, clock == 0)
                await ctx.tick()
            state = (ctx.get(dut.frame.floor), ctx.get(dut.frame.weight_g), ctx.get(dut.generation))
            assert state in [(77, -77, 9), (20, 86, 0)]
            assert (await host.read("pending"))[1] == (state[2] == 0)

        run(test)


def test_gate_tables_are_written_word_by_word():
    rng = random.Random(2)

    async def test(host):
        seen = []
        for axis, name in enumerate(("lut_hue", "lut_luminance", "lut_saturation")):
            for word in range(protocol.LUT_WORDS):
                value = rng.randrange(1 << 32)
                seen.append((axis, word, value))
                code, _ = await host.command(register(name).address + word, value, write=1)
                assert code is CODES.DONE
        assert writes == seen

    writes = []
    dut = RegisterFile(FEATURES)

    async def watch(ctx):
        while True:
            _, _, valid, *write = await ctx.tick().sample(dut.lut.valid, dut.lut.axis, dut.lut.word, dut.lut.data)
            if valid:
                writes.append(tuple(write))

    async def testbench(ctx):
        await test(Host(ctx, dut))

    simulate(dut, testbench, watch, clocks=2000)


def test_only_tables_that_were_written_are_exchanged():
    """Also where a commit is withdrawn, and where frames come without one."""
    swaps = []
    dut = RegisterFile(FEATURES)

    async def watch(ctx):
        while True:
            _, _, swap, written = await ctx.tick().sample(dut.lut.swap, dut.lut.written)
            if swap:
                swaps.append(written)

    async def testbench(ctx):
        host = Host(ctx, dut)

        async def frame():
            await host.frame()
            await ctx.tick()

        await host.write("commit", 1)
        await frame()
        assert swaps == [0]
        await host.write("lut_luminance", 5)
        await frame()
        await host.write("commit", 2)
        await host.write("lut_hue", 5)  # withdraws it
        await frame()
        assert swaps == [0]
        await host.write("commit", 3)
        await frame()
        assert swaps == [0, 0b011]
        await host.write("floor", 5)
        await host.write("commit", 4)
        await frame()
        assert swaps == [0, 0b011, 0]
        await host.write("lut_saturation", 5)
        await host.write("commit", 5)
        await frame()
        assert swaps == [0, 0b011, 0, 0b100]

    simulate(dut, testbench, watch, clocks=3000)


@pytest.mark.parametrize("seed", range(2))
def test_what_is_read_is_in_force(seed):
    """Random writes, commits and frames, often in the same clocks: registers and what hardware sees agree."""
    print("seed", seed)
    rng = random.Random(seed)
    settings = [r for r in REGISTERS if r.scope is Scope.FRAME and r.access is Access.BOTH]
    dut = RegisterFile(FEATURES)

    async def frames(ctx):
        while True:
            for _ in range(rng.choice([1, 7, 11, 30, 200])):
                await ctx.tick()
            ctx.set(dut.frame_start, 1)
            await ctx.tick()
            ctx.set(dut.frame_start, 0)

    async def testbench(ctx):
        host = Host(ctx, dut)
        shadow = {r.name: r.init for r in settings}
        commits = {0: dict(shadow)}  # by generation
        for generation in range(1, 60):
            for _ in range(rng.choice([0, 0, 1, 4])):
                one = rng.choice(settings)
                value = rng.choice(values_of(one))
                assert (await host.write(one.name, value))[0] is CODES.DONE
                shadow[one.name] = value
            await host.write("commit", generation)
            commits[generation] = dict(shadow)
            for _ in range(rng.choice([0, 1, 3])):
                one = rng.choice(settings)
                before = ctx.get(dut.generation)
                _, value = await host.read(one.name)
                assert value in {commits[n][one.name] for n in (before, ctx.get(dut.generation))}
            now = ctx.get(dut.frame)
            assert {r.name: now[r.name] for r in settings} == commits[ctx.get(dut.generation)]

    simulate(dut, testbench, frames, clocks=100_000)


def test_reset_brings_back_what_is_read():
    """The memory behind the registers is not reset by itself."""
    dut = RegisterFile(FEATURES)
    reset = Signal()

    async def testbench(ctx):
        host = Host(ctx, dut)
        for name, value in (("floor", 99), ("motor_period", 77)):
            await host.write(name, value)
        await host.write("commit", 1)
        await host.frame()
        assert (await host.read("floor"), await host.read("motor_period")) == ((CODES.DONE, 99), (CODES.DONE, 77))
        ctx.set(reset, 1)
        await ctx.tick()
        ctx.set(reset, 0)
        for r in REGISTERS:
            if r.access is Access.BOTH:
                assert await host.read(r.name) == (CODES.DONE, r.init)
        await host.write("commit", 1)
        await host.frame()
        assert await host.read("floor") == (CODES.DONE, register("floor").init)

    simulate(ResetInserter(reset)(dut), testbench, clocks=5000)


@pytest.mark.parametrize(
    ("name", "without", "value"),
    [
        ("ambient_mode", {"background_cells": 0}, 1),
        ("isolate", {"isolate": False}, 1),
        ("centroid_window", {"window": False}, 1),
        ("motor_mode", {"speed_loop": False}, 2),
        ("motor_watch", {"speed_loop": False}, 1),
        ("laser_conditions", {"speed_loop": False}, 1),
        ("snapshot", {"snapshot": False}, 1),
    ],
)
def test_what_is_not_built_is_out_of_range(name, without, value):
    dut = RegisterFile(Features(**without))

    async def testbench(ctx):
        host = Host(ctx, dut)
        least = min(register(name).init, value - 1)
        assert await host.read(name) == (CODES.DONE, least)
        assert await host.write(name, value) == (CODES.OUT_OF_RANGE, least)
        assert (await host.write(name, least))[0] is CODES.DONE
        _, built = await host.read("features")
        assert built == 0x3FF & ~sum(1 << n for n, feature in enumerate(protocol.FEATURES) if feature in without)

    simulate(dut, testbench, clocks=2000)


def test_without_runs_only_the_paper_s_detector_and_no_grey_values():
    """All other settings of the runs can be set: they make no difference."""
    dut = RegisterFile(
        Features(background_cells=0, isolate=False, window=False, runs=False, snapshot=False, edge_log=False)
    )

    async def testbench(ctx):
        host = Host(ctx, dut)
        _, built = await host.read("features")
        assert not built >> protocol.FEATURES.index("runs") & 1
        for name, only in (("detector", protocol.Detector.BINARY), ("floor", 255)):
            assert await host.read(name) == (CODES.DONE, only)
            assert (await host.write(name, only))[0] is CODES.DONE
            assert await host.write(name, 1) == (CODES.OUT_OF_RANGE, only)
        for name in ("weight_r", "run_reach", "choice", "ambiguous_ratio", "run_width_max"):
            assert (await host.write(name, 3))[0] is CODES.DONE
        await host.write("commit", 1)
        await host.frame()
        assert (ctx.get(dut.frame.detector), ctx.get(dut.frame.floor)) == (0, 255)
        assert await host.read("run_width_max") == (CODES.DONE, 3)

    simulate(dut, testbench, clocks=3000)


@pytest.mark.parametrize(
    ("name", "feature", "only"),
    [
        ("form", "full_rows", 0),
        ("counts_per_turn", "turn_check", 0),
        ("motor_period", "pwm_period", 1024),
        ("exposure_us", "notes", 0),
        ("time_offset_ns", "notes", 0),
    ],
)
def test_what_can_only_have_one_value_has_it(name, feature, only):
    dut = RegisterFile(Features(**{feature: False}))

    async def testbench(ctx):
        host = Host(ctx, dut)
        assert await host.read(name) == (CODES.DONE, only)
        for value in (only + 1, only - 1 if only or register(name).signed else 2):
            assert await host.write(name, value & 0xFFFF_FFFF) == (CODES.OUT_OF_RANGE, only)
        assert (await host.write(name, only))[0] is CODES.DONE

    simulate(dut, testbench, clocks=3000)


def test_arming_is_a_strobe_with_the_key():
    dut = RegisterFile(FEATURES)
    strobes = []

    async def watch(ctx):
        while True:
            _, _, arm, key = await ctx.tick().sample(dut.arm, dut.arm_key)
            if arm:
                strobes.append(key)

    async def testbench(ctx):
        host = Host(ctx, dut)
        assert await host.write("laser_arm", protocol.LASER_KEY) == (CODES.DONE, 0)
        assert await host.read("laser_arm") == (CODES.NOT_ALLOWED, 0)
        assert await host.write("laser_arm", 0) == (CODES.DONE, 0)
        assert await host.write("laser_arm", 0x10000) == (CODES.OUT_OF_RANGE, 0)

    simulate(dut, testbench, watch, clocks=1000)
    assert strobes == [protocol.LASER_KEY, 0]


@pytest.mark.parametrize("refusal", [CODES.UNKNOWN_TYPE, CODES.MALFORMED])
def test_a_refused_command_is_answered_and_does_nothing(refusal):
    async def test(host):
        assert await host.command(register("floor").address, 5, write=1, refusal=refusal) == (refusal, 0)
        await host.write("commit", 1)
        await host.frame()
        assert await host.read("floor") == (CODES.DONE, 20)

    run(test)
