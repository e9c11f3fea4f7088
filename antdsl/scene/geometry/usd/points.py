"""The points and empties of a USD stage, which the reader process collects and this process checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class UsdPoints:
    """Points or empties of a USD file.

    `positions` (frames, n, 3): in mm; a single frame if all are static.
    `radius` (n,): in mm; nan if the file has none.
    `values`: by name, primvars and user properties with one number per point, in the file's units; nan for points without a
    number.
    `texts`: by name, user properties that are words; "" for points without a word.
    `ahead` (n, 3): the direction of an empty's +x at the first frame; nan for points, which have no direction.
    `unit`: the file's unit of length in mm."""

    names: tuple[str, ...]
    positions: Floats
    radius: Floats
    values: Mapping[str, Floats]
    texts: Mapping[str, tuple[str, ...]]
    ahead: Floats
    unit: float
