"""Kernels as built-in functions of CPython, with arguments that are read by machine code. Such a call costs less time than
inspecting one array in Python.

All kernels share one C function (METH_FASTCALL). Each kernel binds this function to a bytes object that describes the kernel's
arguments. If an argument does not have the expected type, the function calls `fallback` with all arguments and returns the
result. The function relies on the memory layout of objects in CPython and NumPy (`PyArrayObject_fields` is part of NumPy's
binary interface). `is_supported` verifies that layout first."""

from __future__ import annotations

import ctypes
import struct
import sys
import sysconfig
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.kernels.direct import argument_text as reading

_CONTIGUOUS_FLAG, _ALIGNED_FLAG, _WRITEABLE_FLAG = 0x1, 0x100, 0x400  # flags of arrays
_FASTCALL_FLAG = 0x80


class _MethodDefinition(ctypes.Structure):
    """CPython's structure `PyMethodDef`."""

    _fields_ = (("name", ctypes.c_char_p), ("code", ctypes.c_void_p), ("flags", ctypes.c_int), ("text", ctypes.c_char_p))


class _ProbeRecord(NamedTuple):
    """A sample record; `is_supported` inspects its memory layout."""

    first: Any
    second: Any


@dataclass(frozen=True, slots=True)
class ArgumentSpec:
    """How one argument of a kernel, or one element of a tuple argument, is stored in the table of 64-bit words.

    - `path`: the index of the argument, then the indices within nested tuples
    - `word_index`: the index of its first word in the table; a number takes one word
    - `kind`: the kind of a number, such as `INTEGER_KIND`; `dtype`: the type of an array
    - `axes`, `is_strided`: an array of `axes` axes takes words for its address, its lengths and, if `is_strided`, its strides
    - `is_written`: whether the kernel writes to the array
    - `count`: the number of elements of a tuple or record, which takes no word; None for numbers and arrays"""

    path: tuple[int, ...]
    word_index: int = 0
    kind: int = reading.REAL_KIND
    dtype: np.dtype[Any] | None = None
    axes: int = 0
    is_strided: bool = False
    is_written: bool = False
    count: int | None = None


def make_builtin(
    name: str,
    code: llvm_compiler.LoadedCode,
    specs: Sequence[ArgumentSpec],
    table_words: int,
    result_kinds: Sequence[int],
    fallback: Callable[..., Any],
    parallel_run: int = 0,
) -> Any:
    """Return a built-in Python function that calls kernel code; None if no such function can be made.

    - `specs`: the arguments; a tuple comes before its elements
    - `table_words`: the length of the table that the code reads; the code overwrites the first words with its results
    - `result_kinds`: the kinds of these results
    - `fallback`: the function to call instead if an argument has an unexpected type
    - `parallel_run`: the address of a function that runs the code in parallel parts, or 0

    With `parallel_run`, `specs` has two more numbers, in the words after the table, and the built-in function returns a list."""
    if (
        table_words + 2 > reading.MAX_TABLE_WORDS
        or len(result_kinds) > reading.RESULT_WORDS
        or any(len(each.path) >= reading.MAX_TUPLE_DEPTH for each in specs)
        or not is_supported()
    ):
        return None
    count = sum(len(each.path) == 1 for each in specs)
    head = [
        code.get_function_address(name),
        count,
        id(fallback),
        len(specs),
        len(result_kinds),
        ctypes.addressof(_get_api_addresses()),
        parallel_run,
        table_words,
        *result_kinds,
    ]
    descriptor = struct.pack(f"={len(head)}q", *head).ljust(8 * reading.HEADER_WORDS, b"\0") + b"".join(
        map(_pack_argument, specs)
    )
    method = _MethodDefinition(name.encode(), _load_code().get_function_address("direct"), _FASTCALL_FLAG, None)
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.argtypes, make.restype = (ctypes.c_void_p, ctypes.py_object, ctypes.py_object), ctypes.py_object
    return make(
        ctypes.addressof(method), descriptor, (method, code, fallback, _load_code(), tuple(specs))
    )  # keeps these objects alive with the built-in function


