"""Requests of the blocks of one step to the rest of the world. A backend fills an `EffectRequests`; the phases apply it
afterwards.

Every entry holds the rows of one statement in one chunk. Applying them in another order gives the same bits."""

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
    item: NDArray[np.int32]  # or the cell of a field; -1 for none
    amount: NDArray[np.float32]  # inf: all that is left


@dataclass(frozen=True, slots=True, eq=False)
class GiveEntry:
    """`amount` float64: what the agents' own registers have already lost."""

    statement: ir.Give
    item: NDArray[np.int32]
    amount: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RequestEntry:
    """One request of some agents: its operands, each with a value per row, None for an absent one."""

    request: ir.Request
    order: int  # place of the statement in the text of its species
    rows: Rows
    args: tuple[NDArray[np.float32] | NDArray[np.int64] | None, ...]  # ids of agents are int64

    def arg(self, index: int) -> NDArray[Any]:
        """An operand that is there."""
        value = self.args[index]
        assert value is not None
        return value


@dataclass(frozen=True, slots=True, eq=False)
class FaultEntry:
    """A value that is not finite: its location, its agents, and the block (to run it again slowly)."""

    block: str
    register: str
    span: Span | None
    rows: Rows


@dataclass(slots=True, eq=False)
class EffectRequests:
    """All requests of the agents of one species in one step."""

    claims: list[ClaimEntry] = field(default_factory=list)
    gives: list[GiveEntry] = field(default_factory=list)
    faults: list[FaultEntry] = field(default_factory=list)
    requests: dict[str, list[RequestEntry]] = field(default_factory=dict)  # by the op of the effect

    @property
    def open(self) -> bool:
        """Return whether a request, claim or gift still has to be settled."""
        return bool(self.requests or self.claims or self.gives)

    def ask(self, entry: RequestEntry) -> None:
        self.requests.setdefault(entry.request.op, []).append(entry)

    def drain(self, op: str) -> list[RequestEntry]:
        """The requests of one op, which are removed."""
        return self.requests.pop(op, [])

    def extend(self, other: EffectRequests) -> None:
        """Put another's entries after one's own."""
        self.claims += other.claims
        self.gives += other.gives
        self.faults += other.faults
        for op, entries in other.requests.items():
            self.requests.setdefault(op, []).extend(entries)
