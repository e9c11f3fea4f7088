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

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code import machine
from antdsl.machine_code.entries import entry
from antdsl.machine_code.library import library_text
from antdsl.machine_code.memory import address
from antdsl.machine_code.module import Module

_HALF = 0xFFFFFFFF
_WHOLE = 0xFFFFFFFFFFFFFFFF
Longs = NDArray[np.int64]


def row_hash(ids: NDArray[np.int64] | None, columns: Sequence[NDArray[Any]]) -> bytes:
    """16 bytes for a table with these columns, [n] each, of 1, 2, 4 or 8 bytes a value. `ids` int64[n] are different from each
    other; None: the numbers of the rows, for a table whose rows have an order."""
    count = len(columns[0]) if ids is None else len(ids)
    kept = [np.ascontiguousarray(column) for column in (columns if ids is None else (ids, *columns))]
    return _told(Table(kept, keys, ids=ids is not None).sums(count))


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
        if not count:  # arrays without rows have any strides
            return _told((0, 0))
        table = self._table
        if table is None or len(arrays) != len(self._arrays) or not table.lie(arrays, self._arrays):
            self._table = table = Table(arrays, keys, ids=ids is not None)
        self._arrays = arrays
        return _told(table.sums(count))


def named(names: tuple[str, ...], columns: Iterable[NDArray[Any]]) -> bytes:
    """What a digest has to take in of columns besides the hash of the rows: their names and types."""
    return _named(names, tuple([column.dtype for column in columns]))


@lru_cache(64)
def _named(names: tuple[str, ...], types: tuple[np.dtype[Any], ...]) -> bytes:
    return "".join(f"\0{name} {dtype.str}" for name, dtype in zip(names, types, strict=True)).encode()


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


_Part = tuple[int, int, int]  # which column, how many bytes from its begin on, and from one value to the next

WHOLE, STRIDED, NUMBERS, HALVES = range(4)  # kinds of words
_TIMES = (0xFF51AFD7ED558CCD - 2**64, 0xC4CEB9FE1A85EC53 - 2**64)
_HEAD, _WORDS = 3, 9  # words of a table before those of the row's words, and of each of these
_LANES, _UNROLLED, _AHEAD = 8, 4, 2  # rows in a register, registers of a lane, and how many times as many rows to fetch ahead


@dataclass(frozen=True, slots=True, eq=False)
class _Form:
    """What is the same of all arrays that may stand for a column: their type, their steps, their axes after the first, and
    whether they lie in one piece."""

    dtype: np.dtype[Any]
    strides: tuple[int, ...]
    more: tuple[int, ...]
    piece: bool


class Table:
    """Where the columns of a table lie, for machine code. `columns` [n] or [n, k], of 1, 2, 4 or 8 bytes a value, not kept here.
    `keys` gives the four of a word by its number. `ids`: whether the first column is those of the rows; otherwise the numbers of
    the rows are."""

    def __init__(self, columns: Sequence[NDArray[Any]], keys: Callable[[int], NDArray[np.int64]], *, ids: bool) -> None:
        self._forms = [_Form(each.dtype, each.strides, each.shape[1:], each.flags.c_contiguous) for each in columns]
        words: list[tuple[int, list[_Part]]] = [] if ids else [(NUMBERS, [])]
        half: list[_Part] = []
        for k, column in enumerate(columns):
            size = column.itemsize
            step = size if column.ndim == 1 and column.flags.c_contiguous else column.strides[0]
            if size < 4 and step != size:
                raise ValueError("a column of fewer than four bytes a value lies in one piece")
            for offset in (0,) if column.ndim == 1 else [column.strides[1] * part for part in range(column.shape[1])]:
                if size == 8:
                    words.append((WHOLE if step == size else STRIDED, [(k, offset, step)]))
                elif half:
                    words.append((HALVES, [*half, (k, offset, step)]))
                    half = []
                else:
                    half = [(k, offset, step)]
        if half:
            words.append((HALVES, half * 2))
        table = [0, 0, len(words)]
        self._slots: list[list[tuple[int, int]]] = [[] for _ in columns]  # of each column: words with its address, and how far on
        for number, (kind, parts) in enumerate(words):
            for place, (k, offset, _) in zip((1, 3), parts, strict=False):
                self._slots[k].append((len(table) + place, offset))
            steps = [word for _, _, step in parts for word in (0, step)]
            table += [kind, *steps, *[0] * (4 - len(steps)), *keys(number).tolist()]
        self._table = np.array(table, np.int64)
        self.lie(columns, [None] * len(columns))

    def lie(self, columns: Sequence[NDArray[Any]], before: Sequence[NDArray[Any] | None]) -> bool:
        """Whether other arrays can stand for the columns; they do from now on. `before`: those that stood for them until now."""
        for k, (column, other) in enumerate(zip(columns, before, strict=True)):
            if column is other:
                continue
            form, piece = self._forms[k], column.flags.c_contiguous  # which one row always is
            if column.dtype is not form.dtype or column.strides != form.strides or column.shape[1:] != form.more:
                return False
            if piece != form.piece:
                return False
            begin = address(column) if form.piece else column.ctypes.data
            for slot, offset in self._slots[k]:
                self._table[slot] = begin + offset
        return True

    def sums(self, count: int) -> tuple[int, int]:
        """The sums of both lanes of so many rows, each mixed, modulo 2^64."""
        self._table[:2] = 0
        _function()(address(self._table), 0, count)
        first, second = self._table[:2].tolist()
        return first, second


