"""State that the functions of a kernel share while they are written, and the state of one function."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from antdsl.machine_code.kernels.ir import Function
from antdsl.machine_code.kernels.values import Item, Number, leaves
from antdsl.machine_code.kinds import WIDTH


@dataclass(slots=True)
class Variable:
    """A number that may change: its kind, and its stack slot."""

    kind: str
    place: Number
    lanes: int = 1

    @property
    def wide(self) -> bool:
        return self.lanes > 1


@dataclass(slots=True)
class Loop:
    """Where `continue` and `break` go to."""

    following: str
    end: str


@dataclass(slots=True, eq=False)
class Unit:
    """All functions of a text. `specialisations`: their names and results, by key. `written`: the numbers of the arguments with
    arrays that some function stores to. `lanes`: the lanes of independent loops, 1 or 8."""

    lanes: int = WIDTH
    functions: list[Function] = field(default_factory=list)
    specialisations: dict[tuple[Any, str], tuple[str, Item]] = field(default_factory=dict)
    written: set[int] = field(default_factory=set)


def result_type(item: Item) -> str:
    """Return the result type of a function that returns an item."""
    numbers = [each.type for each in leaves(item)]
    return "void" if not numbers else numbers[0] if len(numbers) == 1 else f"{{{', '.join(numbers)}}}"
