"""The angle inputs, from the motor's outputs: PWM to channel A, direction to channel B, brake to the index.

The PWM is high for all but a clock of each period, which the encoder's filter leaves out, and low at a duty of 0; the
direction turns while it is low. So the two are a pair of quadrature signals, and each duty has its count.
"""

import time
from collections.abc import Callable

from ..protocol import MotorMode
from .bench import Bench, FailedError, NotTriedError

PERIOD = 4096
WAIT_S = 3.0
_FULL = 32767
_STEPS = ((_FULL, 1), (0, 0), (-_FULL, -2), (0, -1), (_FULL, 1), (0, 0))
"""Duties in turn, and how many quarters of a line from the start each leaves the encoder, for one sense of it."""


def loop_back(bench: Bench) -> str:
    """The count follows outputs that are wired to the inputs, without an error; the index passes."""
    card = bench.card
    if not bench.options.loop_back:
        raise NotTriedError(
            "not wired; take the motor off, wire PWM to encoder A, direction to B, brake to index, say --loop-back"
        )
    quiet = {"motor_period": PERIOD, "motor_bridge": 0, "motor_watch": 0, "encoder_filter": 3, "encoder_swap": 0}
    quiet = card.identity.built.fitted({**quiet, "index_invert": 0, "index_policy": 1})
    card.write_all([(name, [value]) for name, value in quiet.items()])
    try:
        card.write_all([("motor_duty", [_FULL]), ("motor_mode", [MotorMode.DUTY])])
        _settle(bench)
        card.write("motor_duty", 0)
        _settle(bench)
        start, errors = card.read("count"), card.read("encoder_errors")
        sense = 0
        for duty, quarters in _STEPS:
            card.write("motor_duty", duty)
            if not sense:
                _until(bench, lambda: card.read("count") != start, "the count stands still: are A and B wired?")
                sense = card.read("count") - start
                if abs(sense) != 1:
                    raise FailedError(f"one edge of A counted {sense}")
            wanted = start + sense * quarters
            _until(
                bench,
                lambda wanted=wanted: card.read("count") == wanted,  # type: ignore[misc]
                f"after a duty of {duty} the count is not {wanted}: is direction wired to B?",
            )
        if (now := card.read("encoder_errors")) != errors:
            raise FailedError(f"encoder_errors went from {errors:#x} to {now:#x}")
        passes = card.read("index_passes")
        # The index passes where it rises after an edge forward, which the end of a pulse is, of one sense or the other.
        for duty, quarters in ((-sense * _FULL, -2 if sense > 0 else 1), (0, -1 if sense > 0 else 0)):
            card.write("motor_duty", duty)
            there = start + sense * quarters
            _until(bench, lambda there=there: card.read("count") == there, "the count went astray")  # type: ignore[misc]
        card.write("motor_brake", 1)
        _until(bench, lambda: card.read("index_passes") != passes, "the index did not pass: is brake wired to it?")
    finally:
        card.write_all([("motor_duty", [0]), ("motor_mode", [MotorMode.OFF]), ("motor_brake", [0])])
    return f"{len(_STEPS)} steps counted, {'forward' if sense > 0 else 'backward'} by PWM; the index passed"


def _settle(bench: Bench) -> None:
    """Two periods of the PWM, in which the motor's new duty has come."""
    before = -1
    for _ in range(50):
        time.sleep(0.02)
        if (now := bench.card.read("count")) == before:
            return
        before = now


def _until(bench: Bench, there: Callable[[], bool], otherwise: str) -> None:
    until = time.monotonic() + WAIT_S
    while not there():
        if time.monotonic() > until:
            raise FailedError(f"{otherwise} (count {bench.card.read('count')})")
        time.sleep(0.005)
