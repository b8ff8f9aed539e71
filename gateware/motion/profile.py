"""What speed is wanted: turning, sweeping between two angles, looking for the index; and the ramp between speeds."""

from dataclasses import dataclass, replace

from magtrak.protocol import MotorMode

from .assembly import Program


@dataclass(frozen=True)
class Course:
    """What :meth:`Profile.reference` remembers from step to step."""

    target: int = 0
    backward: bool = False
    begun: bool = False
    found: bool = False
    failed: bool = False
    start: int = 0
    turned: bool = False


class Profile:
    """The speed that the loop has to keep, a step a millisecond.

    ``SPEED`` goes to ``speed``. ``SWEEP`` goes forward until the position is at ``high``, back until it is at ``low``,
    and so on; it starts in the direction of ``speed``, whose magnitude counts. While the index has not been passed it
    looks for it first, as ``SEARCH`` does: in the direction of ``speed`` for up to ``search`` counts, then the other
    way up to ``search`` counts beyond the start; if nothing came, it has failed. ``SEARCH`` ends with the first pass,
    at speed 0.

    ``target`` moves by at most ``acceleration`` a step, so a reversal is a parabola. Outside these modes it follows the
    measured speed: closing the loop makes no jump.

    Speeds are signed Q23.8, counts a second, ``acceleration`` Q16.8 counts a second per step; ``low``, ``high`` and
    ``position`` are counts from the zero of the index.
    """

    @staticmethod
    def reference(
        now: Course,
        *,
        mode: MotorMode,
        speed: int,
        measured: int,
        acceleration: int,
        count: int,
        passed: bool,
        seen: bool,
        position: int,
        low: int,
        high: int,
        search: int,
    ) -> Course:
        """The definition: what a step makes of ``now``; ``passed``: the index was, since the step before."""
        if mode not in (MotorMode.SPEED, MotorMode.SWEEP, MotorMode.SEARCH):
            return Course(target=measured)
        if not now.begun:
            now = replace(now, begun=True, backward=speed < 0, start=count)
        found = now.found or passed
        looking = not found if mode is MotorMode.SEARCH else mode is MotorMode.SWEEP and not seen
        moved = count - now.start
        wanted = -abs(speed) if now.backward else abs(speed)
        if mode is MotorMode.SPEED:
            wanted = speed
        elif looking:
            if search and abs(moved) > search and (moved < 0) == now.backward:
                now = replace(now, backward=not now.backward, turned=True, failed=now.failed or now.turned)
        elif mode is MotorMode.SEARCH:
            wanted = 0
        elif position >= high:
            now = replace(now, backward=True)
        elif position <= low:
            now = replace(now, backward=False)
        change = min(max(wanted - now.target, -acceleration), acceleration)
        return replace(now, found=found, target=now.target + change)

    @staticmethod
    def program(p: Program) -> None:
        """``target``, ``found`` and ``failed`` from ``speed``, ``count``, ``position`` and the settings."""
        p.variable("target", "course_backward", "begun", "found", "failed", "turned", "start", "wanted")
        with p.unless("closed"):
            p.put_copy("speed", "target")
            p.put(0, "begun", "found", "failed", "turned")
        with p.otherwise():
            p.load("begun")
            with p.unless("negative"):
                p.put(-1, "begun")
                p.put_copy("motor_speed", "course_backward")  # its sign is what counts
                p.put_copy("count", "start")
            with p.when("passed"):
                p.put(-1, "found")
            with p.when("speed_mode"):
                p.put_copy("motor_speed", "wanted")
            with p.otherwise():
                Profile._course(p)
            p.load("wanted")
            p.subtract("target")
            p.at_most("motor_acceleration", "moved")
            p.add("motor_acceleration")  # at least its negative
            p.at_least(0, "moved")
            p.subtract("motor_acceleration")
            p.add("target")
            p.store("target")
        p.load("found")
        p.output("found")

    @staticmethod
    def _course(p: Program) -> None:
        p.load_magnitude("motor_speed")
        p.store("wanted")
        p.load("course_backward")
        with p.when("negative"):
            p.load_negative("wanted")
            p.store("wanted")
        with p.when("sweep_mode"):
            with p.when("seen"):
                p.load("position")
                p.subtract("sweep_high")
                with p.unless("negative"):
                    p.put(-1, "course_backward")
                with p.otherwise():
                    p.load("sweep_low")
                    p.subtract("position")
                    with p.unless("negative"):
                        p.put(0, "course_backward")
            with p.otherwise():
                Profile._look(p)
        with p.otherwise():
            p.load("found")
            with p.when("negative"):
                p.put(0, "wanted")
            with p.otherwise():
                Profile._look(p)

    @staticmethod
    def _look(p: Program) -> None:
        """Turns round where nothing came within ``search`` counts of the start, in the direction that it goes."""
        p.load("course_backward")
        with p.when("negative"):
            p.load("start")
            p.subtract("count")
        with p.otherwise():
            p.load("count")
            p.subtract("start")
        p.store("moved")
        p.load_negative("motor_search")
        with p.when("negative"):  # there is an end
            p.add("moved")
            p.subtract(1)
            with p.unless("negative"):
                p.load("turned")
                with p.when("negative"):
                    p.put(-1, "failed")
                p.put(-1, "turned")
                p.load_negative(1)
                p.subtract("course_backward")
                p.store("course_backward")
