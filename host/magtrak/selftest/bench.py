"""What the checks share: the card, its settings as they were, and images with known settings."""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ..card import Card
from ..errors import CardError, MagtrakError, RefusedError
from ..frames import Frame
from ..protocol import LUT_WORDS, REGISTERS, Access, Detector, MotorMode, Scope
from ..settings import Settings

IMAGE_S = 5.0
"""How long an image may take to come; a virtual card on a busy machine is slow."""

OPEN = (0xFFFF_FFFF,) * LUT_WORDS
CLOSED = (0,) * LUT_WORDS
"""A gate table that lets every colour pass, and one that lets none."""

TABLES = ("lut_hue", "lut_luminance", "lut_saturation")


class FailedError(Exception):
    """Something is not as it has to be; the text says what."""


class NotTriedError(Exception):
    """Nothing can be said; the text says why."""


@dataclass(frozen=True)
class Options:
    """What the user says about the card.

    Attributes
    ----------
    camera : it has a camera instead of the test picture
    loop_back : its motor outputs are wired to its encoder inputs, and to no motor
    """

    camera: bool = False
    loop_back: bool = False


def restorable() -> list[str]:
    """Registers that can be read and written back, in an order in which nothing starts by itself."""
    names = [one.name for one in REGISTERS if one.access is Access.BOTH and one.words == 1]
    last = ("motor_mode", "run")
    return [name for name in names if name not in (*last, "snapshot")] + list(last)


class Bench:
    """A card under test. Leaving the block puts everything back but the gate, whatever happened.

    The gate's tables cannot be read: those of the preset ``green`` are left in force.

    Parameters
    ----------
    card : greeted; neither armed nor driving its motor
    options : what the user says about it

    Raises
    ------
    CardError
        The laser is armed, or the motor runs.
    """

    def __init__(self, card: Card, options: Options) -> None:
        self.card = card
        self.options = options
        self._dirty = False  # a check may have changed something
        self._generation = 0

    def __enter__(self) -> "Bench":
        self._registers = dict(zip(names := restorable(), self.card.read_all(names), strict=True))
        self._generation = self._first_generation = self.card.read("generation")
        if self.card.read("laser_state") & 2:
            raise CardError("the laser is armed: disarm it first (`magtrak set laser_arm=0`)")
        if self._registers["motor_mode"] != MotorMode.OFF:
            raise CardError("the motor is on: stop it first (`magtrak set motor_mode=0`)")
        self._dirty = True
        return self

    def __exit__(self, *_: object) -> None:
        if self._dirty:  # an error has ended the test
            with contextlib.suppress(MagtrakError, FailedError):
                self.restore()

    def restore(self) -> None:
        """Everything as it was: registers and generation; the laser disarmed, the gate as the preset ``green`` has it.

        Raises
        ------
        FailedError
            It is not; names the first register.
        """
        self._dirty = False
        with contextlib.suppress(RefusedError):  # while the interlock is open, when it is disarmed anyway
            self.card.write("laser_arm", 0)
        settings = {one.name for one in REGISTERS if one.scope is Scope.FRAME}
        measured = {name: value for name, value in self._registers.items() if name in settings}
        direct = [(name, [value]) for name, value in self._registers.items() if name not in settings and name != "run"]
        self.card.write_all(direct)
        self.card.write("run", 1)
        self.commit({**measured, **dict(Settings().tables())}, self._first_generation)
        self.card.write("run", self._registers["run"])
        now = self.card.read_all(list(self._registers))
        for (name, value), found in zip(self._registers.items(), now, strict=True):
            if found != value:
                raise FailedError(f"{name} was {value} and is {found}")

    def commit(self, values: Mapping[str, int | Sequence[int]], generation: int | None = None) -> None:
        """Write settings and put them in force with the next image.

        Raises
        ------
        FailedError
            No image came, so they never were.
        """
        words = {name: [value] if isinstance(value, int) else value for name, value in values.items()}
        self.card.write_all(list(words.items()))
        if generation is None:
            self._generation = self._generation % 0xFFFF + 1
            if self._generation == self._first_generation:
                self._generation = self._generation % 0xFFFF + 1
        else:
            self._generation = generation
        self.card.write("commit", self._generation)
        if not self.card.wait_in_force(self._generation, IMAGE_S):
            raise FailedError(f"settings waited for an image in vain for {IMAGE_S:g} s: none came")

    def measure(
        self, values: Mapping[str, int], tables: Mapping[str, Sequence[int]] | None = None, count: int = 1
    ) -> list[Frame]:
        """Images measured with these settings, all others as after power-up, and these tables, all others open.

        Raises
        ------
        FailedError
            No image came.
        """
        self.card.write("run", 1)
        after_power_up = {
            one.name: one.init for one in REGISTERS if one.scope is Scope.FRAME and one.access is Access.BOTH
        }
        if not self.card.identity.built.has("runs"):
            after_power_up["detector"] = Detector.BINARY
        given = {name: (tables or {}).get(name, OPEN) for name in TABLES}
        self.commit({**self.card.identity.built.fitted({**after_power_up, **values}), **given})
        return self.images(lambda frames: len(frames) >= count)

    def images(self, enough: Callable[[list[Frame]], bool]) -> list[Frame]:
        """Images as they come, of the settings committed last, until there are enough.

        Raises
        ------
        FailedError
            None came for a while.
        """
        frames: list[Frame] = []
        last = time.monotonic()
        for frame in self.card.frames(0.05):
            if frame is not None and frame.header["generation"] == self._generation:
                frames.append(frame)
                last = time.monotonic()
                if enough(frames):
                    return frames
            if time.monotonic() - last > IMAGE_S:
                raise FailedError(f"no image came for {IMAGE_S:g} s: the source sends none, or the link loses them")
        raise FailedError("the images ended")
