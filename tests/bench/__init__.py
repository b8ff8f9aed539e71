"""Benchmarks: what is claimed of speed and accuracy, measured beside peers in one run.

``make bench`` runs them all; ``python -m tests.bench NAME ...`` some. Each module of this package has a
function ``run()`` that yields :class:`Figure` objects.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """One line of the table.

    Parameters
    ----------
    what : what was measured
    value, unit : ours
    peer, peer_value : what it is compared with in the same run, and its value in the same unit
    goal : what the ratio or the value should be, in words; empty where nothing is promised
    met : whether it is, or None
    """

    what: str
    value: float
    unit: str
    peer: str = ""
    peer_value: float | None = None
    goal: str = ""
    met: bool | None = None

    @property
    def ratio(self) -> float | None:
        return None if self.peer_value is None else self.value / self.peer_value
