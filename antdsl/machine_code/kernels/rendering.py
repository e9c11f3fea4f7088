"""Instructions as text in LLVM's language."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.machine_code.kernels.checks import Checks
from antdsl.machine_code.kernels.ir import CHECKS, MOST, ZEROS, Function, Instruction
from antdsl.machine_code.kernels.line_tables import LineTables
from antdsl.machine_code.kernels.operations import OPS
from antdsl.machine_code.kernels.values import Number

_VOID = Number("void", "")
_PREFETCH = "declare void @llvm.prefetch.p0(ptr, i32, i32, i32)"


def rendered(functions: Sequence[Function], checks: Checks | None = None, tables: LineTables | None = None) -> list[str]:
    """The texts of functions, and of what they call of LLVM. Without `checks`, the checks in them are left out, and without
    `tables` their lines."""
    declared = {ZEROS.name: f"{ZEROS.name} = internal constant [{MOST} x i64] zeroinitializer, align 64"}
    texts = [_function(each, declared, checks, tables) for each in functions]
    return [*declared.values(), *texts, *([] if checks is None else [checks.text()])]


def _function(function: Function, declared: dict[str, str], checks: Checks | None, tables: LineTables | None) -> str:
    arguments = ", ".join(each.typed for each in function.arguments)
    metadata = ""
    if tables is not None:
        first = min((each.line for block in function.blocks for each in block.body if each.line), default=1)
        metadata = tables.begin(function.name[1:], function.file, first)
    head = f"define internal {function.result} {function.name}({arguments}) {function.attribute}{metadata} {{"
    lines = [head, "entry:", *(_line(each, declared) for each in function.slots)]
    for k, block in enumerate(function.blocks):
        if k:
            lines.append(f"{block.label}:")
        for each in block.body:
            if each.op not in CHECKS:
                lines.append(_line(each, declared) + ("" if tables is None else tables.of(each.line)))
            elif checks is not None:
                lines += checks.lines(function, each)
            if each.op == "call" and checks is not None:
                lines += checks.after_call(function)
    return "\n".join([*lines, "}"])


def _line(each: Instruction, declared: dict[str, str]) -> str:
    operation, result = OPS[each.op], each.result or _VOID
    everything = ""
    if each.op in ("call", "return"):
        everything = ", ".join(operand.typed for operand in each.operands) or ("void" if each.op == "return" else "")
    text = operation.text.format(*each.operands, r=result, x=each.extra, all=everything)
    if "@llvm" in operation.text:
        name = text[text.index("@") : text.index("(")]
        types = ", ".join(operand.type for operand in each.operands)
        declared[name] = _PREFETCH if each.op == "prefetch" else f"declare {result.type} {name}({types})"
    return f"  {text}" if each.result is None else f"  {result.name} = {text}"
