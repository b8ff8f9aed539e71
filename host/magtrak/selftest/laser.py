"""The laser: off, and staying off. The test never arms it."""

from ..errors import RefusedError
from ..state import State
from .bench import Bench, FailedError

_WRONG_KEY = 0x1A5D


def off(bench: Bench) -> str:
    """It is neither armed nor on, and a wrong key does not change that."""
    card = bench.card
    try:
        card.write("laser_arm", _WRONG_KEY)
        interlock = "closed"
    except RefusedError:
        interlock = "open"
    state = card.read("laser_state")
    if state & 3:
        raise FailedError(f"the laser is {State.read(card).laser()} after a wrong key")
    if bool(state & 4) != (interlock == "closed"):
        raise FailedError(f"laser_state says {state:#04x}, but the interlock is {interlock}: writing laser_arm tells")
    return f"not armed; interlock {interlock}"
