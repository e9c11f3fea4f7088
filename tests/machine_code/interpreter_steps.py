"""Translation of instructions for the interpreter: each becomes a function of the registers."""

from __future__ import annotations

import ctypes
import re
import struct
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from antdsl.machine_code.kernels.checks import KernelFault, format_check_message
from antdsl.machine_code.kernels.ir import LANE_ORDERS_CONSTANT, LANES_BY_MASK, Instruction, IrFunction, split_type
from antdsl.machine_code.kernels.operations import DTYPE_BY_TYPE, OPERATION_BY_NAME, wrap_to_dtype
from antdsl.machine_code.kernels.values import Number
from antdsl.machine_code.number_kinds import LANE_COUNT

_STACK_TYPE_PATTERN = re.compile(r"(?:\[(\d+) x )?(?:<(\d+) x )?(\w+)>?(?:\], align \d+)?")
_INTEGER_PATTERN = re.compile(r"-?\d+")
_PreparedStep = Callable[[list[Any]], Any]


class ArrayMemory:
    """Bytes of memory as numbers of any type. `empty` marks the bytes of `scratch` that were never stored to."""

    def __init__(self, data: Any, empty: bytearray | None = None) -> None:
        self._data, self._empty = data, empty
        self._views: dict[str, Any] = {}

    def _view(self, type: str) -> Any:
        if type not in self._views:
            self._views[type] = self._data.view(DTYPE_BY_TYPE[type])
        return self._views[type]

    def load(self, at: int, type: str, any_: bool = False) -> Any:
        """Return the number at a byte offset. Raises IndexError outside the memory, or for bytes never stored to unless
        `any_`."""
        view = self._view(type)
        index, rest = divmod(at, view.itemsize)
        if rest or not 0 <= index < len(view) or (self._empty is not None and self._empty[at] and not any_):
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


class ProcessMemory:
    """The memory of this process, by addresses, where a plan's arrays and the table of their addresses lie."""

    def load(self, at: int, type: str, any_: bool = False) -> Any:
        return Pointer(self, int(self.load(at, "i64"))) if type == "ptr" else self._place(at, type)[0]

    def store(self, at: int, type: str, value: Any) -> None:
        self._place(at, type)[0] = value

    def _place(self, at: int, type: str) -> Any:
        dtype = np.dtype(DTYPE_BY_TYPE[type])
        return np.frombuffer((ctypes.c_uint8 * dtype.itemsize).from_address(int(at)), dtype)


class Pointer(NamedTuple):
    memory: ArrayMemory | ProcessMemory
    at: int


class _StackSlot:
    """A variable's place on the stack."""

    value: Any = None


class PreparedFunction(NamedTuple):
    """A function ready to run: constant registers, makers of its stack slots, and its blocks of steps. The last step of a block
    returns the number of the next block, or the function's result."""

    registers: list[Any]
    slots: list[tuple[int, Callable[[], Any]]]
    blocks: list[list[_PreparedStep]]
    ends: list[Callable[[list[Any]], Any]]


def run_code(code: PreparedFunction, arguments: Sequence[Any]) -> Any:
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


