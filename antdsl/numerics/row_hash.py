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

import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled

BLOCK = 1 << 14  # rows at once: their lanes stay near the processor
_HALF = 0xFFFFFFFF
_WHOLE = 0xFFFFFFFFFFFFFFFF
_INT64, _INT32, _INT16, _INT8 = (np.dtype(each) for each in (np.int64, np.int32, np.int16, np.int8))
Longs = NDArray[np.int64]
Words = list[tuple[int, tuple[NDArray[Any], ...]]]


def row_hash(ids: NDArray[np.int64] | None, columns: Sequence[NDArray[Any]]) -> bytes:
    """16 bytes for a table with these columns, [n] each, of 1, 2, 4 or 8 bytes a value. `ids` int64[n] are different from each
    other; None: the numbers of the rows, for a table whose rows have an order."""
    count = len(columns[0]) if ids is None else len(ids)
    words = _words(columns)
    if compiled.wanted(count):
        fold, finish, numbered = _kernels()
        if ids is None and len(words) == 1 == len(words[0][1]):
            return _told(numbered(words[0][1][0], _keys(0, 1)))
    else:
        fold, finish = _fold, _finish
    sums = [0, 0]
    for begin in range(0, count, BLOCK):
        size = min(BLOCK, count - begin)
        first, second = np.zeros((2, size), np.int64)
        block = np.arange(begin, begin + size, dtype=np.int64) if ids is None else np.ascontiguousarray(ids[begin : begin + size])
        fold([(0, (block,))], first, second, 0)
        fold(words, first, second, begin)
        for lane, found in enumerate(finish(first, second)):
            sums[lane] += int(found)
    return _told(sums)


def _told(sums: Sequence[int]) -> bytes:
    return b"".join((int(each) & _WHOLE).to_bytes(8, "little") for each in sums)


def hashed_rows(ids: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """What a digest has to take in of agents with these ids: the names and types of their columns, and the hash of the rows. The
    agents are the last axis of a column."""
    arrays = columns.values()
    named = _named(tuple(columns), tuple([array.dtype for array in arrays]))
    parts: list[NDArray[Any]] = []
    for array in arrays if len(ids) else ():
        parts.extend([array] if array.ndim == 1 else array.reshape(-1, len(ids)))
    return named + row_hash(ids, parts)


@lru_cache(64)
def _named(names: tuple[str, ...], types: tuple[np.dtype[Any], ...]) -> bytes:
    return "".join(f"\0{name} {dtype.str}" for name, dtype in zip(names, types, strict=True)).encode()


def _words(columns: Sequence[NDArray[Any]]) -> Words:
    """The columns as 64-bit words: int64[n], or two halves of int32[n] each, numbered from 1 on as they become whole. An odd half
    is its own second one."""
    found: Words = []
    held: NDArray[np.int32] | None = None
    for column in columns:
        column, dtype = np.ascontiguousarray(column), column.dtype
        if dtype is _INT32:
            half = column
        elif dtype.itemsize == 8:
            found.append((len(found) + 1, (column.view(_INT64),)))
            continue
        elif dtype.itemsize == 4:
            half = column.view(_INT32)
        else:
            half = column.view((_INT8, _INT16)[dtype.itemsize - 1]).astype(_INT32)
        if held is not None:
            found.append((len(found) + 1, (held, half)))
        held = half if held is None else None
    return found if held is None else [*found, (len(found) + 1, (held, held))]


@cache
def _keys(*numbers: int) -> Longs:
    """The keys of words by their numbers in the row: for each, of its first and its second half in one lane, then in the other,
    32 bits each. Two numbers of SplitMix64 that begins at 0."""
    found: list[int] = []
    for each in (2 * number + k for number in numbers for k in (1, 2)):
        z = each * 0x9E3779B97F4A7C15 & _WHOLE
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & _WHOLE
        z = (z ^ z >> 27) * 0x94D049BB133111EB & _WHOLE
        z ^= z >> 31
        found += [z & _HALF, z >> 32]
    return np.array(found, np.int64)


def _fold(words: Words, first: Longs, second: Longs, begin: int) -> None:
    """Add the products of words, from their row `begin` on, to both lanes."""
    for number, word in words:
        parts = [half[begin : begin + len(first)].view(np.uint32) for half in word]
        if len(parts) == 1:
            pairs = parts[0].reshape(-1, 2)
            parts = [pairs[:, 0], pairs[:, 1]] if sys.byteorder == "little" else [pairs[:, 1], pairs[:, 0]]
        keys = _keys(number).astype(np.uint32)
        for lane, of_a, of_b in ((first, *keys[:2]), (second, *keys[2:])):
            product = np.multiply(parts[0] + of_a, parts[1] + of_b, dtype=np.uint64)
            lane += product.view(np.int64)


def _finish(first: Longs, second: Longs) -> tuple[int, int]:
    """The sums of all rows of both lanes, each row mixed, modulo 2^64."""
    found = []
    for lane in (first, second):
        h = lane.view(np.uint64)
        h = (h ^ h >> np.uint64(33)) * np.uint64(0xFF51AFD7ED558CCD)
        h = (h ^ h >> np.uint64(33)) * np.uint64(0xC4CEB9FE1A85EC53)
        found.append(int((h ^ h >> np.uint64(33)).sum(dtype=np.uint64)))
    return found[0], found[1]


@cache
def _kernels() -> tuple[Any, Any, Any]:
    from antdsl.numerics import row_hash_compiled as kernels

    def fold(words: Words, first: Longs, second: Longs, begin: int) -> None:
        wholes = [(number, word[0]) for number, word in words if len(word) == 1]
        halves = [(number, word) for number, word in words if len(word) == 2]
        for numbers, some in _fours(wholes):
            kernels.fold_wholes(some, _keys(*numbers), first, second, begin)
        for number, word in wholes[len(wholes) // 4 * 4 :]:
            kernels.fold_whole(word, _keys(number), first, second, begin)
        for numbers, some in _fours(halves):
            kernels.fold_halves(*zip(*some, strict=True), _keys(*numbers), first, second, begin)
        for number, (low, high) in halves[len(halves) // 4 * 4 :]:
            kernels.fold_half(low, high, _keys(number), first, second, begin)

    return fold, kernels.finish, kernels.numbered


def _fours(words: Sequence[tuple[int, Any]]) -> Iterator[tuple[tuple[int, ...], tuple[Any, ...]]]:
    """Numbers and arrays of four words at a time, as far as there are so many."""
    for k in range(0, len(words) // 4 * 4, 4):
        numbers, some = zip(*words[k : k + 4], strict=True)
        yield numbers, some
