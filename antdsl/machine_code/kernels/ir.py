"""The typed instructions of kernels and plans: functions that consist of basic blocks, with a builder and a verifier."""

from __future__ import annotations

import ast
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Generic, NamedTuple, NoReturn, TypeVar

from antdsl.machine_code.kernels.operations import BLOCK_ENDS, OPERATION_BY_NAME, TYPES_BY_CLASS
from antdsl.machine_code.kernels.values import Number, format_llvm_type
from antdsl.machine_code.number_kinds import LANE_COUNT

CHECK_MESSAGES = {  # operations that are checks, with their messages
    "index": "index out of range, or negative",
    "span": "lanes access memory outside the array",
    "divisor": "integer division by 0",
}
NumberType = TypeVar("NumberType", bound=Number)
MAX_CONSECUTIVE_ELEMENTS = 64  # maximum number of elements in one load
ZEROS_CONSTANT = Number("ptr", "@zeros")  # read by inactive lanes
LANE_ORDERS_CONSTANT = Number("ptr", "@orders")  # the bytes of `LANES_BY_MASK`
_LANE_SETS = [[lane for lane in range(LANE_COUNT) if bits >> lane & 1] for bits in range(1 << LANE_COUNT)]
LANES_BY_MASK = [
    [*lanes, *[0] * (LANE_COUNT - len(lanes))] for lanes in _LANE_SETS
]  # for each mask of eight lanes: the numbers of its lanes, then zeros
_NUMBER_TYPES = frozenset().union(*(TYPES_BY_CLASS[each] for each in "fib"))
_VARIADIC_OPERATIONS = BLOCK_ENDS | {"load", "store", "call"}
_GLOBAL_TYPES = {ZEROS_CONSTANT.name: "ptr", LANE_ORDERS_CONSTANT.name: "ptr"}


class NotInSubsetError(Exception):
    """Error for a kernel that uses constructs outside the supported subset. The cause is a mistake in antdsl's source; the
    message has the location."""


class InvalidCodeError(Exception):
    """Error for instructions with wrong types or in a wrong order. The cause is a mistake in the code that emits them."""


class Instruction(NamedTuple):
    """An operation of `OPERATION_BY_NAME` with its operands.

    - `immediate`: the constant that replaces the field `x` in the operation's text
    - `line`: the line in the kernel's source file"""

    op: str
    result: Number | None
    operands: tuple[Number, ...]
    immediate: Any
    line: int


class BasicBlock(NamedTuple):
    """A labelled sequence of instructions that ends with a branch or a return."""

    label: str
    body: list[Instruction]


@dataclass(slots=True)
class IrFunction:
    """A function of typed instructions.

    - `file`: its Python source file
    - `attribute`: its attribute in LLVM IR
    - `result`: its result type, as LLVM IR text
    - `slots`: the instructions that allocate its stack slots"""

    name: str
    file: str
    arguments: list[Number]
    attribute: str = ""
    result: str = "void"
    slots: list[Instruction] = field(default_factory=list)
    blocks: list[BasicBlock] = field(default_factory=list)


