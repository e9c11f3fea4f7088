"""What the functions of a kernel have together while they are written, and what is known within one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from antdsl.machine_code.kernels.values import Item, leaves, type_name


@dataclass(slots=True)
class Variable:
    """A number that may change: its kind, and its place on the stack."""

    kind: str
    place: str


@dataclass(slots=True)
class Loop:
    """Where `continue` and `break` go to, and what loads and stores within are said to be free of, if anything."""

    following: str
    end: str
    group: str = ""


@dataclass(slots=True, eq=False)
class Unit:
    """All functions of a text: `made` by what they are known by, with what each gives back; `written`: the arguments whose
    arrays some function stores to, by number."""

    functions: list[str] = field(default_factory=list)
    declared: dict[str, str] = field(default_factory=dict)
    made: dict[tuple[Any, str], tuple[str, Item]] = field(default_factory=dict)
    written: set[int] = field(default_factory=set)
    metadata: list[str] = field(default_factory=list)

    def number(self, text: str) -> str:
        self.metadata.append(f"!{len(self.metadata)} = {text}")
        return f"!{len(self.metadata) - 1}"


def result_type(item: Item) -> str:
    """What a function that gives back an item has as its type."""
    numbers = [type_name(each) for each in leaves(item)]
    return "void" if not numbers else numbers[0] if len(numbers) == 1 else f"{{{', '.join(numbers)}}}"
