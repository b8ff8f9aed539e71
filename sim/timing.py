"""When a camera exposes and reads its rows."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .errors import SimError

FILL = 0.8
"""Part of the frame period that the rows take where no row time is given."""


@dataclass(frozen=True)
class Timing:
    """Timing of a rolling shutter.

    Row r of an image whose first row arrives at t comes at ``t + r * row_time_s``, and gathered its light
    from ``exposure_s + readout_delay_s`` before that until ``readout_delay_s`` before it.

    Parameters
    ----------
    height : rows of an image
    frame_rate_hz : images per second
    row_time_s : time from row to row; None: the rows fill :data:`FILL` of the period
    exposure_s, readout_delay_s : see above

    Raises
    ------
    SimError : the rows or the exposure don't fit into the period, or a value is out of range
    """

    height: int
    frame_rate_hz: float = 50.0
    row_time_s: float | None = None
    exposure_s: float = 0.0
    readout_delay_s: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.frame_rate_hz) and self.frame_rate_hz > 0):
            raise SimError(f"the frame rate has to be positive, not {self.frame_rate_hz:g} Hz")
        if self.row_time_s is not None:
            if not (np.isfinite(self.row_time_s) and self.row_time_s > 0):
                raise SimError(f"the row time has to be positive, not {self.row_time_s * 1e6:g} us")
            if self.height * self.row_time_s > self.period_s * (1 + 1e-9):
                raise SimError(
                    f"{self.height} rows of {self.row_time_s * 1e6:g} us are longer than the frame period of "
                    f"{self.period_s * 1e3:g} ms; take a shorter row time or a lower frame rate"
                )
        for what, value in (("exposure", self.exposure_s), ("read-out delay", self.readout_delay_s)):
            if not (np.isfinite(value) and value >= 0):
                raise SimError(f"the {what} can't be {value * 1e3:g} ms; give 0 or more")
        if self.exposure_s > self.period_s:
            raise SimError(
                f"an exposure of {self.exposure_s * 1e3:g} ms is longer than the frame period of "
                f"{self.period_s * 1e3:g} ms; take a shorter exposure or a lower frame rate"
            )

    @property
    def period_s(self) -> float:
        """Time from image to image."""
        return 1 / self.frame_rate_hz

    @property
    def row_period_s(self) -> float:
        """Time from row to row, given or chosen."""
        return FILL * self.period_s / self.height if self.row_time_s is None else self.row_time_s

    @property
    def offset_s(self) -> float:
        """From a row's arrival to the middle of its exposure: the calibration's ``time_offset_s``."""
        return -(self.exposure_s / 2 + self.readout_delay_s)

    def rows(self, start_s: float) -> npt.NDArray[np.float64]:
        """(height,) times of arrival of the rows of an image whose first row arrives at ``start_s``."""
        return np.asarray(start_s + self.row_period_s * np.arange(self.height), dtype=np.float64)

    def exposed(self, row_times_s: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Start and end of the exposures of rows that arrive at given times."""
        end = row_times_s - self.readout_delay_s
        return end - self.exposure_s, end
