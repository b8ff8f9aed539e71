"""What a card is wired to, by role: the same roles on every board."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from amaranth.build import Attrs, Pins, Resource, Subsignal

from .errors import BoardError

INVERTED = "~"
"""Before a place: the pin is low when its signal is high, as that of a lamp between supply and pin."""


@dataclass(frozen=True)
class Role:
    """A signal of the card.

    Attributes
    ----------
    direction : ``i`` to the card, ``o`` from it, ``io``
    pull : what an open pin shall be: ``DOWN``, ``UP``, or ``NONE``
    meaning : for the wiring table
    optional : a board may do without
    width : pins
    """

    direction: str
    pull: str
    meaning: str
    optional: bool = False
    width: int = 1


ROLES: dict[str, dict[str, Role]] = {
    "encoder": {
        "a": Role("i", "DOWN", "encoder, channel A"),
        "b": Role("i", "DOWN", "encoder, channel B"),
        "index": Role("i", "DOWN", "index barrier"),
    },
    "interlock": {"closed": Role("i", "DOWN", "interlock: high while it is closed")},
    "motor": {
        "pwm": Role("o", "DOWN", "motor driver, PWM"),
        "direction": Role("o", "DOWN", "motor driver, direction", optional=True),
        "brake": Role("o", "DOWN", "motor driver, brake", optional=True),
    },
    "laser": {
        "enable": Role("o", "DOWN", "laser driver, enable: pull-down of its own needed"),
        "lamp": Role("o", "DOWN", "warning lamp"),
    },
    "camera": {
        "d": Role("i", "NONE", "camera, D0 to D7", width=8),
        "pclk": Role("i", "NONE", "camera, pixel clock PCLK"),
        "href": Role("i", "NONE", "camera, HREF"),
        "vsync": Role("i", "NONE", "camera, VSYNC"),
        "scl": Role("io", "UP", "camera, SIO_C (SCCB clock); 4.7 kohm to 3.3 V"),
        "sda": Role("io", "UP", "camera, SIO_D (SCCB data); 4.7 kohm to 3.3 V"),
        "xclk": Role("o", "NONE", "camera, clock XCLK, 24 MHz", optional=True),
        "reset": Role("o", "NONE", "camera, RESET#", optional=True),
        "powerdown": Role("o", "NONE", "camera, PWDN", optional=True),
    },
}
"""Resources of a card, and their signals."""

Wiring = Mapping[str, Mapping[str, str]]
"""Places of the signals: ``connector_number:pin`` as amaranth-boards names them, or a ball; spaces between several."""


class WiringError(BoardError):
    """A board's wiring lacks a signal, or has one too many."""


def check(wiring: Wiring) -> None:
    """That every signal has its place, none shares one, and there are no others.

    Raises
    ------
    WiringError
        Names the signal.
    """
    places: dict[str, str] = {}
    for name, role, at in _signals(wiring):
        if len(at) != role.width:
            raise WiringError(f"{name} has {len(at)} places, not {role.width}")
        for place in at:
            if place in places:
                raise WiringError(f"{name} and {places[place]} are both at {place}")
            places[place] = name
    for resource, roles in ROLES.items():
        for signal, role in roles.items():
            if not role.optional and signal not in wiring.get(resource, {}):
                raise WiringError(f"{resource}.{signal} has no place")


def _signals(wiring: Wiring) -> Iterator[tuple[str, Role, list[str]]]:
    for resource, signals in wiring.items():
        for signal, places in signals.items():
            role = ROLES.get(resource, {}).get(signal)
            if role is None:
                raise WiringError(f"{resource}.{signal} is no signal of a card")
            yield f"{resource}.{signal}", role, places.lstrip(INVERTED).split()


def _attributes(family: str, role: Role) -> Attrs:
    if family == "ice40":  # it has no pull-down
        return Attrs(IO_STANDARD="SB_LVCMOS", **({"PULLUP": 1} if role.pull == "UP" else {}))
    return Attrs(IO_TYPE="LVCMOS33", PULLMODE=role.pull)


def resources(wiring: Wiring, family: str) -> list[Resource]:
    """The wiring as Amaranth's resources, for an ``ecp5`` or an ``ice40``, all at 3.3 V."""
    check(wiring)
    result = []
    for resource, signals in wiring.items():
        parts = []
        for signal, places in signals.items():
            role = ROLES[resource][signal]
            pins = Pins(places.lstrip(INVERTED), dir=role.direction, invert=places.startswith(INVERTED))
            parts.append(Subsignal(signal, pins, _attributes(family, role)))
        result.append(Resource(resource, 0, *parts))
    return result
