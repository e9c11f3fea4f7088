"""The state of an LLVM IR text while its functions are written, and the variables and loop labels of one function."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from antdsl.machine_code.kernels.ir import IrFunction
from antdsl.machine_code.kernels.values import KernelItem, Number, flatten_item
from antdsl.machine_code.number_kinds import LANE_COUNT


@dataclass(slots=True)
class StackVariable:
    """A variable on the stack, with the kind of its number, the address of its stack slot, and its number of lanes."""

    kind: str
    slot_address: Number
    lanes: int = 1

    @property
    def has_several_lanes(self) -> bool:
        """Return whether the variable has a separate number for each SIMD lane."""
        return self.lanes > 1


@dataclass(slots=True)
class LoopLabels:
    """The labels of a loop: `continue` jumps to `next_label`, `break` to `end_label`."""

    next_label: str
    end_label: str


@dataclass(slots=True, eq=False)
class KernelUnit:
    """The functions of an LLVM IR text, while they are written.

    - `lanes`: how many iterations of independent loops run at once, 1 or 8
    - `functions`: the functions that are complete
    - `specialisations`: the name and result of each translation, by the Python function and the argument types
    - `written_arrays`: the numbers of the array arguments that some function writes to"""

    lanes: int = LANE_COUNT
    functions: list[IrFunction] = field(default_factory=list)
    specialisations: dict[tuple[Any, str], tuple[str, KernelItem]] = field(default_factory=dict)
    written_arrays: set[int] = field(default_factory=set)


def result_type(item: KernelItem) -> str:
    """Return the LLVM result type of a function that returns `item`."""
    numbers = [each.type for each in flatten_item(item)]
    return "void" if not numbers else numbers[0] if len(numbers) == 1 else f"{{{', '.join(numbers)}}}"
