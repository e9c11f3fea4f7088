"""The input of a check: the program, and the uses of its names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from antdsl.program.model import Program
from antdsl.program.names.scope import Declarations, FileNames


@dataclass(frozen=True, slots=True)
class CheckContext:
    program: Program
    declared: Declarations
    files: Sequence[FileNames]

    def is_used(self, kind: str, name: str) -> bool:
        return (kind, name) in self.declared.used
