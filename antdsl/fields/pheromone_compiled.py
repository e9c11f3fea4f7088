"""The compiled half of a pheromone's sense: each asking cell's block is looked through once.

The same bits as `pheromone.PheromoneField.strongest` gives with NumPy. Imported only where `compiled.wanted` says so.
"""

from __future__ import annotations

from antdsl.machine_code.kernels import F64, I32, I64, Array1, Array2, kernel


@kernel
def strongest(own: Array1[I32], block: Array2[I32], held: Array1[F64], best: Array1[I64], value: Array1[F64]) -> None:
    """For own cells [n] (-1: none), the first of the cells in their row of `block` [cells, k] that hold most, and how much.

    `held` [cells + 1] has 0 for no cell; where nothing is held, `best` is the own cell and `value` 0.
    """
    none = held.size - 1
    for n in range(own.size):
        cell = own[n]
        where, most = cell, 0.0
        if cell < 0:
            where = none
        else:
            for k in range(block.shape[1]):
                at = block[cell, k]
                if held[at] > most:
                    where, most = at, held[at]
        best[n], value[n] = where, most
