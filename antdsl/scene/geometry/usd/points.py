"""Points and empties of a USD stage, as the reader's process collects them and as the other process has them once checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class UsdPoints:
    """`places` (frames, n, 3) in mm, one frame where all stand still. `radius` (n,) in mm, nan where the file says nothing.
    `values`: primvars and user properties with one number a point, by name, in the file's units, nan where a point has none;
    `texts`: user properties that are words, "" where there is none. `ahead` (n, 3): where each one's own +x leads at the first
    frame, nan for points, which face no way. `unit`: the file's unit of length in mm."""

    names: tuple[str, ...]
    places: Floats
    radius: Floats
    values: Mapping[str, Floats]
    texts: Mapping[str, tuple[str, ...]]
    ahead: Floats
    unit: float
