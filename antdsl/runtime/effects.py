"""What the blocks of one step ask of the rest of the world. A backend fills an `Effects`; the phases apply it afterwards.

Every entry holds the rows of one statement in one chunk; applying them in another order gives the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.source import Span

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class ClaimEntry:
    statement: ir.Claim
    order: int  # place of the statement in the text of its species
    rows: Rows
    item: NDArray[np.int32]
    amount: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class GiveEntry:
    """`amount` float64 is what the agents' own registers have lost already."""

    statement: ir.Give
    item: NDArray[np.int32]
    amount: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DepositEntry:
    field: str
    rows: Rows
    amount: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class CarveEntry:
    """`middle` (k, 3) and `radius` of the balls that are dug."""

    statement: ir.Carve
    order: int  # place of the statement in the text of its species
    rows: Rows
    radius: NDArray[np.float32]
    middle: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class EmitEntry:
    """`within` None: only for the agent itself."""

    event: str
    rows: Rows
    within: NDArray[np.float32] | None


@dataclass(frozen=True, slots=True, eq=False)
class SpawnEntry:
    species: str
    order: int
    rows: Rows


@dataclass(frozen=True, slots=True, eq=False)
class FaultEntry:
    """A value that is not finite: where it was met, by whom, and in which block (to run it again slowly)."""

    block: str
    register: str
    span: Span | None
    rows: Rows


@dataclass(slots=True, eq=False)
class Effects:
    """All that the agents of one species ask for in one step."""

    claims: list[ClaimEntry] = field(default_factory=list)
    gives: list[GiveEntry] = field(default_factory=list)
    deposits: list[DepositEntry] = field(default_factory=list)
    carves: list[CarveEntry] = field(default_factory=list)
    emits: list[EmitEntry] = field(default_factory=list)
    spawns: list[SpawnEntry] = field(default_factory=list)
    deaths: list[Rows] = field(default_factory=list)
    faults: list[FaultEntry] = field(default_factory=list)

    def take(self, other: Effects) -> None:
        """Put another's entries after one's own."""
        for name in self.__slots__:
            mine: list[Any] = getattr(self, name)
            mine.extend(getattr(other, name))
