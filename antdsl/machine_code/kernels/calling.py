"""Calls a kernel's code: arguments are checked and laid into a table of words, which it reads.

A table is kept for the next call, with the arrays it tells of (by weak references): most arrays of a step are those of the step
before, and cost a look then."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any
from weakref import ref

from antdsl.machine_code import machine
from antdsl.machine_code.kernels.types import ArrayType, Scalar
from antdsl.machine_code.kernels.values import Item, leaves
from antdsl.machine_code.memory import address

RESULTS = 8  # words before the arguments, for what is given back
_FORMATS = {"double": "d", "float": "d", "i64": "q", "u64": "Q", "i1": "q"}
_ARRAY, _WHOLE, _UNSIGNED, _REAL = range(4)
_CODES = {"double": _REAL, "float": _REAL, "i64": _WHOLE, "u64": _UNSIGNED, "i1": _WHOLE}


class _Table:
    """Words of a call, by how they are written, and the arrays that they tell of."""

    __slots__ = ("known", "place", "real", "room", "unsigned", "whole")

    def __init__(self, words: int, arguments: int) -> None:
        self.room = ctypes.create_string_buffer(8 * words)
        self.place = ctypes.addressof(self.room)
        view = memoryview(self.room).cast("B")
        self.whole, self.unsigned, self.real = view.cast("q"), view.cast("Q"), view.cast("d")
        self.known: list[Callable[[], Any]] = [lambda: None] * arguments


def caller(name: str, code: machine.Code, types: Sequence[Any], result: Item, stored: set[int]) -> Callable[..., Any]:
    """A function of a kernel's arguments. `types`: what its annotations name; `stored`: the arrays it writes to, by number."""
    flat = list(_leaves(types))
    codes = [_ARRAY if isinstance(each, ArrayType) else _CODES[each.kind] for each in flat]
    places, words = [], RESULTS
    for each in flat:
        places.append(words)
        words += 1 + each.axes * (2 if each.strided else 1) if isinstance(each, ArrayType) else 1
    arrays = iter(range(len(flat)))
    written = [isinstance(each, ArrayType) and next(arrays) in stored for each in flat]
    nested = any(isinstance(each, tuple) for each in types)
    given = struct.Struct("=" + "".join(_FORMATS[each.kind] for each in leaves(result)))
    truths = [each.kind == "i1" for each in leaves(result)]
    several = isinstance(result, tuple)
    function, count = code.function(name), len(flat)
    free: list[_Table] = []  # tables that no call is using

    def run(*arguments: Any) -> Any:
        values = list(_flat(types, arguments)) if nested else arguments
        if len(values) != count:
            raise TypeError(f"{name} takes {count} arguments, not {len(values)}")
        try:
            table = free.pop()
        except IndexError:
            table = _Table(words, count)
        known, whole = table.known, table.whole
        for k, value in enumerate(values):
            code = codes[k]
            if code == _ARRAY:
                if known[k]() is not value:
                    known[k] = ref(value)
                    for at, word in enumerate(_described(name, flat[k], value, written[k]), places[k]):
                        whole[at] = word
            elif code == _REAL:
                table.real[places[k]] = value
            elif code == _WHOLE:
                whole[places[k]] = int(value)
            else:
                table.unsigned[places[k]] = int(value)
        function(table.place, 0, 0)
        if not truths:
            free.append(table)
            return None
        found: tuple[Any, ...] = given.unpack_from(table.room)
        free.append(table)
        found = tuple(bool(value) if truth else value for value, truth in zip(found, truths, strict=True))
        return found if several else found[0]

    return run


def _leaves(type: Any) -> Iterator[Scalar | ArrayType]:
    if isinstance(type, Scalar | ArrayType):
        yield type
    else:
        for each in type:
            yield from _leaves(each)


def _flat(types: Sequence[Any], arguments: Sequence[Any]) -> Iterator[Any]:
    for type, argument in zip(types, arguments, strict=True):
        if isinstance(type, tuple):
            yield from _flat(type, argument)
        else:
            yield argument


def _described(name: str, type: Any, array: Any, written: bool) -> tuple[int, ...]:
    """The words that tell of an array. Raises ValueError where it is of another type, or does not lie as it should."""
    dtype = type.of.dtype
    if dtype != array.dtype or array.ndim != type.axes:
        raise ValueError(f"{name} wants an array of {dtype} with {type.axes} axes, not of {array.dtype} with {array.ndim}")
    if written and not array.flags.writeable:
        raise ValueError(f"{name} writes to an array that is read-only")
    if not type.strided:
        return (address(array), *array.shape)
    size = dtype.itemsize
    if array.size and any(step % size for step in array.strides):
        raise ValueError(f"{name} wants whole elements from one index to the next")
    return (array.__array_interface__["data"][0], *array.shape, *(step // size for step in array.strides))
