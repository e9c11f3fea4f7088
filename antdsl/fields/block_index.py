"""Searches sorted integers by blocks, and computes ranks and sums within groups."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_MAX_BLOCKS = 8_000_000  # maximum number of blocks in an index


@dataclass(frozen=True, slots=True, eq=False)
class BlockIndex:
    """A search index for ascending numbers, which are divided into blocks. The numbers in a block have equal values of `number
    >> shift`. `block_starts` [blocks + 1]: the position of each block's first number. `bisection_steps`: the number of
    bisection steps needed to search the fullest block."""

    shift: int
    block_starts: NDArray[np.int32]
    bisection_steps: int

    @staticmethod
    def build(ascending_numbers: NDArray[np.int64], end_number: int) -> BlockIndex:
        """Build the index for `ascending_numbers`, which are at least 0 and below `end_number`."""
        shift = max(0, int(end_number // min(_MAX_BLOCKS, 4 * len(ascending_numbers) + 1)).bit_length())
        start = np.zeros((end_number >> shift) + 2, np.int32)
        np.cumsum(np.bincount(ascending_numbers >> shift, minlength=len(start) - 1), out=start[1:])
        return BlockIndex(shift, start, int(np.diff(start).max(initial=0)).bit_length())

    def count_smaller(self, numbers: NDArray[np.int64], targets: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return, for each of `targets`, how many of `numbers` are smaller.

        `numbers`: the numbers for which the index was built. `targets`: at least 0 and below the `end_number` of `build`."""
        block = targets >> self.shift
        low, high = self.block_starts.take(block).astype(np.int64), self.block_starts.take(block + 1).astype(np.int64)
        for _ in range(self.bisection_steps):
            middle = (low + high) >> 1
            is_less = (numbers.take(np.minimum(middle, len(numbers) - 1)) < targets) & (low < high)
            low, high = np.where(is_less, middle + 1, low), np.where(is_less, high, middle)
        return low


EMPTY_BLOCK_INDEX = BlockIndex(0, np.zeros(1, np.int32), 0)
EMPTY_CELLS = np.empty(0, np.int32)


def compute_group_ranks(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rank (0, 1, …) of each element within its group. Groups are consecutive; `counts`: the number of elements in
    each."""
    ranks: NDArray[np.int64] = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    return ranks


def sum_by_key(keys: NDArray[np.int64], terms: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the distinct keys, ascending, and for each key the sum of its `terms`."""
    order = np.argsort(keys, kind="stable")
    keys, terms = keys[order], terms[order]
    if not len(keys):
        return keys, terms
    first = np.flatnonzero(np.concatenate(([True], keys[1:] != keys[:-1])))
    return keys[first], np.add.reduceat(terms, first, axis=0)
