"""The serial line: what is sent arrives, for clocks that differ as much as they may."""

import random
from fractions import Fraction

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import connect

from gateware.link.uart import _PHASE_BITS, ROOM, Uart, UartReceiver, UartTransmitter
from tests.support.simulation import simulate
from tests.support.streams import receive, send

DATA = bytes([0x00, 0xFF, 0x55, 0xAA, 0x01, 0x80, 0x7F, 0xFE])


def line(data, bit_clocks, *, start=Fraction(0)):
    """Level of the line at each clock: bits of ``bit_clocks``, the first start bit at ``start``."""
    levels = [level for byte in data for level in [0, *(byte >> n & 1 for n in range(8)), 1]]
    end = start + len(levels) * bit_clocks
    clock = 0
    while clock < end:
        at = int((clock - start) // bit_clocks) if clock >= start else -1
        yield levels[at] if at >= 0 else 1
        clock += 1


def counted(dut, levels, *, take):
    """Bytes taken and errors counted when ``levels`` come."""
    got = bytearray()
    errors = 0

    async def drive(ctx):
        nonlocal errors
        ctx.set(dut.o.ready, take)
        for level in levels:
            ctx.set(dut.rx, level)
            _, _, valid, payload = await ctx.tick().sample(dut.o.valid, dut.o.payload)
            if valid and take:
                got.append(payload)
        errors = ctx.get(dut.errors)

    simulate(dut, drive, clocks=len(levels) + 10)
    return bytes(got), errors


BIT = 1 << _PHASE_BITS  # of phase
STEPS = [BIT // 4, BIT * 100 // 417, BIT // 8, BIT * 10 // 97, BIT // 13, 80313, 48321, BIT // 434, 104]


def sampled(step):
    """The clock around which each of the ten bits is read, from the first low one on; for an array of steps too."""
    return -((step // 2 - (2 * np.arange(10)[:, None] + 1) * (BIT // 2)) // step)


def changed(step, bits):
    """The clock in which the transmitter puts each of the bits on the line, from its start bit's on."""
    return -(-bits[:, None] * BIT // step)


@pytest.mark.parametrize("step", STEPS)
def test_bits_are_read_when_the_formula_says(step):
    # Each bit is high for two clocks only, of which the formula's is one: the other is that before, and that after.
    dut = UartReceiver(BIT, step)
    assert dut.step == step
    clocks = sampled(np.array([step]))[1:, 0]
    for neighbour in (-1, 1):
        levels = np.zeros(clocks[-1] + 30, int)
        levels[clocks] = levels[clocks + neighbour] = 1
        levels[clocks[-1] + 3 :] = 1
        assert counted(dut, [1] * 8 + levels.tolist(), take=True) == (b"\xff", 0)


@pytest.mark.parametrize("step", STEPS)
def test_bits_are_sent_when_the_formula_says(step):
    dut = UartTransmitter(BIT, step)
    levels = []

    async def watch(ctx):
        while True:
            levels.append((await ctx.tick().sample(dut.tx))[2])

    async def drive(ctx):
        await send(ctx, dut.i, b"\x55\x55")
        await ctx.tick().repeat(10 * BIT // step + 20)

    simulate(dut, drive, watch, clocks=30 * BIT // step + 100)
    first, *_ = edges = np.flatnonzero(np.diff(levels))
    bits = changed(np.array([step]), np.arange(11))[:, 0]
    assert (edges - first).tolist() == [*bits[:10], *(bits[10] + bits[:10])]


@pytest.mark.parametrize(
    ("least", "below", "slowest", "fastest"),
    [
        (4, 8, Fraction(987, 1000), Fraction(1013, 1000)),
        (8, 13, Fraction(967, 1000), Fraction(1033, 1000)),
        (13, 10_000, Fraction(98, 102), Fraction(102, 98)),
    ],
)
def test_every_rate_has_the_tolerance(least, below, slowest, fastest):
    """For each step there is: every bit is read within it, whatever the phase of the two clocks.

    The line falls less than a clock before the receiver's first low one, which is clock 0. A bit whose middle sample
    is its own has the majority. ``slowest`` and ``fastest`` bound the receiver's clocks in one of the sender's; what
    lies between follows, for all is linear in it.
    """
    step = np.arange(BIT // below + 1, BIT // least + 1)
    read = sampled(step)
    begin = changed(step, np.arange(10))  # of each bit, after the start bit's own edge
    end = changed(step, np.arange(1, 11))
    assert (fastest.denominator * read[1:] >= fastest.numerator * begin[1:]).all()  # that edge at clock 0
    assert (slowest.numerator * end >= slowest.denominator * (read + 1)).all()  # that edge just after clock -1


def test_the_rates_have_no_more_than_they_need():
    step = np.arange(BIT // 10_000 + 1, BIT // 13 + 1)
    assert (100 * sampled(step)[1:] < 105 * changed(step, np.arange(1, 10))).any()


@pytest.mark.parametrize(
    ("clocks_per_bit", "percent"),
    [("4.17", "1.3"), ("9.7", "3.3"), ("13", "4"), ("21.7", "4")],
)
@pytest.mark.parametrize("sign", [-1, 1])
def test_receives_from_a_sender_of_exact_bits(clocks_per_bit, percent, sign):
    nominal = Fraction(clocks_per_bit)
    sent = nominal * (1 + sign * Fraction(percent) / 100)
    dut = UartReceiver(clock_hz=round(nominal * 1_000_000), baud=1_000_000)
    for eighth in range(8):
        levels = [1] * 8 + list(line(DATA, sent, start=Fraction(eighth, 8))) + [1] * 40
        assert counted(dut, levels, take=True) == (DATA, 0)


class Loop(wiring.Component):
    """A transmitter whose line leads to a receiver of another clock rate."""

    def __init__(self, send_hz, receive_hz, baud):
        self.transmitter = UartTransmitter(send_hz, baud)
        self.receiver = UartReceiver(receive_hz, baud)
        super().__init__({"i": self.transmitter.signature.members["i"], "o": self.receiver.signature.members["o"]})

    def elaborate(self, platform):
        m = Module()
        m.submodules.transmitter = self.transmitter
        m.submodules.receiver = self.receiver
        connect(m, self.transmitter.i, wiring.flipped(self.i))
        connect(m, wiring.flipped(self.o), self.receiver.o)
        m.d.comb += self.receiver.rx.eq(self.transmitter.tx)
        return m


@pytest.mark.parametrize("percent", [-4, -2, 0, 2, 4])
def test_receiver_takes_what_the_transmitter_sends(percent):
    dut = Loop(13_000_000, 13_000_000 * (100 + percent) // 100, 1_000_000)
    data = bytes(random.Random(7).randrange(256) for _ in range(60))
    got = bytearray()

    async def source(ctx):
        await send(ctx, dut.i, data)

    async def sink(ctx):
        got.extend(await receive(ctx, dut.o, len(data)))

    simulate(dut, sink, source, clocks=200 * len(data))
    assert got == data


def test_a_missing_stop_bit_is_counted_and_the_line_must_rise_first():
    good = list(line(b"\x3c", 10))
    assert counted(
        UartReceiver(10_000_000, 1_000_000), [1] * 8 + [0] * 300 + [1] * 30 + good + [1] * 30, take=True
    ) == (b"\x3c", 1)


def test_a_short_pulse_is_no_start_bit():
    levels = [1] * 8 + [0] * 3 + [1] * 30 + [0] + [1] * 30 + list(line(b"\x3c", 10)) + [1] * 30
    assert counted(UartReceiver(10_000_000, 1_000_000), levels, take=True) == (b"\x3c", 0)


def test_a_spike_in_a_bit_does_not_matter():
    levels = [1] * 8 + list(line(b"\x5a", 10)) + [1] * 30
    for at in range(22, 105):  # after the start bit's edge
        spiked = levels.copy()
        spiked[at] ^= 1
        assert counted(UartReceiver(10_000_000, 1_000_000), spiked, take=True) == (b"\x5a", 0), at


def test_a_byte_that_is_not_taken_costs_the_next():
    dut = UartReceiver(10_000_000, 1_000_000)
    assert counted(dut, [1] * 8 + list(line(b"abc", 10)) + [1] * 30, take=False) == (b"", 2)


@pytest.mark.parametrize(("uart", "least"), [(UartTransmitter, 3), (UartReceiver, 4), (Uart, 4)])
def test_too_fast_a_rate_is_refused(uart, least):
    uart(least * 1_000_000, 1_000_000)
    with pytest.raises(ValueError, match="baud is 1e\\+06"):
        uart(least * 1_000_000 - 1, 1_000_000)


def test_flow_control_loses_nothing_though_nobody_takes_the_bytes_for_long():
    dut = Uart(4_000_000, 1_000_000, flow_control=True)
    data = bytes(random.Random(3).randrange(256) for _ in range(100))
    got, late = bytearray(), 0

    async def source(ctx):
        nonlocal late
        late_left = ROOM  # an adapter goes on for so long
        for byte in data:
            while not ctx.get(dut.rts) and late_left == 0:
                await ctx.tick()
            late_left = ROOM if ctx.get(dut.rts) else late_left - 1
            for level in line([byte], 4):
                ctx.set(dut.rx, level)
                await ctx.tick()

    async def sink(ctx):
        while len(got) < len(data):
            await ctx.tick().repeat(1500)
            assert not ctx.get(dut.rts) or len(got) > len(data) - 2 * ROOM
            got.extend(await receive(ctx, dut.o, 15))
            if len(data) - len(got) < 15:
                got.extend(await receive(ctx, dut.o, len(data) - len(got)))

    simulate(dut, sink, source, clocks=100_000)
    assert got == data


def test_nothing_is_sent_while_the_other_end_is_not_ready():
    dut = Uart(4_000_000, 1_000_000, flow_control=True)
    times = []

    async def watch(ctx):
        clock, before = 0, 1
        while True:
            now = (await ctx.tick().sample(dut.tx))[2]
            if before and not now:
                times.append(clock)
            before, clock = now, clock + 1

    async def drive(ctx):
        ctx.set(dut.i.payload, 0xFF)  # a start bit is the only falling edge
        ctx.set(dut.i.valid, 1)
        await ctx.tick().repeat(500)
        ctx.set(dut.cts, 1)
        await ctx.tick().repeat(100)
        ctx.set(dut.cts, 0)
        await ctx.tick().repeat(500)

    simulate(dut, drive, watch)
    assert times[0] >= 500
    assert len(times) in (3, 4)  # a byte is 40 clocks; one that has begun is completed
    assert times[-1] < 605


def test_without_flow_control_its_lines_mean_nothing():
    dut = Uart(4_000_000, 1_000_000)
    got = bytearray()

    async def drive(ctx):
        assert ctx.get(dut.rts)
        await send(ctx, dut.i, b"x")

    async def loop(ctx):
        while True:
            ctx.set(dut.rx, (await ctx.tick().sample(dut.tx))[2])

    async def sink(ctx):
        got.extend(await receive(ctx, dut.o, 1))

    simulate(dut, sink, drive, loop, clocks=200)
    assert got == b"x"