@cache
def _function() -> Callable[[int, int, int], None]:
    function: Callable[[int, int, int], None] = text.code().function("rows")
    return function


@library_text
def text(target: machine.Target) -> str:
    """What is compiled: a function of such a table, behind two sums and the number of words, that adds to the sums those of the
    rows from the first to before the last."""
    module = Module(target)
    for lanes in (_LANES, 1):
        module.declare(f"llvm.vector.reduce.add.v{lanes}i64", "i64", [f"<{lanes} x i64>"])
    module.declare("llvm.prefetch.p0", "void", ["ptr", "i32", "i32", "i32"])
    body = "  %words.at = getelementptr i64, ptr %t, i64 2\n  %words = load i64, ptr %words.at\n"
    body += f"  %first = getelementptr i64, ptr %t, i64 {_HEAD}\n"
    body += "\n".join([*_loop("many", _LANES, _UNROLLED, "%begin", "entry"), *_loop("one", 1, 1, "%many.i", "many.end")])
    return f"{module.text()}\n{entry(module, 'rows', body)}\n"


def _loop(name: str, lanes: int, unrolled: int, begin: str, before: str) -> list[str]:
    """A loop over rows, so many registers of so many lanes at a time."""
    kind, half, rows, each = f"<{lanes} x i64>", f"<{lanes} x i32>", lanes * unrolled, range(unrolled)
    numbers = iter(range(10_000))
    lines: list[str] = []

    def do(line: str) -> None:
        lines.append("  " + Template(line).substitute(n=name))

    def at(label: str) -> None:
        lines.append(f"{name}.{label}:")

    def put(value: str) -> str:
        found = f"%{name}.v{next(numbers)}"
        do(f"{found} = {value}")
        return found

    def constant(value: int) -> str:
        return "<" + ", ".join([f"i64 {value}"] * lanes) + ">"

    def all_of(value: str) -> str:
        """A number of 64 bits in all lanes."""
        one = put(f"insertelement {kind} poison, i64 {value}, i64 0")
        return put(f"shufflevector {kind} {one}, {kind} poison, <{lanes} x i32> zeroinitializer")

    def fetched(place: str, size: int) -> None:
        for byte in range(0, rows * size, 64) if lanes > 1 else ():
            ahead = put(f"getelementptr i8, ptr {place}, i64 {_AHEAD * rows * size + byte}")
            do(f"call void @llvm.prefetch.p0(ptr {ahead}, i32 0, i32 3, i32 1)")

    def read(place: str, of: str, size: int) -> list[str]:
        """The values of columns of this type, one a row, which lie side by side."""
        start = put(f"getelementptr i{8 * size}, ptr {place}, i64 %$n.i")
        fetched(start, size)
        places = [put(f"getelementptr i8, ptr {start}, i64 {lanes * size * k}") for k in each]
        return [put(f"load <{lanes} x {of}>, ptr {place}, align 1") for place in places]

    def apart(place: str, of: str, step: str) -> list[str]:
        """The same of columns whose values are so many bytes apart."""
        start = put(f"getelementptr i8, ptr {place}, i64 {put(f'mul i64 %$n.i, {step}')}")
        found = []
        for k in each:
            values = "poison"
            for lane in range(lanes):
                one = put(f"getelementptr i8, ptr {start}, i64 {put(f'mul i64 {step}, {lanes * k + lane}')}")
                value = put(f"load {of}, ptr {one}, align 1")
                values = put(f"insertelement <{lanes} x {of}> {values}, {of} {value}, i64 {lane}")
            found.append(values)
        return found

    def met(kind: str, of: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
        """What stands in values where several blocks meet."""
        return [put(f"phi {kind} " + ", ".join(f"[ {some[k]}, %$n.{label} ]" for label, some in of)) for k in each]

    do("br label %$n.rows")
    at("rows")
    do(f"%$n.i = phi i64 [ {begin}, %{before} ], [ %$n.next, %$n.mixed ]")
    for lane in (0, 1):
        do(f"%$n.sum{lane} = phi {kind} [ zeroinitializer, %{before} ], [ %$n.then{lane}, %$n.mixed ]")
    do(f"%$n.next = add i64 %$n.i, {rows}")
    do("%$n.more = icmp sle i64 %$n.next, %end")
    do("br i1 %$n.more, label %$n.begun, label %$n.end")
    at("begun")
    do("br label %$n.words")
    at("words")
    do("%$n.w = phi i64 [ 0, %$n.begun ], [ %$n.w.next, %$n.times ]")
    for lane in (0, 1):
        for k in each:
            do(f"%$n.lane{lane}.{k} = phi {kind} [ zeroinitializer, %$n.begun ], [ %$n.new{lane}.{k}, %$n.times ]")
    do("%$n.some = icmp slt i64 %$n.w, %words")
    do("br i1 %$n.some, label %$n.word, label %$n.mixed")
    at("word")
    word = put(f"getelementptr i64, ptr %first, i64 {put(f'mul i64 %$n.w, {_WORDS}')}")
    places = [put(f"getelementptr i64, ptr {word}, i64 {k}") for k in range(_WORDS)]
    what, *steps = (put(f"load i64, ptr {places[k]}") for k in (0, 2, 4))
    columns = [put(f"load ptr, ptr {places[k]}") for k in (1, 3)]
    keys = [all_of(put(f"load i64, ptr {place}")) for place in places[5:]]
    do(
        f"switch i64 {what}, label %$n.halves [ i64 {WHOLE}, label %$n.whole  i64 {STRIDED}, label %$n.strided"
        f"  i64 {NUMBERS}, label %$n.numbers ]"
    )
    low: list[tuple[str, list[str]]] = []  # of each block that ends in `times`, what it leaves
    high: list[tuple[str, list[str]]] = []

    def halved(label: str, found: list[str]) -> None:
        low.append((label, found))
        high.append((label, [put(f"lshr {kind} {value}, {constant(32)}") for value in found]))
        do("br label %$n.times")

    at("whole")
    halved("whole", read(columns[0], "i64", 8))
    at("strided")
    halved("strided", apart(columns[0], "i64", steps[0]))
    at("numbers")
    own = all_of("%$n.i")
    halved(
        "numbers",
        [put(f"add {kind} {own}, <" + ", ".join(f"i64 {lanes * k + lane}" for lane in range(lanes)) + ">") for k in each],
    )
    at("halves")
    pair: list[list[str]] = []
    for step, then in zip(steps, ("second", "joined"), strict=True):
        ways = []
        do(
            f"switch i64 {step}, label %$n.{then}.0 [ "
            + "  ".join(f"i64 {size}, label %$n.{then}.{size}" for size in (1, 2, 4))
            + " ]"
        )
        for size in (0, 1, 2, 4):
            at(f"{then}.{size}")
            column = columns[len(pair)]
            found = read(column, f"i{8 * size}", size) if size else apart(column, "i32", step)
            if 0 < size < 4:
                found = [put(f"sext <{lanes} x i{8 * size}> {value} to {half}") for value in found]
            ways.append((f"{then}.{size}", found))
            do(f"br label %$n.{then}")
        at(then)
        pair.append(met(half, ways))
    for words, found in zip((low, high), pair, strict=True):
        words.append(("joined", [put(f"zext {half} {value} to {kind}") for value in found]))
    do("br label %$n.times")
    at("times")
    halves = met(kind, low), met(kind, high)
    for lane in (0, 1):
        for k in each:
            sums = [put(f"add {kind} {halves[part][k]}, {keys[2 * lane + part]}") for part in (0, 1)]
            cut = [put(f"and {kind} {value}, {constant(_HALF)}") for value in sums]
            do(f"%$n.new{lane}.{k} = add {kind} %$n.lane{lane}.{k}, {put(f'mul {kind} {cut[0]}, {cut[1]}')}")
    do("%$n.w.next = add i64 %$n.w, 1")
    do("br label %$n.words")
    at("mixed")
    for lane in (0, 1):
        total = f"%$n.sum{lane}"
        for k in each:
            h = f"%$n.lane{lane}.{k}"
            for factor in (*_TIMES, None):
                h = put(f"xor {kind} {h}, {put(f'lshr {kind} {h}, {constant(33)}')}")
                h = h if factor is None else put(f"mul {kind} {h}, {constant(factor)}")
            total = put(f"add {kind} {total}, {h}")
        do(f"%$n.then{lane} = add {kind} {total}, zeroinitializer")
    do("br label %$n.rows")
    at("end")
    for lane in (0, 1):
        place = put(f"getelementptr i64, ptr %t, i64 {lane}")
        found_here = put(f"call i64 @llvm.vector.reduce.add.v{lanes}i64({kind} %$n.sum{lane})")
        kept = put(f"load i64, ptr {place}")
        do(f"store i64 {put(f'add i64 {found_here}, {kept}')}, ptr {place}")
    return lines
