"""All of motion together: one time for edges, index and rows."""

import math
import random

import pytest

from gateware.features import Features
from gateware.motion import Motion
from gateware.motion.angle import AngleLatch, EdgeLog
from gateware.motion.index import Index
from gateware.motion.quadrature import Quadrature
from magtrak.protocol import EDGE, LASER_KEY, MAX_EDGES, MotorMode
from tests.support.motion import PHASES, barrier, bounce, encoder, wander
from tests.support.trace import trace

STAMP = ("time", "count", "age", "period")
LATCHES = [f"{latch}.{name}" for latch in ("first", "last") for name in STAMP]


@pytest.mark.parametrize("length", [0, 1, 3, 20, 255])
@pytest.mark.parametrize("early", [-1, 0, 1])
def test_edge_next_to_a_row(length, early):
    """An edge one clock before the row, with it, or one clock after: in the latch as its time says."""
    row = 600
    stimulus = [{"row_first": 0, "frame_first": 0} for _ in range(row + 300)]
    stimulus[0] |= {"settings.encoder_filter": length}
    for number, clock in enumerate((100, 350, row - early)):
        stimulus[clock] |= dict(zip(("encoder_a", "encoder_b"), PHASES[number + 1], strict=True))
    stimulus[row] |= {"row_first": 1, "frame_first": 1}
    got = trace(Motion(), stimulus, LATCHES)
    want = {
        -1: {"time": row, "count": 2, "age": 250, "period": 250},
        0: {"time": row, "count": 3, "age": 0, "period": 250},
        1: {"time": row, "count": 3, "age": 1, "period": 249},
    }[early]
    for latch in ("first", "last"):
        assert {name: got[f"{latch}.{name}"][row + Motion.latency(length)] for name in STAMP} == want
        assert got[f"{latch}.count"][row + Motion.latency(length) - 1] == 0, "the latch is not early"


