"""Directions in three bytes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime import Population
from antdsl.runtime.world import AXES


def turn(population: Population, name: str, rows: NDArray[np.intp]) -> NDArray[np.int8]:
    """Unit vectors of agents, int8 (n, 3): 127 is 1."""
    turned = np.empty((len(rows), 3), np.int8)
    for axis, letter in enumerate(AXES):
        turned[:, axis] = np.rint(population.now[f"{name}.{letter}"][rows] * np.float32(127))
    return turned
