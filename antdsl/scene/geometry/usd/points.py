"""Points and empties of a USD stage. The reader process collects them, and this process checks them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class UsdPoints:
    """Points or empties.

    `positions` (frames, n, 3): in mm; one frame if all are static.
    `radius` (n,): in mm; nan if the file has none.
    `values`: by name, primvars and user properties with one number per point, in the file's units; nan where a point has none.
    `texts`: by name, user properties that are words; "" where a point has none.
    `ahead` (n, 3): the direction of the empty's +x at the first frame; nan for points, which have no direction.
    `unit`: the file's unit of length in mm."""

    names: tuple[str, ...]
    positions: Floats
    radius: Floats
    values: Mapping[str, Floats]
    texts: Mapping[str, tuple[str, ...]]
    ahead: Floats
    unit: float
