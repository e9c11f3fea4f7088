"""The input of a check: the program, and the uses of its names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from antdsl.program.model import Program
from antdsl.program.names.scope import Declarations, FileNames


@dataclass(frozen=True, slots=True)
class CheckContext:
    """The input of a check: a program, the uses of its names, and its files."""

    program: Program
    declarations: Declarations
    files: Sequence[FileNames]

    def is_used(self, kind: str, name: str) -> bool:
        """Return whether the program uses a declared name. `kind`: the kind of its declaration, such as `param`."""
        return (kind, name) in self.declarations.used_names
