"""Tracks the cells near which a pheromone reaches a threshold. Each step updates only the cells for which this changes."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.growing import GrowingCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, U8, Array1, allocate_scratch, kernel, simd_range
from antdsl.numerics import parallel

_MAX_BLOCK_TABLE_ENTRIES = 1 << 22  # most entries of the table of blocks; its inverse needs the same memory
_CELLS_PER_CHUNK = 512  # cells per chunk: compared first, then the changed ones are written


class CellsNearThreshold:
    """The set of all cells with a strong cell among their `k` nearest cells. A cell is strong if its amount is at least
    `threshold`. The set contains all cells in three cases: `threshold` is 0 or less, the field can get new cells, or a table
    would be too large."""

    def __init__(self, field: PheromoneField, threshold: np.float32, k: int) -> None:
        self._inputs, self._k = (field, field.version, threshold), k
        cells = field.cells
        self._is_always_above = not threshold > 0 or isinstance(cells, GrowingCells) or len(cells) * k > _MAX_BLOCK_TABLE_ENTRIES
        self._near_counts = np.full(
            len(cells) + 1, self._is_always_above, np.uint8
        )  # number of cells above the threshold in each block
        self._is_above = np.zeros(0 if self._is_always_above else len(cells), np.bool_)
        self._changed_buffer = np.empty(len(self._is_above), np.int64)

    def has_same_settings(self, field: PheromoneField, threshold: np.float32) -> bool:
        """Return whether this object was made for `field` with its current cells, and for `threshold`."""
        own_field, own_version, own_threshold = self._inputs
        return own_field is field and own_version == field.version and own_threshold == threshold

    def update_counts(self, threads: int = 1) -> NDArray[np.uint8]:
        """Return for each cell how many of its nearest cells reach the threshold now, uint8[cells + 1].

        The last entry stands for "no cell". The next call overwrites the array."""
        if not self._is_always_above:
            changed = self._find_changed_cells(threads)
            if len(changed):
                update_counts(changed, *self._inputs[0].get_dependent_cells(self._k), self._is_above, self._near_counts)
        return self._near_counts

    def _find_changed_cells(self, threads: int) -> NDArray[np.int64]:
        """Return the cells with an amount that crossed the threshold since the last call, in either direction."""
        (field, _, threshold), is_above = self._inputs, self._is_above
        work = partial(write_changed_cells, field.padded_values, threshold, is_above, self._changed_buffer)
        return parallel.join_parts(
            parallel.run_in_parts(work, len(is_above), threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD), self._changed_buffer
        )[0]


@kernel
def write_changed_cells(
    values: Array1[F64], threshold: F32, is_above: Array1[BOOL], changed: Array1[I64], begin: I64, end: I64
) -> tuple[I64, I64]:
    """Find the cells from `begin` to before `end` with an outdated entry in `is_above`.

    Write them to `changed`, from index `begin` on. Return `begin` and the number of cells written. `is_above`: whether each
    cell's amount, as float32, was at least `threshold`."""
    other, count = allocate_scratch(_CELLS_PER_CHUNK, I32), 0
    for low in range(begin, end, 512):
        high = min(low + _CELLS_PER_CHUNK, end)
        for n in simd_range(low, high):
            other[n - low] = 1 if (np.float32(values[n]) >= threshold) != is_above[n] else 0
        for n in range(low, high):
            if other[n - low] != 0:
                changed[begin + count] = n
                count += 1
    return begin, count


@kernel
def update_counts(changed: Array1[I64], start: Array1[I64], cell: Array1[I32], is_above: Array1[BOOL], count: Array1[U8]) -> None:
    """Invert `is_above` for the cells `changed`, and update `count` for all cells near them. `count`: for each cell, how many
    of its nearest cells reach the threshold. `cell[start[a]:start[a+1]]`: the cells that have cell a among their nearest
    cells."""
    for n in range(changed.size):
        a = changed[n]
        change = -1 if is_above[a] else 1
        is_above[a] = not is_above[a]
        for k in range(start[a], start[a + 1]):
            count[cell[k]] += change