class IrBuilder(ABC, Generic[NumberType]):
    """Builder of the instructions of one function."""

    def __init__(self, place: str, file: str) -> None:
        self.function_name, self.file = place, file
        self.node: ast.AST = ast.Pass()  # the current statement
        self.line = 0  # the line of the current statement
        self.slots: list[Instruction] = []
        self.blocks = [BasicBlock("entry", [])]
        self.current_block = self.blocks[0]
        self._name_count = 0

    def make_name(self, stem: str = "v") -> str:
        """Return a new register name that starts with `stem`."""
        self._name_count += 1
        return f"%{stem}{self._name_count}"

    @abstractmethod
    def named_number(self, kind: str, name: str, lanes: int = 1, literal_value: Any = None) -> NumberType:
        """Return the number that is called `name` in the LLVM IR."""

    def op(self, op: str, kind: str, *operands: Number, x: Any = "", lanes: int = 0) -> NumberType:
        """Add an instruction, and return its result. `op`: the operation. `kind`: the kind of the result. `x`: the immediate
        constant. The result has `lanes` lanes, or as many as the first operand if `lanes` is 0."""
        output = self.named_number(kind, self.make_name(), lanes or operands[0].lanes)
        self.current_block.body.append(Instruction(op, output, operands, x, self.line))
        return output

    def emit_void(self, op: str, *operands: Number, x: Any = "", node: ast.AST | None = None) -> None:
        """Add an instruction that has no result. `op`: the operation. `x`: the immediate constant. `node`: the source
        location."""
        line = getattr(node, "lineno", self.line)
        self.current_block.body.append(Instruction(op, None, operands, x, line))

    def allocate_slot(self, kind: str, lanes: int = 1) -> Number:
        """Add a stack slot for a number, and return its address."""
        return self._add_stack_slot("a", format_llvm_type(kind, lanes))

    def allocate(self, count: int, stored_type: str) -> Number:
        """Add a stack slot for `count` numbers, and return its address."""
        return self._add_stack_slot("s", f"[{count} x {stored_type}], align 64")

    def _add_stack_slot(self, stem: str, type: str) -> Number:
        output = Number("ptr", self.make_name(stem))
        self.slots.append(Instruction("alloca", output, (), type, 0))
        return output

    def load(self, place: Number, kind: str, lanes: int = 1) -> NumberType:
        """Load the number at an address."""
        return self.op("load", kind, place, lanes=lanes)

    def store_number(self, place: Number, value: Number) -> None:
        """Store a number at an address."""
        self.emit_void("store", value, place)

    def make_label(self, stem: str) -> str:
        """Return a new block label that starts with `stem`."""
        self._name_count += 1
        return f"{stem}{self._name_count}"

    def begin_block(self, label: str) -> None:
        """Begin a block with this label; later instructions are added to this block."""
        self.current_block = BasicBlock(label, [])
        self.blocks.append(self.current_block)

    def jump(self, label: str) -> None:
        self.emit_void("jump", x=(label,))

    def branch(self, condition: Number, true_label: str, false_label: str) -> None:
        self.emit_void("branch", condition, x=(true_label, false_label))

    def fail(self, node: ast.AST, reason: str) -> NoReturn:
        """Raise NotInSubsetError with `reason` and the source location of `node`."""
        line = getattr(node, "lineno", self.line)
        raise NotInSubsetError(f"{self.file}, line {line}, `{self.function_name}`: {reason}")


def verify_functions(functions: Sequence[IrFunction], others: Mapping[str, IrFunction] | None = None) -> None:
    """Verify the types and the order of instructions. Raises InvalidCodeError.

    Operands must have types that fit their operation. Each register must be defined once, before it is read. Only the last
    instruction of a block may be a branch. `others`: further functions that may be called, by name."""
    known = {**(others or {}), **{each.name: each for each in functions}}
    for each in functions:
        _Verifier(each, known).verify_function()


