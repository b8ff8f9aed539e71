"""Whether the angle is inside the sector that may be lit."""

from .assembly import Program


class Sector:
    """Compares the position with a sector, whole turns apart or not.

    Inside is ``low <= position + k * counts_per_turn <= high`` for a k of -1, 0, 1: as the zero is a pass of the
    index, the position lies within a turn of it. Without a pass, nothing is inside.
    """

    @staticmethod
    def reference(position: int, seen: bool, counts_per_turn: int, low: int, high: int) -> bool:
        """The definition."""
        return seen and any(low <= position + k * counts_per_turn <= high for k in (-1, 0, 1))

    @staticmethod
    def program(p: Program) -> None:
        """Output ``inside`` from ``position``; negative where it is inside."""
        p.variable("inside", "place_in_turn")
        p.put(0, "inside")
        with p.when("seen"):
            p.load("position")
            p.subtract("counts_per_turn")
            Sector._compare(p)
            p.add("counts_per_turn")
            Sector._compare(p)
            p.add("counts_per_turn")
            Sector._compare(p)
        p.load("inside")
        p.output("inside")

    @staticmethod
    def _compare(p: Program) -> None:
        """``inside`` if A is; A stays."""
        p.store("place_in_turn")
        p.subtract("sector_low")
        with p.unless("negative"):
            p.load("sector_high")
            p.subtract("place_in_turn")
            with p.unless("negative"):
                p.put(-1, "inside")
        p.load("place_in_turn")
