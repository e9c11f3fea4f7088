"""Copies the rows of many arrays in parallel, either in order or as selected by row numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from operator import is_not
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.entry_functions import write_inner_function
from antdsl.machine_code.library import make_library_text
from antdsl.machine_code.llvm_module import LlvmModule
from antdsl.machine_code.memory import get_array_address
from antdsl.numerics import parallel
from antdsl.numerics.processor.host import PARTS_PER_THREAD

ArrayPairs = Sequence[tuple[NDArray[Any], NDArray[Any]]]  # target and source of each copy
_KERNEL_ROW_BYTES = (1, 4, 8)  # row sizes in bytes with a separate loop for selected rows
_HEADER_WORDS, _WORDS_PER_ARRAY = 2, 3  # words in a table's header, and words per array


class RowCopier:
    """A copier that repeatedly copies the same arrays. It stores their addresses, so that it need not look them up each time."""

    def __init__(self) -> None:
        self._arrays: list[NDArray[Any]] = []
        self._threads = 0
        self._table = self._parts = np.zeros(0, np.int64)

    def copy(self, targets: Sequence[NDArray[Any]], sources: Sequence[NDArray[Any]], threads: int) -> None:
        """Copy the contiguous arrays `sources` [n, ..] to the arrays `targets`, which have the same lengths and types and share
        no memory with `sources`."""
        arrays = [*targets, *sources]
        if not arrays:
            return
        if len(arrays) != len(self._arrays) or threads != self._threads or any(map(is_not, arrays, self._arrays)):
            self._arrays, self._threads = arrays, threads
            self._table = _build_copy_table([pair for pair in zip(targets, sources, strict=True) if pair[0] is not pair[1]], None)
            self._parts = _build_part_rows(self._table, len(arrays[0]), threads)
        parallel.call_for_each_row(_load_function(), self._parts, threads)


def copy_rows(pairs: ArrayPairs, rows: NDArray[np.intp], threads: int) -> None:
    """Copy selected rows between arrays. `pairs`: (target [k, ..], source [n, ..]), contiguous and of one type. `rows` [k]:
    row numbers."""
    if not pairs:
        return
    rows = np.ascontiguousarray(rows)  # keeps the array alive while its address is in use
    table = _build_copy_table(pairs, rows)
    parallel.call_for_each_row(_load_function(), _build_part_rows(table, len(rows), threads), threads)


def _build_copy_table(pairs: ArrayPairs, rows: NDArray[np.intp] | None) -> NDArray[np.int64]:
    """Return the table that the compiled copy function reads, int64 words.

    It begins with the address of the row numbers (0: all rows in order) and the number of arrays. Each array adds three words:
    its address, the address of its target, and its bytes per row."""
    words = [0 if rows is None else get_array_address(rows), len(pairs)]
    for target, source in pairs:
        words += [get_array_address(source), get_array_address(target), source.strides[0]]
    return np.array(words, np.int64)


def _build_part_rows(table: NDArray[np.int64], count: int, threads: int) -> NDArray[np.int64]:
    """Return the parts in which to copy `count` rows, as rows for `parallel.call_for_each_row`: int64 [parts, 3]."""
    part_count = max(1, min(PARTS_PER_THREAD * threads, count // parallel.MIN_AGENTS_PER_THREAD))
    ends = [count * k // part_count for k in range(part_count + 1)]
    return np.array([(get_array_address(table), *ends[k : k + 2]) for k in range(part_count)], np.int64)


@cache
def _load_function() -> Callable[[int, int, int], None]:
    """Return the compiled function that copies rows."""
    function: Callable[[int, int, int], None] = build_llvm_text.code().function("rows")
    return function


@make_library_text
def build_llvm_text(target: llvm_compiler.Target) -> str:
    """Return the LLVM IR of a function that copies a range of rows. Its arguments are the table, the first row, and the row
    after the last."""
    module = LlvmModule(target)
    cases = "".join(f"  i64 {size}, label %pick{size}\n" for size in _KERNEL_ROW_BYTES)
    picking = "".join(
        _GATHER_TEMPLATE.replace("$SIZE$", str(size)).replace("$BITS$", str(8 * size)) for size in _KERNEL_ROW_BYTES
    )
    body = _BODY_TEMPLATE.replace("$CASES$", cases).replace("$PICKING$", picking)
    body = body.replace("$HEAD$", str(_HEADER_WORDS)).replace("$WORDS$", str(_WORDS_PER_ARRAY))
    return (
        f"{module.text()}\ndeclare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)\n{write_inner_function(module, 'rows', body)}\n"
    )


_BODY_TEMPLATE = """  %rows = load ptr, ptr %t
  %count.at = getelementptr i64, ptr %t, i64 1
  %count = load i64, ptr %count.at
  %first = getelementptr i64, ptr %t, i64 $HEAD$
  %as.they.are = icmp eq ptr %rows, null
  br label %array
