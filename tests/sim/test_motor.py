"""The motor model against its own equation, solved by other means."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.encoder import Signal
from sim.motor import Motor, MotorParameters

P = MotorParameters(
    supply_v=12, resistance_ohm=4, torque_constant_nm_a=28, inertia_kg_m2=9.8, viscous_nm_s=1, friction_nm=4
)


def test_constants() -> None:
    # 28^2 / 4 + 1 = 197 Nm s/rad; 9.8 / 197 = 49.7 ms
    assert P.damping_nm_s == 197
    assert P.time_constant_s == pytest.approx(0.049746, abs=1e-6)
    # At 0.1 rad/s: (19.7 + 4) of the 84 Nm of full duty.
    assert P.duty(0.1) == pytest.approx(23.7 / 84)
    assert P.duty(-0.1) == pytest.approx(-23.7 / 84)


def test_follows_its_equation_of_motion() -> None:
    motor = Motor(P, -0.02, 8192)
    goal = solve_ivp(
        lambda _, y: [y[1], (84 * 0.5 - 197 * y[1] - 4) / 9.8], (0, 0.2), [-0.02, 0.0], rtol=1e-11, atol=1e-13,
        dense_output=True,
    )  # fmt: skip
    times = np.linspace(0, 0.2, 700)
    for until in times[1:]:
        motor.advance(until, 0.5)
    assert motor.angle(times) == pytest.approx(goal.sol(times)[0], abs=1e-9)
    assert motor.speed_rad_s == pytest.approx(goal.y[1, -1], abs=1e-9)


def test_steady_speed_and_events() -> None:
    motor = Motor(P, 0.0, 8192)
    duty = P.duty(0.2)
    motor.advance(1.0, duty)
    assert motor.speed_rad_s == pytest.approx(0.2, rel=1e-6)
    events = motor.advance(1.5, duty)
    # 0.1 rad are 130.4 counts.
    assert len([e for e in events if e.signal is not Signal.INDEX]) in (130, 131)
    edges = [e.time_s for e in events]
    assert edges == sorted(edges)
    assert np.diff(edges) == pytest.approx(2 * np.pi / 8192 / 0.2, rel=1e-5)


def test_the_portions_do_not_matter() -> None:
    coarse, fine = Motor(P, 0.0, 8192), Motor(P, 0.0, 8192)
    a = coarse.advance(0.3, 0.6)
    b = [event for until in np.linspace(0, 0.3, 1234)[1:] for event in fine.advance(until, 0.6)]
    assert [e[1:] for e in a] == [e[1:] for e in b]
    assert [e.time_s for e in a] == pytest.approx([e.time_s for e in b], abs=1e-9)
    assert fine.advance(0.2, 0.6) == []


def test_friction_holds_and_stops_it() -> None:
    motor = Motor(P, 0.1, 8192)
    assert motor.advance(1.0, 0.04) == []  # 3.4 Nm against 4
    assert motor.angle([1.0]) == pytest.approx(0.1)
    motor.advance(1.5, 1.0)
    assert motor.speed_rad_s > 0.3
    motor.advance(2.5, 0.0)
    assert motor.speed_rad_s == 0
    rest = motor.angle([2.5])[0]
    motor.advance(3.0, 0.0)
    assert motor.angle([3.0])[0] == rest
    # By hand: from the speed v, w = 4 / 197 below it at once: way = tau (v - w ln(1 + v / w)).
    v, w, tau = 80 / 197, 4 / 197, P.time_constant_s
    assert rest - motor.angle([1.5 + 1e-12])[0] == pytest.approx(tau * (v - w * np.log(1 + v / w)), rel=1e-4)


def test_reverses_through_standstill() -> None:
    motor = Motor(P, 0.0, 8192)
    motor.advance(0.5, 0.5)
    motor.advance(1.0, -0.5)
    assert motor.speed_rad_s == pytest.approx(-(42 - 4) / 197, rel=1e-3)


def test_without_friction() -> None:
    motor = Motor(replace(P, friction_nm=0.0), 0.0, 8192)
    motor.advance(1.0, 0.5)
    assert motor.speed_rad_s == pytest.approx(42 / 197, rel=1e-6)


def test_stiction_holds_longer_than_friction() -> None:
    motor = Motor(replace(P, stiction_nm=8.0), 0.0, 8192)
    assert motor.advance(0.5, 0.08) == []  # 6.7 Nm: more than the friction, less than the stiction
    motor.advance(1.0, 0.12)
    assert motor.speed_rad_s > 0
    motor.advance(2.0, 0.08)
    assert motor.speed_rad_s == pytest.approx((6.72 - 4) / 197, rel=1e-3), "once it turns, friction is all"


def test_ripple_of_the_supply_shows_in_the_speed() -> None:
    """As a first-order low-pass passes it: 1 / sqrt(1 + (w tau)^2)."""
    motor = Motor(replace(P, supply_ripple=0.1, ripple_hz=5.0), 0.0, 8192)
    speeds = []
    for until in np.arange(0.5, 1.1, 1e-3):
        motor.advance(until, 0.5)
        speeds.append(motor.speed_rad_s)
    amplitude = (max(speeds[100:]) - min(speeds[100:])) / 2
    expected = 0.1 * 42 / 197 / np.hypot(1, 2 * np.pi * 5 * P.time_constant_s)
    assert amplitude == pytest.approx(expected, rel=0.02)


def test_a_load_slows_it_down() -> None:
    motor = Motor(replace(P, load_nm=10.0), 0.0, 8192)
    motor.advance(1.0, 0.5)
    assert motor.speed_rad_s == pytest.approx((42 - 10 - 4) / 197, rel=1e-6)
