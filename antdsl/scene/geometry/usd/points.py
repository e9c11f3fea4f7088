"""Points and empties of a USD stage: as the reader process collects them, and as this process has them after the checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class UsdPoints:
    """`positions` (frames, n, 3) in mm, one frame if all are static. `radius` (n,) in mm, nan if the file has none.

    `values`: primvars and user properties with one number per point, by name, in the file's units, nan if a point has none.
    `texts`: user properties that are words, "" if there is none. `ahead` (n, 3): the direction of each one's own +x at the first
    frame, nan for points, which have no direction. `unit`: the file's unit of length in mm."""

    names: tuple[str, ...]
    positions: Floats
    radius: Floats
    values: Mapping[str, Floats]
    texts: Mapping[str, tuple[str, ...]]
    ahead: Floats
    unit: float
