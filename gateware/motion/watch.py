"""Watches the motor: stall, run-away, a broken encoder, an index that is missing or comes twice."""

from dataclasses import dataclass, replace

from amaranth.lib import data

from magtrak.protocol import MotorCause

from .assembly import Program

CHATTER = 8
"""Edges to and fro in a row, of a driven motor, that no shaft makes: one channel of the encoder is dead or noisy."""

OVERSPEED_MS = 8
"""Measurements in a row above the greatest speed that are a run-away: a stray edge makes one or two."""

SLOWEST = 16 << 8
"""Wanted speeds below 16 counts a second, Q23.8, are standstill for the watch: turning round goes through them."""

FORGET_MS = 128
"""One illegal transition is forgotten every so often."""

_ENDLESS = 1 << 16  # counters stop where no setting reaches


class Faults(data.Struct):
    """Register ``motor_watch``: the faults that stop the motor."""

    stall: 1
    runaway: 1
    encoder: 1
    index: 1
    lease: 1


FAULTS = tuple(name for name, _ in data.Layout.cast(Faults))


@dataclass(frozen=True)
class Watched:
    """What :meth:`MotorWatch.reference` remembers from step to step."""

    anchor: int = 0
    idle_ms: int = 0
    astray: int = 0
    place: int = 0
    fast_ms: int = 0
    illegals: int = 0
    forget_ms: int = 0
    start: int = 0
    seen: bool = False


