"""A 128-bit hash of a table that does not depend on the order of its rows.

It is the sum of the mixed hashes of all rows. A row is read as 64-bit words, each a pair of 32-bit halves. There are two
64-bit lanes. Each lane adds keys to the halves, multiplies the halves of each pair, and sums the products. This is the hash NH
(J. Black, S. Halevi, H. Krawczyk, T. Krovetz, P. Rogaway, UMAC: Fast and Secure Message Authentication, CRYPTO 1999). Its keys
differ for each pair and lane; SplitMix64 generates them (G. Steele, D. Lea, C. Flood, Fast Splittable Pseudorandom Number
Generators, OOPSLA 2014). Each lane of a row is then mixed by the finaliser of MurmurHash3 (A. Appleby, `fmix64`, 2011), a
bijection. The mixed lanes of all rows are added modulo 2^64. The first pair of a row is its id. So the sum also changes if
rows exchange values. A difference in a single 32-bit half of one row always changes the hash. The product in a lane stays the
same only if the other half and its key add up to 0. The lanes have different keys, so the product in the other lane changes.
Any other difference is missed with a probability of at most 2^-64, unless an attacker who knows the keys constructs it. The
hash detects faults, not forgeries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from operator import is_not
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.memory import get_array_address
from antdsl.numerics import parallel
from antdsl.numerics.processor.host import PARTS_PER_THREAD
from antdsl.numerics.row_hash.loops import (
    CONTIGUOUS_WORD_KIND,
    HALF_WORDS_KIND,
    ROW_NUMBER_WORD_KIND,
    STRIDED_WORD_KIND,
    TABLE_HEADER_WORDS,
    TABLE_WORDS_PER_WORD,
    build_llvm_text,
)

_LOW_32_BITS = 0xFFFFFFFF
_MASK_64 = 0xFFFFFFFFFFFFFFFF
Int64Array = NDArray[np.int64]


def hash_rows(ids: NDArray[np.int64] | None, columns: Sequence[NDArray[Any]]) -> bytes:
    """Return the hash (16 bytes) of a table with these columns. Each column is an array [n] with 1, 2, 4 or 8 bytes per value.
    `ids`: int64 [n], all different. None means row numbers; then the order of the rows matters."""
    count = len(columns[0]) if ids is None else len(ids)
    arrays = [np.ascontiguousarray(column) for column in (columns if ids is None else (ids, *columns))]
    return _to_digest(HashTable(arrays, compute_word_keys, ids=ids is not None).compute_sums(count))


def _to_digest(sums: Sequence[int]) -> bytes:
    """Return the two 64-bit sums as 16 bytes."""
    return b"".join((int(each) & _MASK_64).to_bytes(8, "little") for each in sums)


class RowHasher:
    """A hasher for tables that usually have the same arrays as in the previous call. It stores the addresses of the arrays for
    the next call."""

    def __init__(self) -> None:
        self._arrays: list[NDArray[Any]] = []  # the ids first, if there are ids
        self._table: HashTable | None = None
        self._split_arrays: list[NDArray[Any]] = []
        self._split_columns: list[NDArray[Any]] = []

    def split_columns(self, arrays: Sequence[NDArray[Any]], has_several: Sequence[bool]) -> list[NDArray[Any]]:
        """Return the columns of all arrays in one list.

        `has_several`: for each array, whether it contains several columns along its first axis; otherwise it is one column. If
        the array objects are those of the previous call, the same list is returned."""
        if len(arrays) != len(self._split_arrays) or any(map(is_not, arrays, self._split_arrays)):
            self._split_arrays = list(arrays)
            self._split_columns = [
                part for array, each in zip(arrays, has_several, strict=True) for part in (array if each else (array,))
            ]
        return self._split_columns

    def hash_rows(self, ids: NDArray[np.int64] | None, columns: Sequence[NDArray[Any]], threads: int = 1) -> bytes:
        """Return the hash (16 bytes) of a table with these columns. Each is an array [n], or an array [n, k] for k columns.

        `ids`: int64 [n], as in the function `hash_rows`. Columns with fewer than four bytes per value must be contiguous."""
        arrays = list(columns) if ids is None else [ids, *columns]
        count = len(arrays[0])
        if not count:  # arrays without rows have arbitrary strides
            return _to_digest((0, 0))
        table = self._table
        if table is None or len(arrays) != len(self._arrays) or not table.replace_arrays(arrays, self._arrays):
            self._table = table = HashTable(arrays, compute_word_keys, ids=ids is not None)
        self._arrays = arrays
        return _to_digest(table.compute_sums(count, threads))


def describe_columns(names: tuple[str, ...], columns: Iterable[NDArray[Any]]) -> bytes:
    """Return the names and types of columns as bytes. The caller includes them in a digest, together with the hash of the
    rows."""
    return _describe_columns(names, tuple([column.dtype for column in columns]))


@lru_cache(64)
def _describe_columns(names: tuple[str, ...], types: tuple[np.dtype[Any], ...]) -> bytes:
    return "".join(f"\0{name} {dtype.str}" for name, dtype in zip(names, types, strict=True)).encode()


@cache
def compute_word_keys(number: int) -> Int64Array:
    """Return four 32-bit keys for a 64-bit word of a row, int64 [4].

    `number`: the word's number in the row. The first two keys are for the word's two halves in the first lane, the others for
    the second lane. Their bits come from two SplitMix64 numbers, started at 0."""
    halves: list[int] = []
    for each in (2 * number + 1, 2 * number + 2):
        z = each * 0x9E3779B97F4A7C15 & _MASK_64
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & _MASK_64
        z = (z ^ z >> 27) * 0x94D049BB133111EB & _MASK_64
        z ^= z >> 31
        halves += [z & _LOW_32_BITS, z >> 32]
    return np.array(halves, np.int64)


_WordPart = tuple[int, int, int]  # column, byte offset from its start, bytes between values


@dataclass(frozen=True, slots=True, eq=False)
class _ColumnForm:
    """The memory layout of a column's array: type, strides, shape without the first axis, and whether the array is contiguous."""

    dtype: np.dtype[Any]
    strides: tuple[int, ...]
    trailing_shape: tuple[int, ...]
    is_contiguous: bool


