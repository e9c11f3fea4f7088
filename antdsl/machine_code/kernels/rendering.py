"""Writes typed instructions as LLVM IR."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from antdsl.machine_code.kernels.checks import CheckRenderer
from antdsl.machine_code.kernels.checks.line_tables import LineTables
from antdsl.machine_code.kernels.ir import (
    CHECK_MESSAGES,
    LANE_ORDERS_CONSTANT,
    LANES_BY_MASK,
    MAX_CONSECUTIVE_ELEMENTS,
    ZEROS_CONSTANT,
    Instruction,
    IrFunction,
    split_type,
)
from antdsl.machine_code.kernels.operations import OPERATION_BY_NAME
from antdsl.machine_code.kernels.values import Number
from antdsl.machine_code.number_kinds import LANE_COUNT

_LANE_ORDER_BYTES = ", ".join(f"i8 {lane}" for lanes in LANES_BY_MASK for lane in lanes)
_CONSTANT_TABLES = {
    ZEROS_CONSTANT.name: f"{ZEROS_CONSTANT.name} = internal constant [{MAX_CONSECUTIVE_ELEMENTS} x i64] zeroinitializer, "
    f"align 64",
    LANE_ORDERS_CONSTANT.name: f"{LANE_ORDERS_CONSTANT.name} = internal constant [{LANE_COUNT << LANE_COUNT} x i8] "
    f"[{_LANE_ORDER_BYTES}]",
}


def render_functions(
    functions: Sequence[IrFunction], checks: CheckRenderer | None = None, tables: LineTables | None = None
) -> list[str]:
    """Return the LLVM IR of functions, and the declarations of the LLVM functions that they call.

    `checks`: writes the checks; None leaves them out. `tables`: the debug line tables; None leaves line numbers out."""
    declared = {ZEROS_CONSTANT.name: _CONSTANT_TABLES[ZEROS_CONSTANT.name]}
    texts = [render_function(each, declared, checks, tables) for each in functions]
    return [*declared.values(), *texts, *([] if checks is None else [checks.render_definitions()])]


def render_function(
    function: IrFunction, declarations: dict[str, str], checks: CheckRenderer | None = None, tables: LineTables | None = None
) -> str:
    """Return the LLVM IR of a function. Add declarations of the LLVM functions that it calls and of the tables that it reads
    to `declarations`."""
    arguments = ", ".join(each.typed_name for each in function.arguments)
    metadata = ""
    if tables is not None:
        first = min((each.line for block in function.blocks for each in block.body if each.line), default=1)
        metadata = tables.begin_function(function.name[1:], function.file, first)
    head = f"define internal {function.result} {function.name}({arguments}) {function.attribute}{metadata} {{"
    lines = [head, "entry:", *(_render_instruction(each, declarations) for each in function.slots)]
    for k, block in enumerate(function.blocks):
        if k:
            lines.append(f"{block.label}:")
        for each in block.body:
            if each.op not in CHECK_MESSAGES:
                lines.append(
                    _render_instruction(each, declarations)
                    if tables is None
                    else _render_instruction(each, declarations) + tables.format_location(each.line)
                )
            elif checks is not None:
                lines += checks.render_check(function, each)
            if checks is not None and each.op == "call":
                lines += checks.render_call_check(function)
    return "\n".join([*lines, "}"])


def _render_instruction(instruction: Instruction, declarations: dict[str, str]) -> str:
    """Return the LLVM IR of an instruction. Add a declaration of the LLVM function or table that it uses to `declarations`."""
    op, result, operands, extra, _ = instruction
    if op in ("jump", "branch"):  # not cached, because lines with unique labels would fill the cache
        return "  " + OPERATION_BY_NAME[op].text.format(*operands, x=extra)
    text, called = _operation_pattern(
        op, tuple([operand.type for operand in operands]), "void" if result is None else result.type, extra
    )
    names = tuple([operand.name for operand in operands])
    if called is not None:
        declarations.setdefault(*called)
    elif op == "element" and names[0] in _CONSTANT_TABLES:
        declarations[names[0]] = _CONSTANT_TABLES[names[0]]
    return "  " + text % names if result is None else f"  {result.name} = {text % names}"


@cache
def _operation_pattern(op: str, types: tuple[str, ...], result_type: str, extra: Any) -> tuple[str, tuple[str, str] | None]:
    """Return the LLVM IR of an operation on these types, with `%s` for each operand. Also return the name and declaration of
    the LLVM function or table that it uses, or None."""
    operation = OPERATION_BY_NAME[op]
    operands = [Number(base, "%s", None, lanes) for lanes, base in map(split_type, types)]
    lanes, base = split_type(result_type)
    everything = ", ".join(operand.typed_name for operand in operands) or ("void" if op == "return" else "")
    text = operation.text.format(*operands, r=Number(base, "", None, lanes), x=extra, all=everything)
    if "@llvm" not in text:
        return text, None
    name = text[text.index("@") : text.index("(")]
    return text, (name, f"declare {result_type} {name}({', '.join(types)}{operation.extra_types})")
