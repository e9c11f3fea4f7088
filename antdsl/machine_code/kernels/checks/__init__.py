"""The checked build of kernels: with `ANTDSL_CHECKED_KERNELS=1` in the environment, an error in a kernel raises KernelFault
with file and line. The build checks that indices are within their axis and that no integer is divided by 0. It also checks
that SIMD loads and stores stay within their array. A failed check stores its number in the word `fault` and returns zeros from
its function; each calling function then returns as well. Alignment needs no check: calls reject arrays that are not aligned to
their elements, and instructions assume no larger alignment. The interpreter raises the same errors."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from functools import wraps
from typing import Any, Final

from antdsl.machine_code.kernels.ir import CHECK_MESSAGES, Instruction, IrFunction
from antdsl.machine_code.llvm_compiler import LoadedCode
from antdsl.machine_code.number_kinds import LANE_COUNT

CHECKS_VARIABLE: Final = "ANTDSL_CHECKED_KERNELS"
CHECKS_ENABLED: Final = os.environ.get(CHECKS_VARIABLE) == "1"
_FAULT_VARIABLE, _FAULT_MESSAGES_VARIABLE = "fault", "fault.places"
_LANES_TYPE, _MASK_TYPE = f"<{LANE_COUNT} x i64>", f"<{LANE_COUNT} x i1>"
_HELPER_FUNCTIONS_TEXT = f"""@{_FAULT_VARIABLE} = global i64 0
define internal i1 @check.index(i64 %i, i64 %length, i64 %count) alwaysinline {{
  %last = sub i64 %length, %count
  %low = icmp sge i64 %i, 0
  %high = icmp sle i64 %i, %last
  %fine = and i1 %low, %high
  ret i1 %fine
}}
define internal i1 @check.all({_MASK_TYPE} %fine, {_MASK_TYPE} %mask) alwaysinline {{
  %wrong = xor {_MASK_TYPE} %fine, splat (i1 true)
  %counts = and {_MASK_TYPE} %wrong, %mask
  %bits = bitcast {_MASK_TYPE} %counts to i{LANE_COUNT}
  %none = icmp eq i{LANE_COUNT} %bits, 0
  ret i1 %none
}}
define internal i1 @check.indices({_LANES_TYPE} %i, i64 %length, i64 %count, {_MASK_TYPE} %mask) alwaysinline {{
  %last = sub i64 %length, %count
  %one = insertelement {_LANES_TYPE} poison, i64 %last, i64 0
  %lasts = shufflevector {_LANES_TYPE} %one, {_LANES_TYPE} poison, <{LANE_COUNT} x i32> zeroinitializer
  %low = icmp sge {_LANES_TYPE} %i, zeroinitializer
  %high = icmp sle {_LANES_TYPE} %i, %lasts
  %fine = and {_MASK_TYPE} %low, %high
  %found = call i1 @check.all({_MASK_TYPE} %fine, {_MASK_TYPE} %mask)
  ret i1 %found
}}"""


class KernelFault(RuntimeError):
    """Error in a kernel that uses an index outside an array, or divides by 0. The message names the file and the line."""


def format_check_message(file: str, line: int, op: str) -> str:
    """Return the message of a failed check. `op`: the check's operation."""
    return f"{file}, line {line}: {CHECK_MESSAGES[op]}"


class CheckRenderer:
    """Writes the checks of all functions of one LLVM IR text, and collects their messages."""

    def __init__(self) -> None:
        self._messages: list[str] = []
        self._numbers = 0

    def render_check(self, function: IrFunction, instruction: Instruction) -> list[str]:
        """Return the lines of LLVM IR for the check `instruction`. They return from the function if the check fails."""
        self._messages.append(format_check_message(function.file, instruction.line, instruction.op))
        self._numbers += 1
        lines, fine = [], f"%c{self._numbers}"
        first, *others = instruction.operands
        if instruction.op == "divisor" and not first.has_several_lanes:
            lines.append(f"  {fine} = icmp ne {first.typed_name}, 0")
        elif instruction.op == "divisor":
            lines.append(f"  {fine}.each = icmp ne {first.typed_name}, zeroinitializer")
            lines.append(f"  {fine} = call i1 @check.all({_MASK_TYPE} {fine}.each, {_render_mask(others)})")
        elif first.has_several_lanes:
            passed = f"{first.typed_name}, {others[0].typed_name}, i64 {instruction.immediate}, {_render_mask(others[1:])}"
            lines.append(f"  {fine} = call i1 @check.indices({passed})")
        else:
            length = others[0].name
            for k, other in enumerate(others[1:] if instruction.op == "span" else ()):
                lines.append(f"  {fine}.of{k} = mul i64 {length}, {other.name}")
                length = f"{fine}.of{k}"
            lines.append(f"  {fine} = call i1 @check.index({first.typed_name}, i64 {length}, i64 {instruction.immediate})")
        return [
            *lines,
            *self._render_failure_return(function, fine, f"  store i64 {len(self._messages)}, ptr @{_FAULT_VARIABLE}"),
        ]

    def render_call_check(self, function: IrFunction) -> list[str]:
        """Return the lines of LLVM IR that follow a call in `function`. They return from it if a check in the called function
        failed."""
        self._numbers += 1
        fine = f"%c{self._numbers}"
        return [
            f"  {fine}.word = load i64, ptr @{_FAULT_VARIABLE}", f"  {fine} = icmp eq i64 {fine}.word, 0",
            *self._render_failure_return(function, fine),
        ]  # fmt: skip

    def _render_failure_return(self, function: IrFunction, passed_label: str, *lines: str) -> list[str]:
        """Return the lines of LLVM IR for a failed check. If the condition `passed_label` is false, they run `lines` and
        return zeros from the function."""
        label = passed_label[1:]
        passed = "ret void" if function.result == "void" else f"ret {function.result} zeroinitializer"
        branch = f"  br i1 {passed_label}, label %{label}.fine, label %{label}.fault"
        return [branch, f"{label}.fault:", *lines, f"  {passed}", f"{label}.fine:"]

    def render_definitions(self) -> str:
        """Return the LLVM IR of those definitions that all checks of a module share."""
        data = "\n".join(self._messages).encode("utf-8", "surrogateescape") + b"\0"
        escaped = "".join(chr(each) if 32 <= each < 127 and each not in b'"\\' else f"\\{each:02X}" for each in data)
        return f'{_HELPER_FUNCTIONS_TEXT}\n@{_FAULT_MESSAGES_VARIABLE} = constant [{len(data)} x i8] c"{escaped}"'


def _render_mask(operands: list[Any]) -> str:
    return operands[0].typed_name if operands else f"{_MASK_TYPE} splat (i1 true)"


def guard_call(run: Callable[..., Any], code: LoadedCode) -> Callable[..., Any]:
    """Return a function that calls the checked kernel `run` and raises KernelFault if a check failed. `code`: the kernel's
    loaded code."""
    word = ctypes.c_int64.from_address(code.get_constant_address(_FAULT_VARIABLE))

    @wraps(run, assigned=())
    def call_guarded(*arguments: Any) -> Any:
        output = run(*arguments)
        if word.value:
            message = code.read_constant_text(_FAULT_MESSAGES_VARIABLE).split("\n")[word.value - 1]
            word.value = 0
            raise KernelFault(message)
        return output

    return call_guarded
