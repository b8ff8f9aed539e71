"""What was measured in the rows of a frame, or of some frames together."""

from collections.abc import Sequence
from functools import cache, cached_property

import numpy as np

from . import protocol
from .arrays import Booleans, Floats, Integers
from .protocol import RowForm
from .records import FieldArrays

LAYOUTS = {RowForm.COMPACT: protocol.COMPACT_ROW, RowForm.FULL: protocol.FULL_ROW}

QUALITY_FLAGS = ("ambiguous", "saturated", "cut", "overflow")


class Rows:
    """One entry a row, in order; each kind is unpacked when first asked for.

    Parameters
    ----------
    form : of the records
    row : row of the picture: of an interlaced one, an image has every other
    data : the records

    Attributes
    ----------
    form, row : as given
    raw : every field of the form as it came
    """

    def __init__(self, form: RowForm, row: Integers, data: bytes | memoryview) -> None:
        self.form, self.row, self._data = form, row, data
        self.raw = FieldArrays(LAYOUTS[form], data, len(row))

    @classmethod
    def joined(cls, parts: Sequence["Rows"]) -> "Rows":
        """One after the other, all of one form."""
        if len(parts) == 1:
            return parts[0]
        (form,) = {part.form for part in parts}
        return cls(form, np.concatenate([part.row for part in parts]), b"".join(part._data for part in parts))

    def __len__(self) -> int:
        return len(self.row)

    @cached_property
    def column_px(self) -> Floats:
        """Column of the line, distorted picture; 0 where not valid."""
        return np.asarray(self.raw["position"] / (1 << protocol.POSITION_FRACTION_BITS))

    @cached_property
    def valid(self) -> Booleans:
        return self.raw.flags("valid")

    @cached_property
    def ambiguous(self) -> Booleans:
        return self.raw.flags("ambiguous")

    @cached_property
    def saturated(self) -> Booleans:
        return self.raw.flags("saturated")

    @cached_property
    def cut(self) -> Booleans:
        return self.raw.flags("cut")

    @cached_property
    def overflow(self) -> Booleans:
        return self.raw.flags("overflow")

    @property
    def peak(self) -> Floats:
        """Greatest weight of the run, 0 to 255 (in steps of 17 in the compact form)."""
        return self._judged[0]

    @property
    def width_px(self) -> Floats:
        """Columns of the run (at most 15 in the compact form)."""
        return self._judged[1]

    @property
    def quality(self) -> Floats:
        """How far each may be trusted: see :func:`quality`."""
        return self._judged[2]

    @cached_property
    def _judged(self) -> tuple[Floats, Floats, Floats]:
        """Peak, width and quality."""
        if self.form == RowForm.COMPACT:
            at = self.raw.span(*_JUDGED)
            peak, width_px, quality = _compact_judged()
            return peak.take(at), width_px.take(at), quality.take(at)
        return self._judge()

    def _judge(self) -> tuple[Floats, Floats, Floats]:
        peak, width_px = self.raw["peak"].astype(np.float64), self.raw["width"].astype(np.float64)
        if self.form == RowForm.COMPACT:
            peak *= 17  # 15 * 17 == 255
        return peak, width_px, quality(peak, width_px, *(getattr(self, name) for name in QUALITY_FLAGS))


def quality(
    peak: Floats, width_px: Floats, ambiguous: Booleans, saturated: Booleans, cut: Booleans, overflow: Booleans
) -> Floats:
    """How far a point may be trusted, 0 to 1, for arrays of one shape.

    quality = min(1, peak / 64) * min(1, width / 3, 32 / width)
              * 0.2 if ambiguous * 0.8 if saturated * 0.5 if cut * 0 if overflow

    A peak of 64 grey levels above the floor stands well clear of noise; a run narrower than 3 px carries no fraction of
    a pixel, one wider than 32 px is hardly a line. An ambiguous row may be another thing altogether. An over-exposed
    line is still measured on its flanks. A row that broke the camera's contract may be anything.
    """
    width = np.maximum(width_px, 1.0)
    result = np.minimum(1.0, peak / 64) * np.minimum(1.0, np.minimum(width / 3, 32 / width))
    for flag, factor in ((ambiguous, 0.2), (saturated, 0.8), (cut, 0.5), (overflow, 0.0)):
        result = np.where(flag, factor * result, result)
    return result


_JUDGED = ("ambiguous", "width")
"""First and last of the fields of a compact row that peak, width and quality depend on."""


@cache
def _compact_judged() -> tuple[Floats, Floats, Floats]:
    """Of each value that these fields have together."""
    layout = protocol.COMPACT_ROW
    offset, _ = layout.place(_JUDGED[0])
    words = np.arange(1 << layout.bits - offset, dtype="<u4") << offset
    return Rows(RowForm.COMPACT, np.zeros(len(words), np.int64), words.tobytes())._judge()
