"""Writes the entry functions of machine code: each sets the processor's floating-point mode, and restores it at the end.

A host may flush denormal numbers to zero or round upward, and a thread inherits that mode from its creator. So the outer
(entry) function sets the mode register and calls an inner function that does the work. LLVM does not move floating-point
operations across this call, so all of them run in the required mode."""

from __future__ import annotations

from antdsl.machine_code.llvm_module import LlvmModule
from antdsl.machine_code.number_kinds import I32, I64, PTR

ENTRY_ARGUMENTS = "ptr %t, i64 %begin, i64 %end"
_DEFAULT_MXCSR = 0x1F80  # no flush to zero, rounding to nearest, no traps


def write_inner_function(module: LlvmModule, name: str, body: str, line_table: str = "") -> str:
    """Return the LLVM IR of an inner function with the instructions `body`. Its parameters are a table of addresses, the first
    row, and the row after the last one.

    `line_table`: a suffix of the function's header that refers to its debug metadata, or an empty string."""
    inside = f"define internal void @{name}.inside({ENTRY_ARGUMENTS}) noinline{line_table} {{\nentry:\n{body}\n  ret void\n}}"
    return write_outer_function(module, name) + inside


def write_outer_function(module: LlvmModule, name: str) -> str:
    """Return the LLVM IR of the entry function `name`. It calls the inner function, which has the same name with the suffix
    `.inside`."""
    prologue, epilogue = (
        _write_x86_float_mode(module)
        if module.target.is_x86
        else _write_arm_float_mode(module)
        if module.target.is_arm
        else ("", "")
    )
    call = f"  call void @{name}.inside({ENTRY_ARGUMENTS})"
    return f"define void @{name}({ENTRY_ARGUMENTS}) {{\nentry:\n{prologue}{call}\n{epilogue}  ret void\n}}\n"


def _write_x86_float_mode(module: LlvmModule) -> tuple[str, str]:
    """Return the LLVM IR that sets the floating-point mode of x86 processors, and the LLVM IR that restores the old mode."""
    module.declare("llvm.x86.sse.stmxcsr", "void", [PTR])
    module.declare("llvm.x86.sse.ldmxcsr", "void", [PTR])
    prologue = (
        f"  %saved = alloca {I32}\n  %usual = alloca {I32}\n  store {I32} {_DEFAULT_MXCSR}, ptr %usual\n"
        "  call void @llvm.x86.sse.stmxcsr(ptr %saved)\n  call void @llvm.x86.sse.ldmxcsr(ptr %usual)\n"
    )
    return prologue, "  call void @llvm.x86.sse.ldmxcsr(ptr %saved)\n"


def _write_arm_float_mode(module: LlvmModule) -> tuple[str, str]:
    """Return the LLVM IR that sets the floating-point mode of ARM processors, and the LLVM IR that restores the old mode."""
    module.declare("llvm.aarch64.get.fpcr", I64, [])
    module.declare("llvm.aarch64.set.fpcr", "void", [I64])
    prologue = f"  %saved = call {I64} @llvm.aarch64.get.fpcr()\n  call void @llvm.aarch64.set.fpcr({I64} 0)\n"
    return prologue, f"  call void @llvm.aarch64.set.fpcr({I64} %saved)\n"