def _pack_argument(argument: ArgumentSpec) -> bytes:
    """Return packed words that tell the machine code how to read an argument."""
    depth, index = len(argument.path) - 1, argument.path[-1]
    if argument.count is not None:
        return struct.pack(f"={reading.WORDS_PER_ARGUMENT}q", reading.TUPLE_ARGUMENT, depth, index, 0, argument.count, 0, 0, 0)
    if argument.dtype is None:
        return struct.pack(
            f"={reading.WORDS_PER_ARGUMENT}q", reading.NUMBER_ARGUMENT, depth, index, argument.word_index, argument.kind, 0, 0, 0
        )
    flags = _ALIGNED_FLAG | (0 if argument.is_strided else _CONTIGUOUS_FLAG) | (_WRITEABLE_FLAG if argument.is_written else 0)
    size = argument.dtype.itemsize if argument.is_strided else 0
    return struct.pack(
        f"={reading.WORDS_PER_ARGUMENT}q",
        reading.ARRAY_ARGUMENT,
        depth,
        index,
        argument.word_index,
        id(argument.dtype),
        argument.axes,
        flags,
        size,
    )


@cache
def _load_code() -> llvm_compiler.LoadedCode:
    return reading.build_llvm_text.code()


@cache
def is_supported() -> bool:
    """Return whether Python objects have the memory layout that the machine code expects: that of 64-bit CPython with a global
    interpreter lock."""
    if sys.implementation.name != "cpython" or ctypes.sizeof(ctypes.c_void_p) != 8 or hasattr(sys, "getobjects"):
        return False
    if sysconfig.get_config_var("Py_GIL_DISABLED") or bytes.__basicsize__ != reading.measure_bytes_data_offset() + 1:
        return False
    if not all(hasattr(ctypes.pythonapi, name) for name in (*reading.PYTHON_API_CALLS, "PyCFunction_NewEx")):
        return False
    head = object.__basicsize__
    for array in (np.arange(6.0).reshape(2, 3), np.zeros((4, 3), np.float32).T, np.zeros(3, np.bool_)[::2]):
        array.flags.writeable = array.ndim > 1
        data, axes, lengths, steps, _, dtype = (ctypes.c_int64 * 6).from_address(id(array) + head)
        flags = ctypes.c_int.from_address(id(array) + head + 48).value
        expected_flags = (
            _CONTIGUOUS_FLAG * array.flags.c_contiguous
            + _ALIGNED_FLAG * array.flags.aligned
            + _WRITEABLE_FLAG * array.flags.writeable
        )
        if (data, axes & 0xFFFFFFFF, dtype) != (array.__array_interface__["data"][0], array.ndim, id(array.dtype)):
            return False
        if flags & (_CONTIGUOUS_FLAG | _ALIGNED_FLAG | _WRITEABLE_FLAG) != expected_flags:
            return False
        for place, values in ((lengths, array.shape), (steps, array.strides)):
            if tuple((ctypes.c_int64 * array.ndim).from_address(place)) != values:
                return False
    numbers = (1.5, np.float64(2.5), np.float32(3.5), np.int64(-7), np.uint64(2**63), np.True_)
    for form, value in zip("ddfqQ?", numbers, strict=True):
        if struct.unpack(form, ctypes.string_at(id(value) + head, struct.calcsize(form)))[0] != value:
            return False
    for type_ in (tuple, ArgumentSpec, int, _ProbeRecord):
        if ctypes.c_uint64.from_address(id(type_) + reading.TYPE_FLAGS_OFFSET).value != type_.__flags__:
            return False
        if bool(type_.__flags__ & reading.TUPLE_FLAG) != issubclass(type_, tuple):
            return False
    pair = _ProbeRecord(array, head)
    inside = (ctypes.c_int64 * 2).from_address(id(pair) + tuple.__basicsize__)
    types = [ctypes.c_int64.from_address(id(each) + head - 8).value for each in (*pair, pair)]
    return tuple(inside) == tuple(map(id, pair)) and types == [id(type(each)) for each in (*pair, pair)]


@cache
def _get_api_addresses() -> ctypes.Array[ctypes.c_int64]:
    """Return the addresses of all Python functions and objects that the machine code uses: first `PYTHON_API_CALLS`, then
    `PYTHON_OBJECTS`."""
    calls = [ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value or 0 for name in reading.PYTHON_API_CALLS]
    addresses = [*calls, *map(id, reading.PYTHON_OBJECTS.values())]
    return (ctypes.c_int64 * len(addresses))(*addresses)
