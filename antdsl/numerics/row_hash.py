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
from collections.abc import Iterable, Sequence
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled

if TYPE_CHECKING:
    from antdsl.numerics.row_hash_compiled import Table

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
    if compiled.wanted(count):
        from antdsl.numerics.row_hash_compiled import Table

        kept = [np.ascontiguousarray(column) for column in (columns if ids is None else (ids, *columns))]
        return _told(Table(kept, keys, ids=ids is not None).sums(count))
    words = _words(columns)
    sums = [0, 0]
    for begin in range(0, count, BLOCK):
        size = min(BLOCK, count - begin)
        first, second = np.zeros((2, size), np.int64)
        block = np.arange(begin, begin + size, dtype=np.int64) if ids is None else np.ascontiguousarray(ids[begin : begin + size])
        _fold([(0, (block,))], first, second, 0)
        _fold(words, first, second, begin)
        for lane, found in enumerate(_finish(first, second)):
            sums[lane] += int(found)
    return _told(sums)


def _told(sums: Sequence[int]) -> bytes:
    return b"".join((int(each) & _WHOLE).to_bytes(8, "little") for each in sums)


class RowHash:
    """`row_hash` of tables that mostly lie where they did time after time, which is looked up once."""

    def __init__(self) -> None:
        self._arrays: list[NDArray[Any]] = []  # the ids first, where there are any
        self._table: Table | None = None

    def of(self, ids: NDArray[np.int64] | None, columns: Sequence[NDArray[Any]]) -> bytes:
        """Of columns [n] or [n, k], the rows of which count as k columns. Those of fewer than four bytes a value lie in one
        piece."""
        arrays = list(columns) if ids is None else [ids, *columns]
        count = len(arrays[0])
        if not compiled.wanted(count):
            return row_hash(ids, [part for column in columns for part in _parts(column.T)])
        table = self._table
        if table is None or len(arrays) != len(self._arrays) or not table.lie(arrays, self._arrays):
            from antdsl.numerics.row_hash_compiled import Table

            self._table = table = Table(arrays, keys, ids=ids is not None)
        self._arrays = arrays
        return _told(table.sums(count))


def _parts(column: NDArray[Any]) -> Sequence[NDArray[Any]]:
    """The arrays [n] of one whose last axis has the rows."""
    if column.ndim < 3:
        return [column] if column.ndim == 1 else list(column)
    return list(column.reshape(-1, column.shape[-1]))


def named(names: tuple[str, ...], columns: Iterable[NDArray[Any]]) -> bytes:
    """What a digest has to take in of columns besides the hash of the rows: their names and types."""
    return _named(names, tuple([column.dtype for column in columns]))


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
def keys(number: int) -> Longs:
    """The keys of a word by its number in the row: of its first and its second half in one lane, then in the other, 32 bits each.
    Two numbers of SplitMix64 that begins at 0."""
    found: list[int] = []
    for each in (2 * number + 1, 2 * number + 2):
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
        own = keys(number).astype(np.uint32)
        for lane, of_a, of_b in ((first, *own[:2]), (second, *own[2:])):
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
