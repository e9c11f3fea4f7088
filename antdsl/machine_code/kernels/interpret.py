"""Interprets the instructions of kernels: the reference that machine code is compared with.

It runs one turn after another, also where machine code has several in lanes. Numbers are NumPy scalars, with the meanings of
`OPS`; memory is that of the arrays. What machine code leaves undefined is an error here: an index outside its axis, division by
0, and reading a variable or an element of `scratch` before anything was stored to it."""

from __future__ import annotations

import ctypes
import re
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.array_utils import byte_bounds

from antdsl.machine_code.kernels.calling import flat
from antdsl.machine_code.kernels.checks import KernelFault, described
from antdsl.machine_code.kernels.ir import Function, Instruction
from antdsl.machine_code.kernels.kernel import Kernel
from antdsl.machine_code.kernels.operations import DTYPES, OPS, wrapped
from antdsl.machine_code.kernels.types import UNSIGNED, ArrayType, Scalar
from antdsl.machine_code.kernels.values import Item, Number, leaves

_ROOM = re.compile(r"\[(\d+) x (\w+)\]")
_Step = Callable[[list[Any]], Any]


class _Memory:
    """Bytes as numbers of any type; `empty`: those that nothing was stored to, of `scratch`."""

    def __init__(self, data: Any, empty: bytearray | None = None) -> None:
        self._data, self._empty = data, empty
        self._views: dict[str, Any] = {}

    def _view(self, type: str) -> Any:
        if type not in self._views:
            self._views[type] = self._data.view(DTYPES[type])
        return self._views[type]

    def load(self, at: int, type: str) -> Any:
        """The number at a byte. IndexError for one outside, or that nothing was stored to."""
        view = self._view(type)
        index, rest = divmod(at, view.itemsize)
        if rest or not 0 <= index < len(view) or (self._empty is not None and self._empty[at]):
            raise IndexError
        return view[index]

    def store(self, at: int, type: str, value: Any) -> None:
        view = self._view(type)
        index, rest = divmod(at, view.itemsize)
        if rest or not 0 <= index < len(view):
            raise IndexError
        view[index] = value
        if self._empty is not None:
            self._empty[at] = 0


class _Pointer(NamedTuple):
    memory: _Memory
    at: int


class _Slot:
    """A variable's place on the stack."""

    value: Any = None


class _Code(NamedTuple):
    """A function that is ready to run: registers that are constants, makers of its places, and its blocks of steps, of which the
    last one gives the number of the next block, or what the function gives back."""

    registers: list[Any]
    slots: list[tuple[int, Callable[[], Any]]]
    blocks: list[list[_Step]]
    ends: list[Callable[[list[Any]], Any]]


def interpret(kernel: Kernel, *arguments: Any) -> Any:
    """What a kernel gives for arguments; it writes to those that are arrays. Raises KernelFault with file and line."""
    return Interpreter(kernel)(*arguments)


class Interpreter:
    """A kernel that is called as its machine code is."""

    def __init__(self, kernel: Kernel) -> None:
        self._types = kernel.types()
        self._name, self._result, functions = kernel.instructions()
        self._label = kernel.__name__
        self._codes: dict[str, _Code] = {}
        for each in functions:  # those that are called come first
            self._codes[each.name] = _Prepared(each, self._codes).code()

    def __call__(self, *arguments: Any) -> Any:
        passed: list[Any] = []
        kinds = list(_kinds(self._types))
        for type, value in zip(kinds, flat(self._label, self._types, arguments), strict=True):
            passed += _array(value, type) if isinstance(type, ArrayType) else [_number(value, type)]
        with np.errstate(all="ignore"):
            output = _run(self._codes[self._name], passed)
        numbers = list(leaves(self._result))
        values = [_given(each, value) for each, value in zip(numbers, output if len(numbers) > 1 else (output,), strict=False)]
        if not numbers:
            return None
        return tuple(values) if isinstance(self._result, tuple) else values[0]


