"""Fast sorting of many rows: integers by a radix sort with sixteen bits per pass, and points along a space-filling curve."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import I64, U64, Array1, Array2, inlined, kernel, simd_range
from antdsl.numerics import parallel

_DIGIT_BITS = 16  # NumPy uses a radix sort for numbers of this width


def sort_stably(keys: NDArray[np.integer[Any]]) -> NDArray[np.intp]:
    """Return the order that sorts integer keys [n] stably, like `argsort(keys, kind="stable")` (D. E. Knuth, The Art of
    Computer Programming 3, 5.2.5)."""
    if not keys.size:
        return np.empty(0, np.intp)
    low, high = int(keys.min()), int(keys.max())
    if high - low >= 1 << 3 * _DIGIT_BITS:
        return np.argsort(keys, kind="stable")
    rest = keys.astype(np.int64) - low
    order = np.argsort(rest.astype(np.uint16), kind="stable")
    for shift in range(_DIGIT_BITS, (high - low).bit_length(), _DIGIT_BITS):
        order = order.take(np.argsort((rest >> shift).astype(np.uint16).take(order), kind="stable"))
    return order


def invert_order(order: NDArray[np.intp]) -> NDArray[np.int32]:
    """Return the rank of each row, int32 [n]: the inverse permutation. `order`: the row numbers in sorted order."""
    result = np.empty(len(order), np.int32)
    result[order] = np.arange(len(order), dtype=np.int32)
    return result


def compute_morton_codes(cells: NDArray[np.uint64], threads: int = 1) -> NDArray[np.uint64]:
    """Return the Morton codes (Z-order) of cells [n,3], which interleave the bits of the three coordinates (G. Morton 1966).
    Only the lowest 21 bits of each coordinate are used."""
    code = np.zeros(len(cells), np.uint64)
    parallel.run_in_parts(
        partial(write_morton_codes, np.ascontiguousarray(cells), code), len(cells), threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD
    )
    return code


@inlined
def _spread_bits(bits: U64) -> U64:
    """Return a 21-bit number with two zero bits inserted after each bit."""
    bits = (bits | (bits << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    bits = (bits | (bits << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    bits = (bits | (bits << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    bits = (bits | (bits << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (bits | (bits << np.uint64(2))) & np.uint64(0x1249249249249249)


@kernel
def write_morton_codes(cells: Array2[U64], code: Array1[U64], begin: I64, end: I64) -> None:
    """Write the Morton code of each cell [n,3] to `code` [n], for cells `begin` to before `end`."""
    for n in simd_range(begin, end):
        x, y, z = _spread_bits(cells[n, 0]), _spread_bits(cells[n, 1]), _spread_bits(cells[n, 2])
        code[n] = x | (y << np.uint64(1)) | (z << np.uint64(2))


@inlined
def find_lower_bound(keys: Array1[I64], key: I64, first: I64, last: I64) -> I64:
    """Return the index of the first sorted key that is not less than `key`, found by bisection between the indices `first` and
    `last`."""
    a, b = first, last
    while a < b:
        middle = (a + b) >> 1
        if keys[middle] < key:
            a = middle + 1
        else:
            b = middle
    return a


@inlined
def compact_indices(flags: Array1[Any], count: I64) -> I64:
    """Overwrite `flags` from its start with the indices of all 1s among its first `count` entries. Return the number of 1s."""
    hits = 0
    for k in range(count):
        flag = flags[k]
        flags[hits] = k  # always written, to avoid an unpredictable branch
        hits += flag
    return hits
