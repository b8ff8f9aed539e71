"""The laser's conditions, one at a time and all at once; and the millisecond behind them."""

import random
from itertools import pairwise

import pytest

from gateware.motion.interlock import SYNCHRONISER_STAGES, Arming, Interlock
from gateware.motion.milliseconds import Milliseconds
from magtrak.protocol import LASER_KEY, LaserCause
from tests.support.trace import trace

OUTPUTS = ("laser", "lamp", "cause", "state.emitting", "state.armed", "state.closed", "state.alive", "state.permitted")
IDLE = {"interlock": 1, "tick": 0, "arm": 0, "key": 0, "renew": 0}
IDLE |= {"lease_ms": 10, "delay_ms": 3, "sound": 1, "permitted": 1}


def check(stimulus):
    """The outputs, compared with the definition and with the conditions that must hold while the laser is on."""
    stimulus = [IDLE | values for values in stimulus]
    got = trace(Interlock(), stimulus, OUTPUTS)
    now = Arming()
    closed = [0] * SYNCHRONISER_STAGES + [values["interlock"] for values in stimulus]
    silent, alive = None, [False] * 3
    for clock, values in enumerate(stimulus):
        laser = now.emitting and now.permitted and all(closed[clock : clock + SYNCHRONISER_STAGES + 1])
        assert (got["laser"][clock], got["lamp"][clock]) == (laser, now.armed), clock
        assert got["state.emitting"][clock] == (now.emitting and now.permitted and closed[clock]), clock
        assert (got["state.armed"][clock], got["state.alive"][clock]) == (now.armed, now.alive), clock
        assert got["state.closed"][clock] == closed[clock]
        assert got["cause"][clock] == now.cause, clock
        if got["laser"][clock]:
            assert values["interlock"] and got["lamp"][clock] and any(alive[-3:])
            assert clock and stimulus[clock - 1]["sound"] and stimulus[clock - 1]["permitted"]
        silent = 0 if values["renew"] else None if silent is None else silent + values["tick"]
        alive.append(values["renew"] or (silent is not None and silent < values["lease_ms"]))
        now = Interlock.reference(
            now,
            closed=bool(closed[clock]),
            tick=bool(values["tick"]),
            key=values["key"] if values["arm"] else None,
            renew=bool(values["renew"]),
            lease_ms=values["lease_ms"],
            delay_ms=values["delay_ms"],
            sound=bool(values["sound"]),
            permitted=bool(values["permitted"]),
        )
    return got


ARM = {"arm": 1, "key": LASER_KEY, "renew": 1}
TICK = {"tick": 1}


def armed():
    """From reset until light comes, in the clock after: the interlock's level comes through, the key is written, and
    a millisecond more than the delay passes.
    """
    return [{}] * 3 + [ARM] + [TICK] * 4 + [{}]


def test_arming():
    """Lamp at once, light after the delay."""
    got = check([*armed(), {}])
    assert got["lamp"] == [0, 0, 0, 0, 1, 1, 1, 1, 1, 1]
    assert got["laser"] == [0, 0, 0, 0, 0, 0, 0, 0, 0, 1]


@pytest.mark.parametrize("key", [0, LASER_KEY ^ 1, LASER_KEY ^ 0x8000, 0xFFFF])
def test_wrong_key_does_not_arm(key):
    got = check([{}] * 3 + [{**ARM, "key": key}] + [TICK] * 9)
    assert not any(got["lamp"]) and got["cause"][-1] == LaserCause.NEVER_ARMED


@pytest.mark.parametrize("key", [0, LASER_KEY ^ 1])
def test_command_disarms(key):
    got = check([*armed(), {}, {"arm": 1, "key": key}, {}, TICK, TICK, TICK, TICK, TICK])
    assert got["laser"][9:] == [1, 1, 0, 0, 0, 0, 0, 0]
    assert not any(got["lamp"][11:]) and got["cause"][-1] == LaserCause.COMMAND


def test_opening_the_interlock_acts_at_once_and_needs_a_new_arming():
    opened = [{"interlock": 0}]
    got = check([*armed(), {}, *opened, *[{}] * 5, ARM, *[TICK] * 4, {}, {}])
    assert got["laser"][9:17] == [1, 0, 0, 0, 0, 0, 0, 0]
    assert got["cause"][13] == LaserCause.INTERLOCK
    assert got["laser"][-1], "it can be armed again"


def test_fault_of_the_motor_disarms_and_needs_a_new_arming():
    got = check([*armed(), {}, {"sound": 0}, *[{}] * 3, ARM, *[TICK] * 4, {}, {}])
    assert got["laser"][9:17] == [1, 1, 0, 0, 0, 0, 0, 0]
    assert got["cause"][12] == LaserCause.MOTOR
    assert got["laser"][-1], "it can be armed again"


