"""All checks, one after the other."""

import enum
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from ..card import Card
from ..errors import EndOfStreamError, LinkError, MagtrakError
from . import angle, counters, laser, link, pattern, registers, tables
from .bench import Bench, FailedError, NotTriedError, Options

CHECKS: tuple[tuple[str, Callable[[Bench], str]], ...] = (
    ("link: latency", link.latency),
    ("link: throughput", link.throughput),
    ("link: damage", link.damage),
    ("registers: reading", registers.reading),
    ("registers: writing", registers.writing),
    ("registers: refusing", registers.refusing),
    ("registers: committing", registers.committing),
    ("images: positions", pattern.positions),
    ("gate: tables", tables.effect),
    ("counters: no loss", counters.lossless),
    ("counters: drops", counters.dropping),
    ("angle: loop-back", angle.loop_back),
    ("laser: off", laser.off),
)


class Result(enum.Enum):
    OK = "ok"
    FAILED = "FAILED"
    NOT_TRIED = "not tried"


@dataclass(frozen=True)
class Outcome:
    """What a check found."""

    name: str
    result: Result
    text: str


def examine(card: Card, options: Options) -> Iterator[Outcome]:
    """Check everything, and leave the card as it was; outcomes as they come.

    Raises
    ------
    CardError
        The laser is armed, or the motor runs: nothing was tried.
    LinkError
        The port died.
    """
    with Bench(card, options) as bench:
        for name, check in CHECKS:
            try:
                outcome = Outcome(name, Result.OK, check(bench))
            except NotTriedError as reason:
                outcome = Outcome(name, Result.NOT_TRIED, str(reason))
            except FailedError as reason:
                outcome = Outcome(name, Result.FAILED, str(reason))
            except (EndOfStreamError, LinkError):
                raise
            except MagtrakError as error:
                outcome = Outcome(name, Result.FAILED, str(error))
            yield outcome
        try:
            bench.restore()
            yield Outcome(
                "settings as before",
                Result.OK,
                "registers and generation; the gate is now that of the preset green, for it cannot be read",
            )
        except FailedError as reason:
            yield Outcome("settings as before", Result.FAILED, str(reason))
