"""The compiled half of a pheromone's sense: each asking cell's block is looked through once.

The same bits as `pheromone.PheromoneField.strongest` gives with NumPy. Imported only where `compiled.wanted` says so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.kernel_cache import njit


@njit(cache=True, nogil=True, error_model="numpy")
def strongest(
    own: NDArray[np.int32],
    block: NDArray[np.int32],
    held: NDArray[np.float64],
    best: NDArray[np.int64],
    value: NDArray[np.float64],
) -> None:
    """For own cells [n] (-1: none), the first of the cells in their row of `block` [cells, k] that hold most, and how much.

    `held` [cells + 1] has 0 for no cell; where nothing is held, `best` is the own cell and `value` 0.
    """
    none = np.int64(held.size - 1)
    for n in range(own.size):
        cell = np.int64(own[n])
        where, most = cell, 0.0
        if cell < 0:
            where = none
        else:
            for k in range(block.shape[1]):
                at = block[cell, k]
                if held[at] > most:
                    where, most = np.int64(at), held[at]
        best[n], value[n] = where, most