array:
  %k = phi i64 [ 0, %entry ], [ %next, %done ]
  %more = icmp slt i64 %k, %count
  br i1 %more, label %one, label %over
one:
  %behind = mul i64 %k, $WORDS$
  %of.at = getelementptr i64, ptr %first, i64 %behind
  %to.at = getelementptr i64, ptr %of.at, i64 1
  %size.at = getelementptr i64, ptr %of.at, i64 2
  %of = load ptr, ptr %of.at
  %to = load ptr, ptr %to.at
  %size = load i64, ptr %size.at
  br i1 %as.they.are, label %whole, label %picked
whole:
  %low = mul i64 %begin, %size
  %high = mul i64 %end, %size
  %bytes = sub i64 %high, %low
  %of.low = getelementptr i8, ptr %of, i64 %low
  %to.low = getelementptr i8, ptr %to, i64 %low
  call void @llvm.memcpy.p0.p0.i64(ptr %to.low, ptr %of.low, i64 %bytes, i1 false)
  br label %done
picked:
  switch i64 %size, label %other [
$CASES$  ]
$PICKING$other:
  %i = phi i64 [ %begin, %picked ], [ %i.next, %other.one ]
  %i.more = icmp slt i64 %i, %end
  br i1 %i.more, label %other.one, label %done
other.one:
  %row.at = getelementptr i64, ptr %rows, i64 %i
  %row = load i64, ptr %row.at
  %of.byte = mul i64 %row, %size
  %to.byte = mul i64 %i, %size
  %of.i = getelementptr i8, ptr %of, i64 %of.byte
  %to.i = getelementptr i8, ptr %to, i64 %to.byte
  call void @llvm.memcpy.p0.p0.i64(ptr %to.i, ptr %of.i, i64 %size, i1 false)
  %i.next = add i64 %i, 1
  br label %other
done:
  %next = add i64 %k, 1
  br label %array
over:"""
_GATHER_TEMPLATE = """pick$SIZE$:
  %i$SIZE$ = phi i64 [ %begin, %picked ], [ %next$SIZE$, %one$SIZE$ ]
  %more$SIZE$ = icmp slt i64 %i$SIZE$, %end
  br i1 %more$SIZE$, label %one$SIZE$, label %done
one$SIZE$:
  %row.at$SIZE$ = getelementptr i64, ptr %rows, i64 %i$SIZE$
  %row$SIZE$ = load i64, ptr %row.at$SIZE$
  %of$SIZE$ = getelementptr i$BITS$, ptr %of, i64 %row$SIZE$
  %to$SIZE$ = getelementptr i$BITS$, ptr %to, i64 %i$SIZE$
  %value$SIZE$ = load i$BITS$, ptr %of$SIZE$, align 1
  store i$BITS$ %value$SIZE$, ptr %to$SIZE$, align 1
  %next$SIZE$ = add i64 %i$SIZE$, 1
  br label %pick$SIZE$
"""
