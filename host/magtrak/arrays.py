"""Names for the array types that the package uses."""

from typing import Any

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
