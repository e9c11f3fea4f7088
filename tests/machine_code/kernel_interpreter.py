"""Interpreter for the instructions of kernels and of plans: the reference for machine code.

It runs one iteration of a kernel after another, also where machine code runs several in lanes. Numbers are NumPy scalars with
the meanings of `OPERATION_BY_NAME`, vectors are tuples of them, and memory is that of the arrays. Undefined behaviour of
machine code is an error here: an index outside its axis, division by 0, and reading a variable or an element of `scratch`
before anything was stored to it. `interpreter_steps` translates each instruction to the function that runs here."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from interpreter_steps import ArrayMemory, FunctionPreparer, Pointer, PreparedFunction, ProcessMemory, run_code
from numpy.lib.array_utils import byte_bounds

from antdsl.machine_code.kernels.ir import IrFunction
from antdsl.machine_code.kernels.kernel import Kernel
from antdsl.machine_code.kernels.kernel_calls import flatten_arguments
from antdsl.machine_code.kernels.operations import DTYPE_BY_TYPE, wrap_to_dtype
from antdsl.machine_code.kernels.types import UNSIGNED, ArrayType, ScalarType
from antdsl.machine_code.kernels.values import KernelItem, flatten_item


def interpret(kernel: Kernel, *arguments: Any) -> Any:
    """Run a kernel on arguments and return its result; arrays among them may be written to. Raises KernelFault with file and
    line."""
    return KernelInterpreter(kernel)(*arguments)


class KernelInterpreter:
    """A kernel with the calling convention of its machine code."""

    def __init__(self, kernel: Kernel) -> None:
        self._types = kernel.types()
        self._name, self._result, functions = kernel.build_instructions()
        self._label = kernel.__name__
        self._codes: dict[str, PreparedFunction] = {}
        for each in functions:  # those that are called come first
            self._codes[each.name] = FunctionPreparer(each, self._codes).code()

    def __call__(self, *arguments: Any) -> Any:
        passed: list[Any] = []
        kinds = list(_kinds(self._types))
        for type, value in zip(kinds, flatten_arguments(self._label, self._types, arguments), strict=True):
            passed += _array(value, type) if isinstance(type, ArrayType) else [_number(value, type)]
        with np.errstate(all="ignore"):
            output = run_code(self._codes[self._name], passed)
        numbers = list(flatten_item(self._result))
        values = [
            _argument_value(each, value) for each, value in zip(numbers, output if len(numbers) > 1 else (output,), strict=False)
        ]
        if not numbers:
            return None
        return tuple(values) if isinstance(self._result, tuple) else values[0]


def interpreted_function(functions: Sequence[IrFunction], name: str) -> Callable[[int, int, int], None]:
    """Return a plan's function of (table of addresses, first row, row after the last), with the interface of machine code.
    `functions` are all that it calls, callees first."""
    codes: dict[str, PreparedFunction] = {}
    for each in functions:
        codes[each.name] = FunctionPreparer(each, codes).code()

    def run(table: int, begin: int, end: int) -> None:
        with np.errstate(all="ignore"):
            run_code(codes[name], [Pointer(ProcessMemory(), table), np.int64(begin), np.int64(end)])

    return run


def _kinds(types: Sequence[Any]) -> Any:
    for each in types:
        if isinstance(each, tuple):
            yield from _kinds(each)
        else:
            yield each


def _number(value: Any, type: ScalarType) -> Any:
    if type.kind in ("double", "float"):
        return DTYPE_BY_TYPE[type.kind](np.float64(value))
    return np.bool_(value) if type.kind == "i1" else wrap_to_dtype(int(value))


def _array(array: Any, type: ArrayType) -> list[Any]:
    """Return the address of an array, its lengths, and its steps if the type is strided."""
    low, high = byte_bounds(array)
    start = array.__array_interface__["data"][0]
    buffer = (ctypes.c_uint8 * (high - low if array.size else 0)).from_address(low)
    memory = ArrayMemory(np.ctypeslib.as_array(buffer))
    steps = [np.int64(each // array.itemsize) for each in array.strides] if type.is_strided else []
    return [Pointer(memory, start - low if array.size else 0), *map(np.int64, array.shape), *steps]


def _argument_value(number: KernelItem, value: Any) -> Any:
    if number.kind in ("double", "float"):
        return float(value)
    return bool(value) if number.kind == "i1" else int(value) & ((1 << 64) - 1) if number.kind == UNSIGNED else int(value)
