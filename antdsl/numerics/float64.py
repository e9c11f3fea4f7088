"""Values of files as float64."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def to_float64(values: NDArray[Any]) -> NDArray[np.float64]:
    """A copy as float64. NumPy would warn of a signalling NaN in it; readers check that values are finite."""
    with np.errstate(invalid="ignore"):
        return values.astype(np.float64)