class MotorWatch:
    """Finds faults, once a millisecond, while the motor is driven, those that ``motor_watch`` names.

    - ``STALL``: less than two counts of way in ``motor_stall_ms`` (up to a millisecond more).
    - ``RUNAWAY``: more than ``motor_runaway`` edges against the wanted direction (A and B swapped, a motor with wrong
      polarity), in milliseconds without an edge the right way; or a speed above ``motor_speed_max`` for
      :data:`OVERSPEED_MS` ms (a bridge that is stuck).
    - ``ENCODER``: :data:`CHATTER` edges to and fro, or more than ``encoder_tolerance`` illegal transitions, of which
      one is forgotten every :data:`FORGET_MS` ms.
    - ``TURN``: a turn that is off by more than ``index_tolerance``: a second index, or lost counts.
    - ``INDEX_MISSING``: a turn and a quarter without index; only with ``counts_per_turn``.
    - ``SEARCH``: looked for the index in vain.
    - ``LEASE``: the host is gone.

    Of several, the cause is the first of LEASE, ENCODER, RUNAWAY, TURN, INDEX_MISSING, SEARCH, STALL.
    """

    @staticmethod
    def reference(
        now: Watched,
        *,
        rested: bool,
        driven: bool,
        closed: bool,
        target: int,
        motor_duty: int,
        speed: int,
        count: int,
        right: bool,
        chattered: bool,
        illegals: int,
        passed: bool,
        pass_count: int,
        wrong: bool,
        difference: int,
        failed: bool,
        alive: bool,
        watch: int,
        motor_stall_ms: int,
        motor_runaway: int,
        motor_speed_max: int,
        encoder_tolerance: int,
        index_tolerance: int,
        counts_per_turn: int,
    ) -> tuple[Watched, MotorCause]:
        """The definition: what a step makes of ``now``, and the fault that it finds.

        ``rested``: the motor was not driven at some time since the step before; ``passed``, ``right``, ``chattered``,
        ``wrong``, ``illegals``: the index was passed, an edge came in the wanted direction, edges went to and fro, a
        turn was off, so many illegal transitions came, since then.
        """
        now = replace(now, forget_ms=(now.forget_ms - 1) % FORGET_MS)
        if rested:
            now = Watched(anchor=count, place=count, start=count, forget_ms=now.forget_ms)
        if not driven:
            return replace(now, place=count), MotorCause.NONE
        moving = abs(target) >= SLOWEST if closed else motor_duty != 0
        far = abs(_wrapped(count - now.anchor)) > 1
        if far or not moving:
            now = replace(now, anchor=count, idle_ms=0)
        else:
            now = replace(now, idle_ms=min(now.idle_ms + 1, _ENDLESS))
        moved = abs(_wrapped(count - now.place))
        astray = 0 if right or not moving or not closed else min(now.astray + moved, _ENDLESS)
        fast_ms = min(now.fast_ms + 1, OVERSPEED_MS) if abs(speed) > motor_speed_max else 0
        count_illegal = max(now.illegals - (now.forget_ms == FORGET_MS - 1), 0)
        if not rested:
            count_illegal = min(count_illegal + illegals, _ENDLESS)
        seen = now.seen or passed
        now = replace(now, astray=astray, place=count, fast_ms=fast_ms, illegals=count_illegal, seen=seen)
        turned = abs(_wrapped(count - (pass_count if seen else now.start)))
        enable = {name: bool(watch >> bit & 1) for bit, name in enumerate(FAULTS)}
        for fault, cause in (
            (enable["lease"] and not alive, MotorCause.LEASE),
            (
                enable["encoder"] and ((chattered and moving) or count_illegal > encoder_tolerance),
                MotorCause.ENCODER,
            ),
            (enable["runaway"] and (fast_ms == OVERSPEED_MS or astray > motor_runaway), MotorCause.RUNAWAY),
            (enable["index"] and wrong and not rested and abs(difference) > index_tolerance, MotorCause.TURN),
            (
                enable["index"] and counts_per_turn > 0 and 4 * turned > 5 * counts_per_turn,
                MotorCause.INDEX_MISSING,
            ),
            (enable["index"] and failed, MotorCause.SEARCH),
            (enable["stall"] and now.idle_ms > motor_stall_ms, MotorCause.STALL),
        ):
            if fault:
                return now, cause
        return now, MotorCause.NONE

    @staticmethod
    def program(p: Program) -> None:
        """Output ``cause`` where there is one."""
        p.variable("anchor", "idle_ms", "astray", "watch_place", "fast_ms", "illegal", "forget_ms", "watch_start")
        p.variable("pass_seen", "moving", "cause", "size")
        p.load("forget_ms")
        p.subtract(1)
        with p.when("negative"):
            p.load(FORGET_MS - 1)
        p.store("forget_ms")
        with p.when("rested"):
            p.put_copy("count", "anchor")
            p.store("watch_place")
            p.store("watch_start")
            p.put(0, "idle_ms", "astray", "fast_ms", "illegal", "pass_seen")
        with p.when("driven"):
            p.put(0, "cause")
            MotorWatch._moving(p)
            for watched, check in (
                ("watch_stall", MotorWatch._stall),
                ("watch_index", MotorWatch._index),
                ("watch_runaway", MotorWatch._runaway),
                ("watch_encoder", MotorWatch._encoder),
            ):
                check(p, watched)
            with p.unless("alive"):
                _found(p, "watch_lease", MotorCause.LEASE)
            p.load_negative("cause")
            with p.when("negative"):
                p.load("cause")
                p.output("cause")
        p.put_copy("count", "watch_place")

    @staticmethod
    def _moving(p: Program) -> None:
        with p.when("closed"):
            p.load_magnitude("target")
            p.subtract(SLOWEST)
        with p.otherwise():
            p.load_magnitude("motor_duty")
            p.subtract(1)
        p.store("moving")  # not negative: it shall move
        p.output("still")

    @staticmethod
    def _stall(p: Program, watched: str) -> None:
        _difference(p, "count", "anchor")
        p.subtract(2)
        with p.when("negative"):
            p.load("moving")
            with p.when("negative"):
                p.load(0)
            with p.otherwise():
                p.load_negative(1)
        with p.unless("negative"):
            p.put_copy("count", "anchor")
            p.put(0, "idle_ms")
        with p.otherwise():
            _count(p, "idle_ms", 1)
        _more(p, "idle_ms", "motor_stall_ms", watched, MotorCause.STALL)

    @staticmethod
    def _runaway(p: Program, watched: str) -> None:
        _difference(p, "count", "watch_place")
        p.store("size")
        _count(p, "astray", "size")
        p.load("moving")
        with p.unless("closed"):
            p.load_negative(1)
        with p.when("right"):
            p.load_negative(1)
        with p.when("negative"):
            p.put(0, "astray")
        _more(p, "astray", "motor_runaway", watched, MotorCause.RUNAWAY)
        p.load("motor_speed_max")
        p.store("size")
        p.load_magnitude("speed")
        p.store("scratch")
        p.load("size")
        p.subtract("scratch")
        with p.when("negative"):
            _count(p, "fast_ms", 1, OVERSPEED_MS)
        with p.otherwise():
            p.put(0, "fast_ms")
        _more(p, "fast_ms", OVERSPEED_MS - 1, watched, MotorCause.RUNAWAY)

    @staticmethod
    def _encoder(p: Program, watched: str) -> None:
        p.load("forget_ms")
        p.subtract(FORGET_MS - 1)
        with p.unless("negative"):
            p.load("illegal")
            p.subtract(1)
            p.at_least(0, "illegal")
        with p.unless("rested"):
            _count(p, "illegal", "illegals")
        _more(p, "illegal", "encoder_tolerance", watched, MotorCause.ENCODER)
        p.load("moving")
        with p.unless("negative"):
            with p.when("chattered"):
                _found(p, watched, MotorCause.ENCODER)

    @staticmethod
    def _index(p: Program, watched: str) -> None:
        """The turn is counted from the last pass, or from the start where there was none."""
        p.load("failed")
        with p.when("negative"):
            _found(p, watched, MotorCause.SEARCH)
        with p.when("passed"):
            p.put(-1, "pass_seen")
        p.load("pass_seen")
        with p.when("negative"):
            p.load("pass_count")
        with p.otherwise():
            p.load("watch_start")
        p.store("size")
        _difference(p, "count", "size")
        p.at_most(1 << 27, "scratch")  # a turn has less than 2**24 counts
        p.add("scratch")
        p.store("size")
        p.add("size")
        p.store("size")
        p.load_negative("counts_per_turn")
        with p.when("negative"):
            for _ in range(4):
                p.subtract("counts_per_turn")
            p.add("size")
            p.subtract(1)
            with p.unless("negative"):
                _found(p, watched, MotorCause.INDEX_MISSING)
        with p.when("wrong"):
            with p.unless("rested"):
                p.load_magnitude("difference")
                p.store("size")
                _more(p, "size", "index_tolerance", watched, MotorCause.TURN)


def _wrapped(value: int) -> int:
    return (value + (1 << 31)) % (1 << 32) - (1 << 31)


def _difference(p: Program, one: str, other: str) -> None:
    """A = the way between two counts; counts wrap."""
    p.load(one)
    p.subtract(other)
    p.wrap()
    p.store("scratch")
    p.load_magnitude("scratch")


def _count(p: Program, variable: str, by: str | int, most: int = _ENDLESS) -> None:
    p.load(variable)
    p.add(by)
    p.at_most(most, variable)
    p.store(variable)


def _more(p: Program, variable: str, bound: str | int, watched: str, cause: MotorCause) -> None:
    """It is a fault if the variable is more than the bound."""
    p.load(bound)
    p.subtract(variable)
    with p.when("negative"):
        _found(p, watched, cause)


def _found(p: Program, watched: str, cause: MotorCause) -> None:
    with p.when(watched):
        p.put(int(cause), "cause")