@pytest.mark.parametrize("length", [0, 2, 3, 9, 40])
def test_images_of_a_random_shaft(length):
    """Latches, log, index and faults of image after image are those of the pins at the strobes' times."""
    rng = random.Random(seed := 7 + length)
    print(f"seed {seed}")
    clocks, period = 7000, 500
    turn = 40
    positions = wander(rng, clocks, 9.2, min(0.24, 0.8 / max(length, 1)), *((-60, 100) if length < 10 else (6, 15)))
    a, b = (bounce(rng, pin, max(length // 2, 1)) for pin in zip(*map(encoder, positions), strict=True))
    level = bounce(rng, [barrier(position, 10.5, 9, turn) for position in positions], max(length // 2, 1))
    for _ in range(2):  # a jump of half a cycle, seen as illegal where it lasts
        start = rng.randrange(1000, clocks - 1000)
        for clock in range(start, start + 2 * max(length, 1)):
            a[clock], b[clock] = 1 - a[clock], 1 - b[clock]
    rows = {start + 48 * row: row for start in range(120, clocks - period, period) for row in range(6)}
    takes = [clock + rng.randrange(1, 60) for clock, row in rows.items() if row == 5]

    latency = Motion.latency(length)
    stimulus = [
        {
            "encoder_a": a[clock],
            "encoder_b": b[clock],
            "index": level[clock],
            "row_first": clock in rows,
            "frame_first": rows.get(clock) == 0,
            "take": clock in takes,
            "edge_index": clock % MAX_EDGES,
        }
        for clock in range(clocks)
    ]
    stimulus[0] |= {"settings.encoder_filter": length, "settings.counts_per_turn": turn}
    log = ("taken", "edges", "edge_shift", "edge")
    rest = ("index_count", "index_time", "index_passes", "encoder_errors.illegal", "encoder_errors.turns")
    got = trace(Motion(), stimulus, [*LATCHES, *log, *rest, "encoder_fault"])
    assert [clock for clock, taken in enumerate(got["taken"]) if taken] == [
        take + latency for take in takes if take + latency < clocks
    ]

    moves = list(Quadrature.reference(a, b, length))
    passes = list(Index.reference(level, moves, length, False, turn))
    errors = sorted([m.time for m in moves if m.illegal])
    assert len(moves) > (150 if length < 10 else 20) and passes and errors
    begin = 0
    for take in takes:
        at = take + latency
        shown = [time for time in rows if time <= take]
        last, first = shown[-1], [time for time in shown if rows[time] == 0][-1]
        for latch, time in (("first", first), ("last", last)):
            assert {name: got[f"{latch}.{name}"][at] for name in STAMP} == AngleLatch.reference(time, moves)
        shift, entries = EdgeLog().reference([move for move in moves if move.time >= begin], take)
        assert (got["edges"][at], got["edge_shift"][at]) == (len(entries), shift)
        for clock in range(at + 1, at + 1 + MAX_EDGES):
            index = (clock - 1) % MAX_EDGES
            if index < len(entries):
                assert EDGE.unpack(got["edge"][clock].to_bytes(EDGE.size, "little")) == entries[index]
        if any(begin <= time < take for time in errors):
            assert got["encoder_fault"][at]
        elif not got["encoder_errors.turns"][at]:
            assert not got["encoder_fault"][at]
        begin = take
    assert got["index_count"][-1] == passes[-1].count and got["index_time"][-1] == passes[-1].time
    assert got["index_passes"][-1] == len(passes)
    assert got["encoder_errors.illegal"][-1] == len([time for time in errors if time < clocks - latency])
    assert got["encoder_errors.turns"][-1] == sum(bool(p.difference) for p in passes)


def test_wrong_turn_is_a_fault_of_its_image_only():
    positions = [10 + clock / 10 for clock in range(2000)]
    a, b = zip(*map(encoder, positions), strict=True)
    takes = (500, 1000, 1500, 1900)
    stimulus = [
        {"encoder_a": a[c], "encoder_b": b[c], "index": barrier(positions[c], 30.5, 9, 50), "take": c in takes}
        for c in range(2000)
    ]
    stimulus[0] |= {"settings.encoder_filter": 3, "settings.counts_per_turn": 51}
    stimulus[1000] |= {"settings.counts_per_turn": 50}
    got = trace(Motion(), stimulus, ["encoder_fault", "encoder_errors.turns"])
    assert [got["encoder_fault"][take + Motion.latency(3)] for take in takes] == [0, 1, 0, 0]
    assert got["encoder_errors.turns"][-1] == 1
    assert math.floor(positions[1000]) > 80, "the first check has happened"


def test_swap_and_invert_move_nothing():
    """Writing them in operation is neither an edge nor a pass."""
    stimulus = [{"encoder_a": 1, "index": 0, "settings.encoder_filter": 3} for _ in range(400)]
    stimulus[100] |= {"settings.encoder_swap": 1}
    stimulus[200] |= {"settings.index_invert": 1}
    for clock in range(300, 400):
        stimulus[clock] |= {"encoder_b": 1}
    got = trace(Motion(), stimulus, ["count", "index_passes", "encoder_errors.illegal"])
    assert (
        got["count"][299] == 0
        and got["count"][-1] == -1
        and not any(got["index_passes"])
        and not any(got["encoder_errors.illegal"])
    )


@pytest.mark.parametrize("speed_loop", [True, False])
def test_motor_pins(speed_loop):
    drive = {"settings.motor_mode": MotorMode.DUTY, "settings.motor_period": 64, "settings.motor_duty": -16384}
    stimulus = [dict(drive) for _ in range(600)]
    stimulus[400]["settings.motor_brake"] = 1
    got = trace(Motion(Features(speed_loop=speed_loop)), stimulus, ["pwm", "direction", "brake"])
    assert sum(got["pwm"][208:400]) == 96 and all(got["direction"][208:400])
    assert got["brake"] == [0] * 401 + [1] * 199 and not any(got["pwm"][401:])


def test_without_the_program_the_motor_runs_out_in_other_modes_and_settings_are_taken():
    stimulus = [{"settings.motor_period": 64, "settings.motor_duty": 16384, "write.valid": 1} for _ in range(700)]
    for clock, mode in ((0, MotorMode.DUTY), (200, MotorMode.OFF), (300, MotorMode.SPEED)):
        stimulus[clock]["settings.motor_mode"] = mode
    stimulus[500]["settings.motor_mode"] = MotorMode.DUTY
    got = trace(Motion(Features(speed_loop=False)), stimulus, ["pwm", "write.ready", "safety", "speed"])
    assert any(got["pwm"][:200]) and not any(got["pwm"][201:300]) and not any(got["pwm"][450:500])
    assert any(got["pwm"][500:]) and all(got["write.ready"])
    assert not any(safety >> 16 for safety in got["safety"]) and not any(got["speed"])


def test_laser_pins_and_the_image_they_light():
    """Armed by the key, on after the delay; an image is lit whole, or it is not."""
    stimulus = [{"frame_first": 0, "arm": 0, "renew": 0, "interlock": 1} for _ in range(400)]
    stimulus[0] |= {"clock_hz": 10_000, "settings.laser_lease_ms": 1000, "settings.laser_delay_ms": 2}
    stimulus[20] |= {"arm": 1, "arm_key": LASER_KEY, "renew": 1}
    for clock in (30, 100, 200, 300):
        stimulus[clock]["frame_first"] = 1
    stimulus[250]["interlock"] = 0
    got = trace(Motion(), stimulus, ["laser", "lamp", "laser_on_whole_frame", "laser_state", "laser_cause"])
    on = got["laser"].index(1)
    assert 20 + 20 < on <= 20 + 31
    assert got["laser"] == [0] * on + [1] * (250 - on) + [0] * 150
    assert not any(got["lamp"][:21]) and all(got["lamp"][21:250])
    whole = got["laser_on_whole_frame"]
    assert (whole[99], whole[199], whole[299], whole[399]) == (0, 1, 0, 0)
    assert got["laser_state"][240] == 0b111111 and got["laser_state"][-1] == 0b111100
    assert got["laser_cause"][-1] == 2