def _kinds(types: Sequence[Any]) -> Any:
    for each in types:
        if isinstance(each, tuple):
            yield from _kinds(each)
        else:
            yield each


def _number(value: Any, type: Scalar) -> Any:
    if type.kind in ("double", "float"):
        return DTYPES[type.kind](np.float64(value))
    return np.bool_(value) if type.kind == "i1" else wrapped(int(value))


def _array(array: Any, type: ArrayType) -> list[Any]:
    """The address of an array, its lengths, and its steps if it may have any."""
    low, high = byte_bounds(array)
    start = array.__array_interface__["data"][0]
    buffer = (ctypes.c_uint8 * (high - low if array.size else 0)).from_address(low)
    memory = _Memory(np.ctypeslib.as_array(buffer))
    steps = [np.int64(each // array.itemsize) for each in array.strides] if type.strided else []
    return [_Pointer(memory, start - low if array.size else 0), *map(np.int64, array.shape), *steps]


def _given(number: Item, value: Any) -> Any:
    if number.kind in ("double", "float"):
        return float(value)
    return bool(value) if number.kind == "i1" else int(value) & ((1 << 64) - 1) if number.kind == UNSIGNED else int(value)


def _run(code: _Code, arguments: Sequence[Any]) -> Any:
    registers = code.registers.copy()
    registers[: len(arguments)] = arguments
    for place, make in code.slots:
        registers[place] = make()
    block: Any = 0
    while type(block) is int:
        for step in code.blocks[block]:
            step(registers)
        block = code.ends[block](registers)
    return block[0]


class _Prepared:
    """Makes a function ready to run."""

    def __init__(self, function: Function, codes: dict[str, _Code]) -> None:
        self.function, self.codes = function, codes
        self.registers: list[Any] = [None] * len(function.arguments)
        self.places = {each.name: k for k, each in enumerate(function.arguments)}
        self.labels = {each.label: k for k, each in enumerate(function.blocks)}

    def code(self) -> _Code:
        slots = [(self.place(each.result), _room(each.extra)) for each in self.function.slots if each.result is not None]
        blocks = [[self.step(each) for each in block.body[:-1]] for block in self.function.blocks]
        ends = [self.end(block.body[-1]) for block in self.function.blocks]
        return _Code(self.registers, slots, blocks, ends)

    def place(self, number: Number) -> int:
        """The register of a number; a constant has its own."""
        name = number.name if number.name[0] == "%" else number.typed
        if name not in self.places:
            self.places[name] = len(self.registers)
            self.registers.append(None if name[0] == "%" else _constant(number))
        return self.places[name]

    def fault(self, each: Instruction, why: str) -> KernelFault:
        return KernelFault(f"{self.function.file}, line {each.line}: {why}")

    def end(self, each: Instruction) -> _Step:
        numbers = [self.place(operand) for operand in each.operands]
        if each.op == "return":
            return lambda registers: (registers[numbers[0]] if numbers else None,)
        targets = [self.labels[label] for label in each.extra]
        if each.op == "jump":
            return lambda registers: targets[0]
        return lambda registers: targets[0] if registers[numbers[0]] else targets[1]

    def step(self, each: Instruction) -> _Step:
        numbers = [self.place(operand) for operand in each.operands]
        to = -1 if each.result is None else self.place(each.result)
        meaning = OPS[each.op].meaning
        if meaning is None:
            output: _Step = getattr(self, f"_{each.op}")(each, to, *numbers)
            return output
        function, dtype = meaning, DTYPES.get("" if each.result is None else each.result.base)
        one, two, three = (*numbers, -1, -1)[:3]
        if "to {r.type}" in OPS[each.op].text or each.op in ("fptosi", "fptoui"):

            def cast(registers: list[Any]) -> None:
                registers[to] = function(registers[one], dtype)

            return cast
        if len(numbers) == 1:

            def unary(registers: list[Any]) -> None:
                registers[to] = function(registers[one])

            return unary
        if len(numbers) == 2:

            def binary(registers: list[Any]) -> None:
                registers[to] = function(registers[one], registers[two])

            return binary

        def ternary(registers: list[Any]) -> None:
            registers[to] = function(registers[one], registers[two], registers[three])

        return ternary

    # --- memory --------------------------------------------------------------------------------------------------------

    def _element(self, each: Instruction, to: int, address: int, index: int) -> _Step:
        size = np.dtype(DTYPES[each.extra]).itemsize

        def step(registers: list[Any]) -> None:
            memory, at = registers[address]
            registers[to] = _Pointer(memory, at + int(registers[index]) * size)

        return step

    def _load(self, each: Instruction, to: int, address: int) -> _Step:
        assert each.result is not None
        type = each.result.base

        def step(registers: list[Any]) -> None:
            place = registers[address]
            if isinstance(place, _Slot):
                registers[to] = place.value
                if place.value is None:
                    raise self.fault(each, "a variable is read that nothing was stored to")
                return
            try:
                registers[to] = place.memory.load(place.at, type)
            except IndexError:
                raise self.fault(each, "memory is read that is none of the array, or that nothing was stored to") from None

        return step

    def _store(self, each: Instruction, to: int, value: int, address: int) -> _Step:
        type = each.operands[0].base

        def step(registers: list[Any]) -> None:
            place = registers[address]
            if isinstance(place, _Slot):
                place.value = registers[value]
                return
            try:
                place.memory.store(place.at, type, registers[value])
            except IndexError:
                raise self.fault(each, "memory is stored to that is none of the array") from None

        return step

    def _prefetch(self, each: Instruction, to: int, address: int) -> _Step:
        return lambda registers: None

    # --- functions -----------------------------------------------------------------------------------------------------

    def _call(self, each: Instruction, to: int, *passed: int) -> _Step:
        code = self.codes[each.extra]

        def step(registers: list[Any]) -> None:
            registers[to] = _run(code, [registers[place] for place in passed])

        if to < 0:
            return lambda registers: _run(code, [registers[place] for place in passed])
        return step

    def _extractvalue(self, each: Instruction, to: int, of: int) -> _Step:
        def step(registers: list[Any]) -> None:
            registers[to] = registers[of][each.extra]

        return step

    def _insertvalue(self, each: Instruction, to: int, of: int, value: int) -> _Step:
        def step(registers: list[Any]) -> None:
            registers[to] = (*registers[of], registers[value])

        return step

    # --- checks --------------------------------------------------------------------------------------------------------

    def _index(self, each: Instruction, to: int, index: int, length: int) -> _Step:
        def step(registers: list[Any]) -> None:
            if not 0 <= registers[index] <= registers[length] - each.extra:
                raise KernelFault(described(self.function.file, each.line, each.op))

        return step

    def _divisor(self, each: Instruction, to: int, number: int) -> _Step:
        def step(registers: list[Any]) -> None:
            if registers[number] == 0:
                raise KernelFault(described(self.function.file, each.line, each.op))

        return step


def _room(extra: str) -> Callable[[], Any]:
    """What makes a place on the stack."""
    output = _ROOM.match(extra)
    if output is None:
        return _Slot
    bytes_ = int(output[1]) * np.dtype(DTYPES[output[2]]).itemsize
    return lambda: _Pointer(_Memory(np.zeros(bytes_, np.uint8), bytearray(b"\1") * bytes_), 0)


def _constant(number: Number) -> Any:
    """The value of a number of the text."""
    name = number.name
    if name == "poison":
        return ()
    if number.base in ("double", "float"):
        value = struct.unpack(">d", bytes.fromhex(name[2:]))[0] if name.startswith("0x") else float(name)
        return DTYPES[number.base](value)
    if number.base == "i1":
        return np.bool_(name == "true")
    return DTYPES[number.base](int(name))