class FunctionPreparer:
    """Makes a function ready to run."""

    def __init__(self, function: IrFunction, codes: dict[str, PreparedFunction]) -> None:
        self.function, self.codes = function, codes
        self.registers: list[Any] = [None] * len(function.arguments)
        self.places = {each.name: k for k, each in enumerate(function.arguments)}
        self.labels = {each.label: k for k, each in enumerate(function.blocks)}

    def code(self) -> PreparedFunction:
        slots = [
            (self.place(each.result), _make_allocator(each.immediate)) for each in self.function.slots if each.result is not None
        ]
        blocks = [[self.step(each) for each in block.body[:-1]] for block in self.function.blocks]
        ends = [self.end(block.body[-1]) for block in self.function.blocks]
        return PreparedFunction(self.registers, slots, blocks, ends)

    def place(self, number: Number) -> int:
        """The register of a number; a constant has its own."""
        name = number.name if number.name[0] == "%" else number.typed_name
        if name not in self.places:
            self.places[name] = len(self.registers)
            self.registers.append(None if name[0] == "%" else _constant(number))
        return self.places[name]

    def fault(self, each: Instruction, why: str) -> KernelFault:
        return KernelFault(f"{self.function.file}, line {each.line}: {why}")

    def end(self, each: Instruction) -> _PreparedStep:
        operands = [self.place(operand) for operand in each.operands]
        if each.op == "return":
            return lambda registers: (registers[operands[0]] if operands else None,)
        targets = [self.labels[label] for label in each.immediate]
        if each.op == "jump":
            return lambda registers: targets[0]
        return lambda registers: targets[0] if registers[operands[0]] else targets[1]

    def step(self, each: Instruction) -> _PreparedStep:
        slots = [self.place(operand) for operand in each.operands]
        to = -1 if each.result is None else self.place(each.result)
        method = getattr(self, f"_{each.op.partition('.')[0]}", None)
        if method is not None:
            output: _PreparedStep = method(each, to, *slots)
            return output
        function, dtype = (
            OPERATION_BY_NAME[each.op].meaning,
            DTYPE_BY_TYPE.get("" if each.result is None else each.result.lane_type),
        )
        assert function is not None
        if each.result is not None and each.result.has_several_lanes:
            return self.each_lane(each, to, slots, function)
        one, two, three = (*slots, -1, -1)[:3]
        if _is_cast(each.op):

            def cast(registers: list[Any]) -> None:
                registers[to] = function(registers[one], dtype)

            return cast
        if len(slots) == 1:

            def unary(registers: list[Any]) -> None:
                registers[to] = function(registers[one])

            return unary
        if len(slots) == 2:

            def binary(registers: list[Any]) -> None:
                registers[to] = function(registers[one], registers[two])

            return binary

        def ternary(registers: list[Any]) -> None:
            registers[to] = function(registers[one], registers[two], registers[three])

        return ternary

    def each_lane(self, each: Instruction, to: int, slots: list[int], function: Callable[..., Any]) -> _PreparedStep:
        """An operation on each lane of its operands."""
        assert each.result is not None
        lanes, wide = each.result.lanes, [operand.has_several_lanes for operand in each.operands]
        dtype = [DTYPE_BY_TYPE[each.result.lane_type]] if _is_cast(each.op) else []

        def step(registers: list[Any]) -> None:
            arguments = [registers[k] if many else (registers[k],) * lanes for k, many in zip(slots, wide, strict=True)]
            registers[to] = tuple([function(*lane, *dtype) for lane in zip(*arguments, strict=True)])

        return step

    # --- lanes ---------------------------------------------------------------------------------------------------------

    def _insertelement(self, each: Instruction, to: int, of: int, value: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            registers[to] = (*registers[of][: each.immediate], registers[value], *registers[of][each.immediate + 1 :])

        return step

    def _extractelement(self, each: Instruction, to: int, of: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            registers[to] = registers[of][each.immediate]

        return step

    def _shufflevector(self, each: Instruction, to: int, a: int, b: int) -> _PreparedStep:
        assert each.result is not None
        order = [int(number) for number in _INTEGER_PATTERN.findall(each.immediate.replace("i32", ""))[1:]] or [
            0
        ] * each.result.lanes

        def step(registers: list[Any]) -> None:
            both = registers[a] + registers[b]
            registers[to] = tuple([both[k] for k in order])

        return step

    def _permd(self, each: Instruction, to: int, of: int, order: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            registers[to] = tuple([registers[of][k & 7] for k in registers[order]])

        return step

    def _lanes(self, each: Instruction, to: int, mask: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            registers[to] = wrap_to_dtype(sum(1 << k for k, held in enumerate(registers[mask]) if held), np.int8)

        return step

    def _mask(self, each: Instruction, to: int, bits: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            registers[to] = tuple([np.bool_(int(registers[bits]) >> k & 1) for k in range(LANE_COUNT)])

        return step

    def _reduce(self, each: Instruction, to: int, of: int) -> _PreparedStep:
        function = OPERATION_BY_NAME[each.op].meaning
        assert function is not None

        def step(registers: list[Any]) -> None:
            registers[to] = reduce(function, registers[of])

        return step

    # --- memory --------------------------------------------------------------------------------------------------------

    def _element(self, each: Instruction, to: int, address: int, index: int) -> _PreparedStep:
        lanes, base = split_type(each.immediate)
        size = lanes * (8 if base == "ptr" else np.dtype(DTYPE_BY_TYPE[base]).itemsize)

        def step(registers: list[Any]) -> None:
            memory, at = registers[address]
            registers[to] = Pointer(memory, at + int(registers[index]) * size)

        return step

    def _load(self, each: Instruction, to: int, address: int) -> _PreparedStep:
        assert each.result is not None
        type, size, wide, lanes = (
            each.result.lane_type,
            _size(each.result.lane_type),
            each.result.has_several_lanes,
            range(each.result.lanes),
        )

        def step(registers: list[Any]) -> None:
            place = registers[address]
            if isinstance(place, _StackSlot):
                registers[to] = place.value
                if place.value is None:
                    raise self.fault(each, "a variable is read that nothing was stored to")
                return
            try:
                if wide:  # lanes of agents that do not ask may have any number
                    registers[to] = tuple([place.memory.load(place.at + size * k, type, True) for k in lanes])
                else:
                    registers[to] = place.memory.load(place.at, type)
            except IndexError:
                raise self.fault(each, "memory is read that is none of the array, or that nothing was stored to") from None

        return step

    def _store(self, each: Instruction, to: int, value: int, address: int) -> _PreparedStep:
        type, size, wide = each.operands[0].lane_type, _size(each.operands[0].lane_type), each.operands[0].has_several_lanes

        def step(registers: list[Any]) -> None:
            place = registers[address]
            if isinstance(place, _StackSlot):
                place.value = registers[value]
                return
            try:
                for k, number in enumerate(registers[value] if wide else (registers[value],)):
                    place.memory.store(place.at + size * k, type, number)
            except IndexError:
                raise self.fault(each, "memory is stored to that is none of the array") from None

        return step

    def _is_null(self, each: Instruction, to: int, address: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            registers[to] = np.bool_(registers[address].at == 0)

        return step

    def _atomic(self, each: Instruction, to: int, address: int, value: int) -> _PreparedStep:
        function, type = OPERATION_BY_NAME[each.op].meaning, each.operands[1].lane_type
        assert function is not None

        def step(registers: list[Any]) -> None:
            memory, at = registers[address]
            registers[to] = memory.load(at, type)
            memory.store(at, type, function(registers[to], registers[value]))

        return step

    def _nothing(self, each: Instruction, to: int, *operands: int) -> _PreparedStep:
        return lambda registers: None

    _prefetch = _volatile = _wait = _border = _nothing

    # --- functions -----------------------------------------------------------------------------------------------------

    def _call(self, each: Instruction, to: int, *arguments: int) -> _PreparedStep:
        code = self.codes[each.immediate]

        def step(registers: list[Any]) -> None:
            registers[to] = run_code(code, [registers[place] for place in arguments])

        if to < 0:
            return lambda registers: run_code(code, [registers[place] for place in arguments])
        return step

    def _extractvalue(self, each: Instruction, to: int, of: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            registers[to] = registers[of][each.immediate]

        return step

    def _insertvalue(self, each: Instruction, to: int, of: int, value: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            registers[to] = (*registers[of], registers[value])

        return step

    # --- checks --------------------------------------------------------------------------------------------------------

    def _index(self, each: Instruction, to: int, index: int, length: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            if not 0 <= registers[index] <= registers[length] - each.immediate:
                raise KernelFault(format_check_message(self.function.file, each.line, each.op))

        return step

    def _divisor(self, each: Instruction, to: int, number: int) -> _PreparedStep:
        def step(registers: list[Any]) -> None:
            if registers[number] == 0:
                raise KernelFault(format_check_message(self.function.file, each.line, each.op))

        return step


def _make_allocator(extra: str) -> Callable[[], Any]:
    """What makes a place on the stack."""
    output = _STACK_TYPE_PATTERN.fullmatch(extra)
    if output is None or output[3] == "i1" or not (output[1] or output[2]):
        return _StackSlot
    bytes_ = int(output[1] or 1) * int(output[2] or 1) * _size(output[3])
    return lambda: Pointer(ArrayMemory(np.zeros(bytes_, np.uint8), bytearray(b"\1") * bytes_), 0)


def _size(type: str) -> int:
    return int(np.dtype(DTYPE_BY_TYPE.get(type, np.int64)).itemsize)


def _is_cast(op: str) -> bool:
    return "to {r.type}" in OPERATION_BY_NAME[op].text or op in ("fptosi", "fptoui")


def _constants(number: Number) -> tuple[Any, ...]:
    """Those of several lanes."""
    name, lanes = number.name, number.lanes
    if name == "poison":
        return (None,) * lanes
    texts = ["0"] * lanes if name == "zeroinitializer" else [each.split()[-1] for each in name.strip("splat <>()").split(", ")]
    output = [_constant(Number(number.kind, text)) for text in texts]
    return tuple(output * (lanes // len(output)))


def _constant(number: Number) -> Any:
    """The value of a number of the text."""
    name = number.name
    if number.has_several_lanes:
        return _constants(number)
    if name == "poison":
        return ()
    if name == LANE_ORDERS_CONSTANT.name:
        return Pointer(ArrayMemory(np.array(LANES_BY_MASK, np.int8).ravel()), 0)
    if number.lane_type in ("double", "float"):
        value = struct.unpack(">d", bytes.fromhex(name[2:]))[0] if name.startswith("0x") else float(name)
        return DTYPE_BY_TYPE[number.lane_type](value)
    if number.lane_type == "i1":
        return np.bool_(name == "true")
    return DTYPE_BY_TYPE[number.lane_type](int(name))
