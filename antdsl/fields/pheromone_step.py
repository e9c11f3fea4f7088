"""Loops of `pheromone`: a step of a field as one pass over its cells, and the strongest of the cells around each."""

import numpy as np

from antdsl.machine_code.kernels import F64, I32, I64, Array1, Array2, independent, kernel


@kernel
def flowed(
    held: Array1[F64],
    data: Array1[F64],
    cell: Array1[I32],
    start: Array1[I64],
    out: Array1[F64],
    change: Array1[F64],
    begin: I64,
    end: I64,
) -> None:
    """Write what flows into each cell from `begin` to before `end` less what flows out: from its linked cells
    `cell[start[n]:start[n+1]]`, of whose amounts comes the share `data`; `out` is the share of its own that leaves it."""
    for n in range(begin, end):
        total = 0.0
        for k in range(start[n], start[n + 1]):
            total += data[k] * held[cell[k]]
        change[n] = total - out[n] * held[n]


@kernel
def stepped(
    held: Array1[F64],
    change: Array1[F64],
    pending: Array1[I64],
    spread: F64,
    keep: F64,
    unit: F64,
    limit: F64,
    least: F64,
    lands: I64,
    begin: I64,
    end: I64,
) -> None:
    """Take cells from `begin` to before `end` through a step: `spread` of the `change` is added (an empty array: none), the share
    `keep` stays, then deposits `pending`, in units, are added (`lands` 1) or are the least that is there (2), and what is no more
    than the `least` is nothing. `pending` is 0 afterwards."""
    spreads = change.size > 0
    for n in independent(begin, end):
        value = held[n]
        if spreads:
            value += spread * change[n]
        value *= keep
        if lands > 0:
            landed = np.float64(pending[n]) * unit
            if lands == 1:
                value += landed
            elif landed > value:
                value = landed
            pending[n] = 0
        value = min(value, limit)
        if value < least:
            value = 0.0
        held[n] = value


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
