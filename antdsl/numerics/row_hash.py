"""A hash of a table that does not depend on the order of its rows: 128 bits, the sum over rows of a mixed word of each.

A row is taken as 32-bit halves in pairs. Two lanes of 64 bits each add up the products of such pairs, to whose halves keys were
added: the hash NH (J. Black, S. Halevi, H. Krawczyk, T. Krovetz, P. Rogaway, UMAC: Fast and Secure Message Authentication,
CRYPTO 1999), with keys of their own for each pair and lane, by SplitMix64 (G. Steele, D. Lea, C. Flood, Fast Splittable
Pseudorandom Number Generators, OOPSLA 2014). Each lane of a row then goes through the finaliser of MurmurHash3 (A. Appleby,
`fmix64`, 2011), a bijection, and is added to that of the other rows, modulo 2^64. The first pair of a row is its id, so that
values which change places between rows change the sum too.

Where one 32-bit half of one row differs, the hash differs for certain: a lane keeps its product only where the other half and its
key come to 0, and no two lanes have the same key. Any other difference is missed once in 2^64 or less, as long as nobody knows
the keys and looks for one that is missed: this finds faults, not forgeries.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled

BLOCK = 1 << 14  # rows at once: their lanes stay near the processor
_HALF = 0xFFFFFFFF
_WHOLE = 0xFFFFFFFFFFFFFFFF
Keys = tuple[int, int, int, int]  # of the first and the second half in one lane, then in the other; 32 bits each


def row_hash(ids: NDArray[np.int64] | None, columns: Sequence[NDArray[Any]]) -> bytes:
    """16 bytes for a table with these columns, [n] each, of 1, 2, 4 or 8 bytes a value. `ids` int64[n] are different from each
    other; None: the numbers of the rows, for a table whose rows have an order."""
    count = len(columns[0]) if ids is None else len(ids)
    fold, finish = _kernels() if compiled.wanted(count) else (_fold, _finish)
    words = list(_words(columns))
    keys = [_keys(number) for number in range(len(words) + 1)]
    sums = [0, 0]
    for begin in range(0, count, BLOCK):
        rows = slice(begin, min(begin + BLOCK, count))
        lanes = np.zeros((2, rows.stop - begin), np.int64)
        block = np.arange(begin, rows.stop, dtype=np.int64) if ids is None else np.ascontiguousarray(ids[rows])
        fold((block,), keys[0], lanes[0], lanes[1])
        for word, each in zip(words, keys[1:], strict=True):
            fold(tuple(half[rows] for half in word), each, lanes[0], lanes[1])
        for lane, found in enumerate(finish(lanes[0], lanes[1])):
            sums[lane] = (sums[lane] + int(found)) & _WHOLE
    return b"".join(each.to_bytes(8, "little") for each in sums)


def hashed_rows(ids: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """What a digest has to take in of agents with these ids: the names and types of their columns, and the hash of the rows. The
    agents are the last axis of a column."""
    names = "".join(f"\0{name} {array.dtype.str}" for name, array in columns.items())
    parts = [row for array in columns.values() for row in array.reshape(-1, len(ids))] if len(ids) else []
    return names.encode() + row_hash(ids, parts)


def _words(columns: Sequence[NDArray[Any]]) -> Iterator[tuple[NDArray[Any], ...]]:
    """The columns as 64-bit words: one of int64[n], or two halves of int32[n] each. An odd one is its own second half."""
    held: NDArray[np.int32] | None = None
    for column in columns:
        column = np.ascontiguousarray(column)
        size = column.dtype.itemsize
        if size == 8:
            yield (column.view(np.int64),)
            continue
        half = column.view(np.int32) if size == 4 else column.view((np.int8, np.int16)[size - 1]).astype(np.int32)
        if held is None:
            held = half
        else:
            yield held, half
            held = None
    if held is not None:
        yield held, held


@cache
def _keys(number: int) -> Keys:
    """The keys of a pair, by its number in the row: two numbers of SplitMix64 that begins at 0."""
    found: list[int] = []
    for each in (2 * number, 2 * number + 1):
        z = (each + 1) * 0x9E3779B97F4A7C15 & _WHOLE
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & _WHOLE
        z = (z ^ z >> 27) * 0x94D049BB133111EB & _WHOLE
        z ^= z >> 31
        found += [z & _HALF, z >> 32]
    return found[0], found[1], found[2], found[3]


def _fold(word: tuple[NDArray[Any], ...], keys: Keys, first: NDArray[np.int64], second: NDArray[np.int64]) -> None:
    """Add the products of a word to both lanes."""
    if len(word) == 1:
        halves = word[0].view(np.uint32).reshape(-1, 2)
        a, b = (halves[:, 0], halves[:, 1]) if np.little_endian else (halves[:, 1], halves[:, 0])
    else:
        a, b = (half.view(np.uint32) for half in word)
    for lane, (of_a, of_b) in ((first, keys[:2]), (second, keys[2:])):
        product = np.multiply(a + np.uint32(of_a), b + np.uint32(of_b), dtype=np.uint64)
        lane += product.view(np.int64)


def _finish(first: NDArray[np.int64], second: NDArray[np.int64]) -> tuple[int, int]:
    """The sums of all rows of both lanes, each row mixed, modulo 2^64."""
    found = []
    for lane in (first, second):
        h = lane.view(np.uint64)
        h = (h ^ h >> np.uint64(33)) * np.uint64(0xFF51AFD7ED558CCD)
        h = (h ^ h >> np.uint64(33)) * np.uint64(0xC4CEB9FE1A85EC53)
        found.append(int((h ^ h >> np.uint64(33)).sum(dtype=np.uint64)))
    return found[0], found[1]


@cache
def _kernels() -> tuple[Any, Any]:
    from antdsl.numerics import row_hash_compiled as kernels

    def fold(word: tuple[NDArray[Any], ...], keys: Keys, first: NDArray[np.int64], second: NDArray[np.int64]) -> None:
        if len(word) == 1:
            kernels.fold_whole(word[0], *keys, first, second)
        else:
            kernels.fold_halves(*word, *keys, first, second)

    return fold, kernels.finish