class _Verifier:
    """A verifier of one function. `known`: the functions that it may call, by name."""

    def __init__(self, function: IrFunction, literal_value: Mapping[str, IrFunction]) -> None:
        self.function, self.known = function, literal_value
        self.types = {each.name: each.type for each in function.arguments}
        self.slots = {each.result.name: each.immediate for each in function.slots if each.result is not None}
        self.labels = {each.label for each in function.blocks}
        self.types |= dict.fromkeys(self.slots, "ptr") | _GLOBAL_TYPES

    def verify_function(self) -> None:
        for block in self.function.blocks:
            if not block.body:
                raise InvalidCodeError(f"{self.function.name}: block {block.label} is empty")
            last = block.body[-1]
            for each in block.body:
                if (each.op in BLOCK_ENDS) != (each is last):
                    self.raise_invalid_code(each, f"block {block.label} does not end with its only branch")
                self.check_instruction(each)

    def raise_invalid_code(self, instruction: Instruction, reason: str) -> NoReturn:
        raise InvalidCodeError(f"{self.function.file}, line {instruction.line}, {self.function.name}: {reason} ({instruction})")

    def check_instruction(self, instruction: Instruction) -> None:
        """Check the operands and the result of an instruction."""
        op, result, operands, *_ = instruction
        known, types = self.types, tuple([operand.type for operand in operands])
        for operand in operands:
            name = operand.name
            if known.get(name) != operand.type and name[0] in "%@":
                self.raise_invalid_code(instruction, f"{name} is {known.get(name, 'not known')}, not {operand.type}")
        gives = "" if result is None else result.type
        if not _matches_operation(op, types, gives):
            self.raise_invalid_code(instruction, "the operation does not support these types")
        if op in _VARIADIC_OPERATIONS:
            self._check_extra_rules(instruction, types, gives)
        if result is not None:
            if result.name in known:
                self.raise_invalid_code(instruction, "the name is defined twice")
            known[result.name] = gives

    def _check_extra_rules(self, instruction: Instruction, types: tuple[str, ...], result_type: str) -> None:
        """Check the rules of an instruction that the table of operand types does not express."""
        op, _, operands, extra, _ = instruction
        if op in ("load", "store"):
            slot = self.slots.get(operands[-1].name)
            if slot is not None and slot[0] != "[" and slot != (result_type or types[0]):
                self.raise_invalid_code(instruction, f"the place is {slot}")
        elif op == "call":
            if not self._check_call(extra, types, result_type or "void"):
                self.raise_invalid_code(instruction, "the types of the call differ from those of the function")
        elif op == "return":
            if self.function.result != (types[0] if types else "void"):
                self.raise_invalid_code(instruction, f"gives back {types}, not {self.function.result}")
        elif not self.labels.issuperset(extra):
            self.raise_invalid_code(instruction, "no such block")

    def _check_call(self, name: str, types: tuple[str, ...], result_type: str) -> bool:
        function = self.known.get(name)
        return function is not None and (tuple(one.type for one in function.arguments), function.result) == (types, result_type)


@cache
def _matches_operation(op: str, types: tuple[str, ...], result: str) -> bool:
    """Return whether the types of the operands and of the result match the table entry of an operation."""
    takes, gives, lanewise = (
        OPERATION_BY_NAME[op].operand_types,
        OPERATION_BY_NAME[op].result_type,
        OPERATION_BY_NAME[op].is_lanewise,
    )
    parts = [split_type(each) for each in types]
    bases = [base for _, base in parts]
    lanes = parts[0][0] if parts else 1
    if not takes.endswith("*") and len(takes) != len(types):
        return False
    if not all(_matches_class(letter, base, bases[0]) for letter, base in zip(takes, bases, strict=False)):
        return False
    if op == "select" and (types[1] != types[2] or lanes not in (1, parts[1][0])):
        return False
    if lanewise and op != "select" and any(each != lanes for each, _ in parts):
        return False
    if op == "call" or not (gives and result):
        return op == "call" or gives == result
    if gives in ("2", "="):
        return result == types[1 if gives == "2" else 0]
    own, base = split_type(result)
    return _matches_class(gives, base, "") and (not lanewise or own == lanes)


def split_type(type: str) -> tuple[int, str]:
    """Split an LLVM type into its number of lanes and the type of one lane."""
    lanes, _, base = type.strip("<>").partition(" x ") if type[0] == "<" else ("1", "", type)
    return int(lanes), base


def _matches_class(class_letter: str, base: str, first: str) -> bool:
    """Return whether the type `base` belongs to the class of types `class_letter`. `first`: the type of the first operand."""
    if class_letter in "v*":
        return True
    return (
        base == first
        if class_letter == "="
        else base in (_NUMBER_TYPES if class_letter == "n" else TYPES_BY_CLASS.get(class_letter, (class_letter,)))
    )