class HashTable:
    """The memory layout of a table's columns, for machine code.

    - `columns`: arrays [n] or [n, k], of 1, 2, 4 or 8 bytes per value; the table does not store the arrays
    - `keys`: a function that returns the four keys of a word, given the word's number in the row
    - `ids`: whether the first column contains the ids of the rows; otherwise row numbers are used as ids"""

    def __init__(self, columns: Sequence[NDArray[Any]], keys: Callable[[int], NDArray[np.int64]], *, ids: bool) -> None:
        self._column_forms = [_ColumnForm(each.dtype, each.strides, each.shape[1:], each.flags.c_contiguous) for each in columns]
        words: list[tuple[int, list[_WordPart]]] = [] if ids else [(ROW_NUMBER_WORD_KIND, [])]
        half: list[_WordPart] = []
        for k, column in enumerate(columns):
            size = column.itemsize
            step = size if column.ndim == 1 and column.flags.c_contiguous else column.strides[0]
            if size < 4 and step != size:
                raise ValueError("a column with fewer than four bytes per value must be contiguous in memory")
            for offset in (0,) if column.ndim == 1 else [column.strides[1] * part for part in range(column.shape[1])]:
                if size == 8:
                    words.append((CONTIGUOUS_WORD_KIND if step == size else STRIDED_WORD_KIND, [(k, offset, step)]))
                elif half:
                    words.append((HALF_WORDS_KIND, [*half, (k, offset, step)]))
                    half = []
                else:
                    half = [(k, offset, step)]
        if half:
            words.append((HALF_WORDS_KIND, half * 2))
        table: list[int] = []
        self._address_slots: list[list[tuple[int, int]]] = [
            [] for _ in columns
        ]  # for each column: words with its address, and offsets
        for number, (kind, parts) in enumerate(words):
            for place, (k, offset, _) in zip((1, 3), parts, strict=False):
                self._address_slots[k].append((len(table) + place, offset))
            steps = [word for _, _, step in parts for word in (0, step)]
            table += [kind, *steps, *[0] * (4 - len(steps)), *keys(number).tolist()]
        self._table = np.array(table, np.int64)
        self._chunk_headers: Int64Array = np.zeros((0, TABLE_HEADER_WORDS), np.int64)  # one header per chunk
        self._chunks: Int64Array = np.zeros((0, 3), np.int64)
        self.replace_arrays(columns, [None] * len(columns))

    def replace_arrays(self, columns: Sequence[NDArray[Any]], previous_columns: Sequence[NDArray[Any] | None]) -> bool:
        """Use the arrays `columns` instead of `previous_columns` if both have the same memory layout. Return whether this is the
        case."""
        for k, (column, other) in enumerate(zip(columns, previous_columns, strict=True)):
            if column is other:
                continue
            form, piece = self._column_forms[k], column.flags.c_contiguous  # always true for a single row
            if column.dtype is not form.dtype or column.strides != form.strides or column.shape[1:] != form.trailing_shape:
                return False
            if piece != form.is_contiguous:
                return False
            begin = get_array_address(column) if form.is_contiguous else column.ctypes.data
            for slot, offset in self._address_slots[k]:
                self._table[slot] = begin + offset
        return True

    def compute_sums(self, count: int, threads: int = 1) -> tuple[int, int]:
        """Return the sums of both lanes over `count` rows, modulo 2^64. The lanes of each row are mixed before they are added."""
        chunks = 1 if threads < 2 else max(1, min(PARTS_PER_THREAD * threads, count // parallel.MIN_AGENTS_PER_THREAD))
        if len(self._chunk_headers) != chunks or self._chunks[-1, 2] != count:
            self._chunk_headers = np.zeros((chunks, TABLE_HEADER_WORDS), np.int64)
            self._chunk_headers[:, 2:] = len(self._table) // TABLE_WORDS_PER_WORD, get_array_address(self._table)
            ends = [count * k // chunks for k in range(chunks + 1)]
            self._chunks = np.array(
                [(get_array_address(self._chunk_headers[k]), *ends[k : k + 2]) for k in range(chunks)], np.int64
            )
        self._chunk_headers[:, :2] = 0
        parallel.call_for_each_row(_load_function(), self._chunks, threads)
        first, second = (sum(column) for column in self._chunk_headers[:, :2].T.tolist())
        return first, second


@cache
def _load_function() -> Callable[[int, int, int], None]:
    """Return the compiled function that adds up the hashes of a range of rows."""
    function: Callable[[int, int, int], None] = build_llvm_text.code().function("rows")
    return function
