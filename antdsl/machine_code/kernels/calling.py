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
_WHOLE, _UNSIGNED, _REAL = range(3)
_CODES = {"double": _REAL, "float": _REAL, "i64": _WHOLE, "u64": _UNSIGNED, "i1": _WHOLE}


class _Table:
    """Words of a call, by how they are written, and the arrays that they tell of."""

    __slots__ = ("known", "place", "real", "room", "unsigned", "whole")

    def __init__(self, words: int, arguments: int) -> None:
        self.room = ctypes.create_string_buffer(8 * words)
        self.place = ctypes.addressof(self.room)
        view = memoryview(self.room).cast("B")
        self.whole, self.unsigned, self.real = view.cast("q"), view.cast("Q"), view.cast("d")
        self.known: list[Callable[[], Any]] = [_nothing] * arguments


def caller(name: str, code: machine.Code, types: Sequence[Any], result: Item, stored: set[int]) -> Callable[..., Any]:
    """A function of a kernel's arguments. `types`: what its annotations name; `stored`: the arrays it writes to, by number."""
    flat = list(_leaves(types))
    count, words, places = len(flat), RESULTS, []
    for each in flat:
        places.append(words)
        words += 1 + each.axes * (2 if each.strided else 1) if isinstance(each, ArrayType) else 1
    arrays = [(k, place) for k, (place, each) in enumerate(zip(places, flat, strict=True)) if isinstance(each, ArrayType)]
    written = [each in stored for each in range(len(arrays))]
    described = [
        (flat[k], place, write, None if write else _listed(flat[k])) for (k, place), write in zip(arrays, written, strict=True)
    ]
    reals, wholes, unsigned = (
        [(k, places[k]) for k, each in enumerate(flat) if isinstance(each, Scalar) and _CODES[each.kind] == code_of]
        for code_of in (_REAL, _WHOLE, _UNSIGNED)
    )
    numbers = tuple(k for k, _ in arrays)
    nested = [len(each) if isinstance(each, tuple) else 0 for each in types] if len(types) != count else None
    deep = any(isinstance(one, tuple) for each in types if isinstance(each, tuple) for one in each)
    given = struct.Struct("=" + "".join(_FORMATS[each.kind] for each in leaves(result)))
    truths = [k for k, each in enumerate(leaves(result)) if each.kind == "i1"]
    several, gives = isinstance(result, tuple), given.size > 0
    function = code.function(name)
    free: list[_Table] = []  # tables that no call is using

    def run(*arguments: Any) -> Any:
        values: Sequence[Any] = arguments
        if nested is not None:
            values = []
            if len(arguments) != len(nested):
                raise TypeError(f"{name} takes {len(nested)} arguments, not {len(arguments)}")
            if deep:
                values.extend(_flat(types, arguments))
            else:
                for length, value in zip(nested, arguments):  # noqa: B905  # as long as each other, and a call is short
                    if not length:
                        values.append(value)
                    elif len(value) == length:
                        values.extend(value)
                    else:
                        raise ValueError(f"{name} takes {length} values there, not {len(value)}")
        if len(values) != count:
            raise TypeError(f"{name} takes {count} arguments, not {len(values)}")
        try:
            table = free.pop()
        except IndexError:
            table = _Table(words, len(arrays))
        known, whole = table.known, table.whole
        for at, k in enumerate(numbers):
            value = values[k]
            if known[at]() is not value:
                type, place, write, dtype = described[at]
                if dtype is value.dtype and len(value.shape) == 1:  # as nearly all are
                    whole[place], whole[place + 1] = address(value), len(value)
                    known[at] = ref(value)
                    continue
                for place, word in enumerate(_described(name, type, value, write), place):  # noqa: B020
                    whole[place] = word
                known[at] = ref(value)
        if reals:
            real = table.real
            for k, place in reals:
                real[place] = values[k]
        for k, place in wholes:
            whole[place] = int(values[k])
        for k, place in unsigned:
            table.unsigned[place] = int(values[k])
        function(table.place, 0, 0)
        if not gives:
            free.append(table)
            return None
        found: tuple[Any, ...] = given.unpack_from(table.room)
        free.append(table)
        if truths:
            found = tuple(bool(value) if k in truths else value for k, value in enumerate(found))
        return found if several else found[0]

    return run


def _nothing() -> None:
    """What a weak reference gives whose array is gone."""


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


def _listed(type: Any) -> Any:
    """The dtype of an array with one axis, None of others."""
    return type.of.dtype if type.axes == 1 and not type.strided else None


def _described(name: str, type: Any, array: Any, written: bool) -> tuple[int, ...]:
    """The words that tell of an array. Raises ValueError where it is of another type, or does not lie as it should."""
    dtype = type.of.dtype
    shape = array.shape
    if (dtype is not array.dtype and dtype != array.dtype) or len(shape) != type.axes:
        raise ValueError(f"{name} wants an array of {dtype} with {type.axes} axes, not of {array.dtype} with {array.ndim}")
    if written and not array.flags.writeable:
        raise ValueError(f"{name} writes to an array that is read-only")
    if not type.strided:
        return (address(array), *shape)
    size, (one, two) = dtype.itemsize, array.strides
    if (one % size or two % size) and array.size:
        raise ValueError(f"{name} wants whole elements from one index to the next")
    if array.flags.c_contiguous:
        place = address(array)
    else:
        turned = array.T
        place = address(turned) if turned.flags.c_contiguous else array.__array_interface__["data"][0]
    return (place, *shape, one // size, two // size)
