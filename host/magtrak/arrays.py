"""Names for the array types that the package uses."""

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
"""float64, any shape."""

Integers = npt.NDArray[np.int64]
"""int64, any shape."""

Booleans = npt.NDArray[np.bool_]
"""bool, any shape."""

Records = npt.NDArray[np.void]
"""A structured array."""

Numbers = npt.NDArray[Any]
"""Numbers of any type."""

Array = TypeVar("Array", bound=npt.NDArray[Any])


def joined(arrays: Sequence[Array]) -> Array:
    """One after the other; a single one is not copied."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)  # type: ignore[return-value]
