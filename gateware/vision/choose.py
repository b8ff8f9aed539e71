"""The run of a row that counts, and the best of the others."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from magtrak.protocol import Choice, Detector
from magtrak.protocol import Window as Span

from ..arithmetic import below
from ..layouts import FrameSettings
from ..select import Picked
from .runs import Crossing, Run, assign


class Rival(wiring.Signature):
    """What else might be the row's peak: where it stands, and how strong it is.

    ``crossed``: ``crossing`` is one; else its ``halves`` are the middle of a run.
    """

    def __init__(self) -> None:
        super().__init__({"crossed": Out(1), "strength": Out(20), "crossing": Out(Crossing())})


class Choose(wiring.Component):
    """Picks one of the runs that count by ``choice``, and keeps the strongest of the others.

    A run counts if it has enough gated pixels within reach and a width that is allowed: see
    :func:`magtrak.reference.find_runs`. What is chosen, and what becomes of a run that another displaces, is told by
    :func:`magtrak.reference.measure`.

    Parameters
    ----------
    window : the centroid may be that of a window; else it is the run's

    Members
    -------
    settings : ``choice``, ``run_gated``, ``run_width_min``, ``run_width_max``, and what tells the detector, are used
    valid, run : a :class:`~gateware.vision.runs.Run`, at most one in two clocks; it stands until the next
    clears : strobe, a clock before all runs are forgotten, to begin a row
    image_first : strobe: an image begins, the line has no place yet
    take : the run of the clock before is chosen now; it shows in ``chosen`` from the next clock on
    found, chosen : a run counts; the one chosen of those since then, :attr:`latency` clocks after the last
    numerator, divisor : quotient of what was chosen that its position is made of: its centroid's distance from its last
        column, or the crossing's share of a column; both 0 with ``BINARY``
    other_found, other : the strongest of the others
    place : ``centre`` of what was chosen when runs were forgotten last
    """

    def __init__(self, *, window: bool = True) -> None:
        self.window = window
        super().__init__(
            {
                "settings": In(FrameSettings),
                "valid": In(1),
                "run": In(Run()),
                "clears": In(1),
                "image_first": In(1),
                "take": Out(1),
                "found": Out(1),
                "chosen": Out(Run()),
                "numerator": Out(30),
                "divisor": Out(20),
                "other_found": Out(1),
                "other": Out(Rival()),
                "place": Out(12),
            }
        )

    latency = 2
    """Clocks from a run to the choice: compare, take."""

    def elaborate(self, platform):
        m = Module()
        run, best, other = self.run, self.chosen, self.other
        clear = Signal()
        image_first = Signal()
        m.d.sync += [clear.eq(self.clears), image_first.eq(self.image_first)]
        placed = Signal()  # the image has had a line
        with m.If(image_first):
            m.d.sync += placed.eq(0)
        with m.Elif(clear & self.found):
            m.d.sync += placed.eq(1)
        with m.If(clear & self.found):
            m.d.sync += self.place.eq(best.centre)

        # Runs come at least two clocks apart, so the run still stands while it is taken, and the one before has been.
        # Each register holds as much of the decision as one LUT behind its comparison can: the one that is left has
        # hundreds of enables to drive.
        enough = Signal()
        allowed = Signal()
        measured_better = Signal()
        placed_better = Signal()
        outdoes = Signal()
        keeps = Signal()  # the best becomes the other where it is displaced
        # What decides is known long before a run.
        by_place = Signal()
        by_strength = Signal()
        by_width = Signal()
        always = Signal()
        choice = self.settings.choice
        m.d.sync += [
            by_place.eq((choice == Choice.NEAREST) & placed),
            by_width.eq(choice == Choice.WIDEST),
            always.eq(choice == Choice.LAST),
            by_strength.eq((choice == Choice.STRONGEST) | ((choice == Choice.NEAREST) & ~placed)),
            enough.eq((run.gated >= self.settings.run_gated) & self.valid & ~self.clears),
            allowed.eq((run.width >= self.settings.run_width_min) & (run.width <= self.settings.run_width_max)),
            measured_better.eq(
                (by_strength & below(best.strength, run.strength)) | (by_width & (run.width > best.width))
            ),
            placed_better.eq((by_place & (run.away < best.away)) | always | ~self.found | clear),
            outdoes.eq(~self.other_found | below(other.strength, run.strength)),
            keeps.eq((~self.other_found | ~below(best.strength, other.strength)) & self.found & ~clear),
        ]
        better = Signal()
        m.d.comb += [
            better.eq(measured_better | placed_better),
            self.take.eq(enough & allowed & better),
        ]
        with m.If(clear):
            m.d.sync += [self.found.eq(0), self.other_found.eq(0)]
        with m.If(self.take):
            m.d.sync += [self.found.eq(1), *assign(best, run, Run())]
        self._quotient(m)
        with m.If(enough & allowed & Mux(better, keeps, outdoes)):
            m.d.sync += self.other_found.eq(1)
            with m.If(better):
                m.d.sync += _stand(other, best)
            with m.Else():
                m.d.sync += _stand(other, run)
        return m

    def _quotient(self, m: Module) -> None:
        centroid = self.settings.detector == Detector.CENTROID
        of_run = (self.settings.centroid_window == Span.RUN) if self.window else True
        ways = Signal(2)
        m.d.sync += ways.eq(Cat(centroid & of_run, (self.settings.detector != Detector.BINARY) & ~(centroid & of_run)))
        m.submodules.numerator = numerator = Picked(30, 2)
        m.submodules.divisor = divisor = Picked(20, 2)
        run = self.run
        for picked, out, values in (
            (numerator, self.numerator, (run.moment, run.crossing.rise)),
            (divisor, self.divisor, (run.sum, run.strength)),
        ):
            m.d.comb += [
                *(picked.i[n].eq(value) for n, value in enumerate(values)),
                *(picked.which.eq(ways), picked.enable.eq(self.take | ~ways.any()), out.eq(picked.o)),
            ]


def _stand(other, run) -> list:
    return [
        other.crossed.eq(run.crossed),
        other.strength.eq(run.strength),
        *assign(other.crossing, run.crossing, Crossing()),
    ]
