"""Builds plan nodes: checks the operands against the table of operations, folds constants, and returns the same object for equal
operations."""

from __future__ import annotations

from typing import Any

from antdsl.plan import simplify
from antdsl.plan.ir import KIND_BY_LETTER, OPERATION_BY_NAME, TUPLE_KINDS_BY_OPERATION, PlanNode, UpdateRate, ValueKind
from antdsl.plan.simplify import round_to_f32
from antdsl.source import Span

_REGISTER_OPERATIONS = frozenset(("snap", "load", "other", "agent.get", "item.get"))


class PlanError(AssertionError):
    """Error for a plan that breaks the rules for plans. It is due to a bug in antdsl, not to a mistake in the program's text."""


def find_operand_problem(op: str, args: tuple[PlanNode, ...], attrs: tuple[Any, ...]) -> str | None:
    """Return an error message about the operands and attributes of an operation, or None if they are valid."""
    shape = (op, len(attrs), *[arg.kind for arg in args])
    if shape in _VALID_OPERAND_SHAPES:
        return None
    wrong = _find_operand_problem(op, args, attrs)
    if wrong is None:
        _VALID_OPERAND_SHAPES.add(shape)
    return wrong


# Operand kinds and attribute counts that `_find_operand_problem` has already accepted, by operation.
_VALID_OPERAND_SHAPES: set[tuple[Any, ...]] = set()


def _find_operand_problem(op: str, args: tuple[PlanNode, ...], attrs: tuple[Any, ...]) -> str | None:
    row = OPERATION_BY_NAME.get(op)
    if row is None:
        return f"no operation {op}"
    if len(args) != len(row.args):
        return f"{op} takes {len(row.args)} operands, not {len(args)}"
    if len(attrs) != len(row.attrs):
        return f"{op} takes attributes {row.attrs}, not {attrs!r}"
    for position, (letter, arg) in enumerate(zip(row.args, args, strict=True)):
        if letter == "x":
            if arg.kind in (ValueKind.TUPLE, ValueKind.SET):
                return f"operand {position} of {op} is a {arg.kind.value}"
        elif arg.kind is not KIND_BY_LETTER[letter]:
            return f"operand {position} of {op} is a {arg.kind.value}, not a {KIND_BY_LETTER[letter].value}"
    if op in ("eq", "ne", "lt", "le") and args[0].kind is not args[1].kind:
        return f"{op} compares a {args[0].kind.value} with a {args[1].kind.value}"
    if op == "where" and args[1].kind is not args[2].kind:
        return f"where chooses between a {args[1].kind.value} and a {args[2].kind.value}"
    return None


def infer_result_kind(op: str, args: tuple[PlanNode, ...], attrs: tuple[Any, ...], kind: ValueKind | None) -> ValueKind:
    """Return the kind of an operation's result. `kind`: the kind of the register, for an operation that reads a register."""
    if op in _REGISTER_OPERATIONS:
        return kind or ValueKind.F32
    if op == "where":
        return args[1].kind
    if op == "get":
        index: int = attrs[0]
        return TUPLE_KINDS_BY_OPERATION[args[0].op][index]
    return OPERATION_BY_NAME[op].kind


def infer_result_rate(op: str, args: tuple[PlanNode, ...]) -> UpdateRate:
    """Return the update rate of an operation's result. It is the highest rate among the operation's own rate and the rates of
    its operands.

    A reduction over a set has the rate AGENT, whatever the rates of its operands."""
    if op.startswith("reduce."):
        return UpdateRate.AGENT
    rate = OPERATION_BY_NAME[op].rate
    for arg in args:
        if arg.rate > rate:
            rate = arg.rate
    return rate


class PlanBuilder:
    """Builder of the nodes of a plan, which stores each distinct node once. `span`: the source location that new nodes
    receive."""

    def __init__(self) -> None:
        self.nodes: list[PlanNode] = []
        self.span: Span | None = None
        self._interned_nodes: dict[tuple[Any, ...], PlanNode] = {}
        self.true = self("const.bool", attrs=(True,))
        self.false = self("const.bool", attrs=(False,))

    def __call__(self, op: str, *args: PlanNode, attrs: tuple[Any, ...] = (), kind: ValueKind | None = None) -> PlanNode:
        """Return the node of an operation, or a simpler node with the same value if there is one."""
        wrong = find_operand_problem(op, args, attrs)
        if wrong:
            raise PlanError(wrong)
        simple = simplify.simplify_operation(self, op, args, attrs)
        return simple if simple is not None else self.find_or_add(op, args, attrs, infer_result_kind(op, args, attrs, kind))

    def find_or_add(
        self, op: str, args: tuple[PlanNode, ...], attrs: tuple[Any, ...], kind: ValueKind, span: Span | None = None
    ) -> PlanNode:
        """Return the node of an operation with these operands and attributes. If no equal node exists, a new one is added."""
        key = (op, tuple([a.number for a in args]), repr(attrs) if attrs else "", kind)
        node = self._interned_nodes.get(key)
        if node is None:
            node = PlanNode(op, args, attrs, kind, infer_result_rate(op, args), span or self.span, len(self.nodes))
            self.nodes.append(node)
            self._interned_nodes[key] = node
        return node

    def add_number(self, x: float) -> PlanNode:
        """Return the node of an F32 constant."""
        return self("const", attrs=(round_to_f32(float(x)),))

    def add_boolean(self, x: bool) -> PlanNode:
        """Return the node of a BOOL constant."""
        return self.true if x else self.false

    def add_row(self, index: int) -> PlanNode:
        """Return the node of an I32 constant: the index of a state or the row of an item."""
        return self("const.i32", attrs=(int(index),))

    def add_agent_id(self, x: int) -> PlanNode:
        """Return the node of an I64 constant: the id of an agent."""
        return self("const.i64", attrs=(int(x),))

    def add_constant(self, kind: ValueKind, value: float | int | bool = 0) -> PlanNode:
        """Return the node of a constant with the kind `kind`."""
        if kind is ValueKind.F32:
            return self.add_number(float(value))
        if kind is ValueKind.BOOL:
            return self.add_boolean(bool(value))
        return self.add_row(int(value)) if kind is ValueKind.I32 else self.add_agent_id(int(value))

    def add_conjunction(self, *conditions: PlanNode) -> PlanNode:
        """Return a node that is true where all conditions are true."""
        result = self.true
        for condition in conditions:
            result = self("and", result, condition)
        return result
