"""The functions of one LLVM IR text for a given processor."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from antdsl.machine_code.kernels.ir import IrFunction
    from antdsl.machine_code.llvm_compiler import Target

_NAME_PATTERN = re.compile(r"@[\w.]+")


class LlvmModule:
    """The LLVM IR of functions by name, and the declarations of the LLVM functions that they call."""

    def __init__(self, target: Target) -> None:
        self.target = target
        self.declarations: dict[str, str] = {}  # by name, with @
        self.functions: dict[str, str] = {}
        self.written_functions: dict[str, IrFunction] = {}  # signatures of written functions, without instructions

    def declare(self, name: str, result: str, arguments: list[str]) -> None:
        """Add the declaration of an LLVM function, unless it exists."""
        self.declarations.setdefault(f"@{name}", f"declare {result} @{name}({', '.join(arguments)})")

    def text(self) -> str:
        """Return the complete LLVM IR."""
        return "\n".join((*self.declarations.values(), *self.functions.values())) + "\n"

    def list_entry_names(self) -> list[str]:
        """Return the names of the entry functions, which callers outside the module use."""
        return [name for name, text in self.functions.items() if text.startswith("define void")]

    def extract_unit_text(self, entry: str) -> str:
        """Return LLVM IR that can be compiled alone: the function `entry` and all functions that it calls."""
        output: dict[str, set[str]] = {}
        coming = [entry]
        while coming:
            name = coming.pop()
            if name not in output and name in self.functions:
                output[name] = set(_NAME_PATTERN.findall(self.functions[name]))
                coming += [each[1:] for each in output[name]]
        named = set[str]().union(*output.values())
        declared = [text for name, text in self.declarations.items() if name in named]
        return "\n".join((*declared, *(text for name, text in self.functions.items() if name in output))) + "\n"
