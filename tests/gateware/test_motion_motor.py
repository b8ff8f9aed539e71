"""The motor's program in its hardware: what is sampled, what comes out, and when it counts."""

import random
from functools import cache
from itertools import pairwise

from gateware.motion.assembly import Op
from gateware.motion.motor import SETTINGS_BASE, MotorControl, motor_program
from gateware.motion.sector import Sector
from gateware.motion.sequencer import Variable
from gateware.motion.speed import Measured, SpeedMeter
from magtrak.protocol import MotorCause, MotorMode, register
from tests.support.trace import trace

CLOCK_HZ = 2_000_000
MILLISECOND = 1900
EDGE = 130
OUTPUTS = ("sampled", "speed", "state", "cause", "pwm", "brake", "write.ready")


def test_a_millisecond_and_an_edge_take_no_longer_than_stated():
    """The longest way through the program, whatever the numbers: it only ever goes on."""
    p = motor_program()

    @cache
    def longest(place: int, tick: bool) -> int:
        one = p.instructions[place]
        if one.op is Op.WAIT:
            return 0
        ways = [place + 1]
        if one.op is Op.JUMP:
            there = p.labels[str(one.operand)]
            assert there > place or p.instructions[there].op is Op.WAIT
            ways = [there] if one.flag == "always" else [there, place + 1]
            if one.flag == "tick":
                ways = [there if tick != one.unless else place + 1]
        clocks = one.steps * (2 if one.op is Op.DIVIDE else 1)
        return 2 + clocks + max(longest(way, tick) for way in ways)

    begin = p.labels["wait"] + 1
    times = [longest(begin, tick) for tick in (True, False)]
    print(f"{times} clocks")
    assert MILLISECOND - 200 < times[0] < MILLISECOND
    assert EDGE - 20 < times[1] < EDGE


def written(values):
    """Clocks that write the program's variables."""
    clocks = [{"write.valid": 0}] * 700  # the start writes them, too
    for name, value in values.items():
        payload = {"address": register(name).address - SETTINGS_BASE, "value": value}
        write = {"write.valid": 1, "write.payload": Variable.const(payload).as_value().value}
        clocks += [write, {"write.valid": 0}, {}, {}]
    return clocks


def shaft(rng, clocks, gap):
    """Count, direction and age of a shaft that now and then turns round."""
    count, backward, age, way = 0, 0, (1 << 32) - 1, 1
    for _ in range(clocks):
        age = min(age + 1, (1 << 32) - 1)
        edge = rng.random() < 1 / gap and age > 20
        if edge:
            way = -way if rng.random() < 0.02 else way
            count, backward, age = count + way, int(way < 0), 0
        yield {"count": count, "backward": backward, "age": age, "edge": int(edge)}


def test_speed_band_and_sector_are_those_of_the_definitions():
    rng = random.Random(seed := 5)
    print(f"seed {seed}")
    settings = {"counts_per_turn": 100, "sector_low": 10, "sector_high": 60, "speed_low": 256 * 5000}
    settings |= {"motor_speed": 256 * 9000, "motor_acceleration": 256 * 700, "motor_kp": 1 << 18, "motor_ki": 1 << 14}
    begin = written(settings)
    always = {"clock_hz": CLOCK_HZ, "settings.motor_mode": MotorMode.SPEED}
    always |= {"settings.motor_period": 64, "settings.motor_watch": 0}
    stimulus = [always | {"seen": 1, "zero_count": -3, "alive": 1}, *begin]
    first = len(stimulus)
    for number, state in enumerate(shaft(rng, 12 * 2000, 180)):
        stimulus.append(state | {"time": number, "tick": int(number % 2000 == 1999)})
    got = trace(MotorControl(), stimulus, OUTPUTS)
    ticks = [first + number for number in range(1999, 12 * 2000, 2000)]
    samples = [clock for clock, sampled in enumerate(got["sampled"]) if sampled and clock >= first]
    now, lit = Measured(), set()
    for sample, after in pairwise(samples):
        inputs = stimulus[sample]
        inside = Sector.reference(inputs["count"] + 3, True, 100, 10, 60)
        ticked = any(sample - EDGE <= tick < sample for tick in ticks)
        if ticked:
            now = SpeedMeter.reference(
                now,
                time=inputs["time"],
                count=inputs["count"],
                backward=bool(inputs["backward"]),
                age=inputs["age"],
                clock_hz=CLOCK_HZ,
            )
            assert after - sample < MILLISECOND
            assert got["speed"][after] == now.speed
        band = abs(now.speed) >= settings["speed_low"]
        if after - sample >= 40:
            state = got["state"][after]
            assert (state >> 3 & 1, state >> 2 & 1) == (inside, band), sample
            lit.add((inside, band))
    assert len(lit) >= 3 and now.speed
    assert any(got["pwm"])


def test_a_mode_that_is_written_anew_starts_the_motor_anew():
    """A fault stops it until the mode is off; what the program found about the time before counts for nothing."""
    begin = written({"motor_stall_ms": 1, "motor_duty": 10_000})
    drive = {"settings.motor_mode": MotorMode.DUTY, "settings.motor_duty": 10_000, "settings.motor_period": 64}
    start = {"clock_hz": CLOCK_HZ, "alive": 1, "settings.motor_watch": 31}
    tick = [{"tick": 1}, *[{"tick": 0}] * 1000]
    stimulus = [start, *begin, drive, *tick, *tick, *tick, *tick]
    stopped = len(stimulus)
    stimulus += [*tick, {"settings.motor_mode": MotorMode.OFF}, {}, {"settings.motor_mode": MotorMode.DUTY}, {}, *tick]
    got = trace(MotorControl(), stimulus, OUTPUTS)
    assert got["state"][stopped] & 1 and got["cause"][stopped] == MotorCause.STALL and got["brake"][stopped]
    assert not got["state"][-1] & 1 and got["cause"][-1] == 0 and not got["brake"][-1]
    assert any(got["pwm"][len(begin) : stopped]) and any(got["pwm"][-200:])