def test_conditions_are_a_shutter():
    """Light goes a clock after they do, and comes back with them; the lamp stays on."""
    got = check([*armed(), {}, {"permitted": 0}, {"permitted": 0}, {}, {}, {}])
    assert got["laser"][9:] == [1, 1, 0, 0, 1, 1]
    assert all(got["lamp"][9:])


def test_lease_lapses_and_coming_back_does_not_arm():
    got = check([*armed(), *[TICK] * 6, {}, {}, {}, {"renew": 1}, *[TICK] * 3])
    tenth = 9 + 5  # four ticks have come before
    assert got["laser"] == [0] * 9 + [1] * (tenth + 3 - 9) + [0] * (len(got["laser"]) - tenth - 3)
    assert got["cause"][-1] == LaserCause.LEASE
    assert got["state.alive"][-1]


def test_renewal_keeps_it_on():
    got = check([*armed(), *[TICK, TICK, TICK, TICK, {"renew": 1}] * 20])
    assert all(got["laser"][9:])


@pytest.mark.parametrize(
    ("missing", "cause"),
    [
        ({"interlock": 0}, LaserCause.INTERLOCK),
        ({"renew": 0}, LaserCause.LEASE),
        ({"sound": 0}, LaserCause.MOTOR),
    ],
)
def test_arming_is_refused(missing, cause):
    got = check([missing] * 3 + [ARM | missing] + [TICK | missing] * 9)
    assert not any(got["lamp"]) and got["cause"][-1] == cause


def test_arming_twice_does_not_start_the_delay_again():
    got = check([{}] * 3 + [ARM, TICK, TICK, ARM, TICK, TICK, {}, {}])
    assert got["laser"][-1]


def test_longest_settings():
    """No counter starts again from zero: emission after the longest delay, until the longest lease lapses."""
    longest = {"lease_ms": 65535, "delay_ms": 65535}
    stimulus = [longest | values for values in [{}] * 3 + [ARM] + [TICK] * 66000]
    stimulus[4 + 99]["renew"] = 1
    got = check(stimulus)
    assert got["laser"].count(1) == 100 + 65535 - 65536 + 1  # off a clock later after its millisecond than on
    assert got["cause"][-1] == LaserCause.LEASE


@pytest.mark.parametrize("seed", range(4))
def test_random_events(seed):
    """Every condition comes and goes in any clock, several at once."""
    rng = random.Random(seed)
    print(f"seed {seed}")
    stimulus = []
    interlock, sound, permitted, lease_ms, delay_ms = 1, 1, 1, 10, 3
    for _ in range(8000):
        interlock ^= rng.random() < (0.004 if interlock else 0.2)
        sound ^= rng.random() < (0.002 if sound else 0.2)
        permitted ^= rng.random() < (0.02 if permitted else 0.2)
        if rng.random() < 0.005:
            lease_ms, delay_ms = rng.choice([0, 1, 5, 30]), rng.choice([0, 1, 3])
        stimulus.append(
            {
                "interlock": interlock,
                "tick": rng.random() < 0.3,
                "arm": rng.random() < 0.08,
                "key": rng.choice([LASER_KEY] * 9 + [0]),
                "renew": rng.random() < 0.1,
                "lease_ms": lease_ms,
                "delay_ms": delay_ms,
                "sound": sound,
                "permitted": permitted,
            }
        )
    got = check(stimulus)
    assert sum(got["laser"]) > 300
    assert set(got["cause"]) == set(LaserCause)


@pytest.mark.parametrize("clock_hz", [2000, 2500, 10_001, 48_000, 333_333])
def test_milliseconds(clock_hz):
    """Evenly spaced, and exact in the long run, also where the clock is no multiple of 1 kHz."""
    clocks = 6000
    tick = trace(Milliseconds(), [{"clock_hz": clock_hz}] * clocks, ("tick",))["tick"]
    times = [clock for clock, value in enumerate(tick) if value][3:]
    gaps = {after - before for before, after in pairwise(times)}
    assert gaps <= {clock_hz // 1000, clock_hz // 1000 + 1}
    for number, time in enumerate(times):
        assert abs(time - times[0] - number * clock_hz / 1000) < 1


@pytest.mark.parametrize("clock_hz", [0, 4_294_967_295])
def test_millisecond_of_extreme_clocks(clock_hz):
    """No frequency, or more than any FPGA has: nothing overflows into a burst of strobes."""
    tick = trace(Milliseconds(), [{"clock_hz": clock_hz}] * 500, ("tick",))["tick"]
    assert sum(tick[5:]) == (0 if clock_hz else 248)  # every second clock at most
