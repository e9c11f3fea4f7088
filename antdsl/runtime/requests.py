"""Requests by which the blocks of a step change other parts of the world. A backend collects them in an `EffectRequests`;
later phases apply them. Each entry contains the requests of one statement for one chunk of rows. Results are bit-identical for
any order of entries."""

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
    """The claims of several agents on items or field cells, made by one statement.

    `rows`: the agents. `item`, `amount`: for each claim, the item or cell, and the claimed amount. `order`: the position of
    the statement in the source of its species."""

    statement: ir.Claim
    order: int  # place of the statement in the text of its species
    rows: Rows
    item: NDArray[np.int32]  # item or cell of a field; -1 for none
    amount: NDArray[np.float32]  # inf: the complete remainder


@dataclass(frozen=True, slots=True, eq=False)
class GiftEntry:
    """The gifts of agents to items. `amount` float64: the given amounts, already subtracted from the agents' registers."""

    statement: ir.Give
    item: NDArray[np.int32]
    amount: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RequestEntry:
    """The requests of several agents, made by one statement. `args`: operands with a value per row; None if absent."""

    request: ir.Request
    order: int  # place of the statement in the text of its species
    rows: Rows
    args: tuple[NDArray[np.float32] | NDArray[np.int64] | None, ...]  # ids of agents are int64

    def get_required_operand(self, index: int) -> NDArray[Any]:
        """Return operand `index`. It must be present."""
        value = self.args[index]
        assert value is not None
        return value


@dataclass(frozen=True, slots=True, eq=False)
class FaultEntry:
    """A value for `register` that is not finite, in the agents `rows`. `span`: the location of the statement in the source.

    `block`: the block of the statement. The reference backend repeats this block to explain the value."""

    block: str
    register: str
    span: Span | None
    rows: Rows


@dataclass(slots=True, eq=False)
class EffectRequests:
    """All requests that the agents of one species make in one step."""

    claims: list[ClaimEntry] = field(default_factory=list)
    gifts: list[GiftEntry] = field(default_factory=list)
    faults: list[FaultEntry] = field(default_factory=list)
    requests: dict[str, list[RequestEntry]] = field(default_factory=dict)  # by the op of the effect

    @property
    def has_pending(self) -> bool:
        """Return whether any request, claim or gift has not been applied yet."""
        return bool(self.requests or self.claims or self.gifts)

    def add_request(self, entry: RequestEntry) -> None:
        """Add a request."""
        self.requests.setdefault(entry.request.op, []).append(entry)

    def pop_requests(self, op: str) -> list[RequestEntry]:
        """Remove and return all requests of one operation, such as `deposit`."""
        return self.requests.pop(op, [])

    def append_all(self, other: EffectRequests) -> None:
        """Append all claims, gifts, faults and requests of `other` to these."""
        self.claims += other.claims
        self.gifts += other.gifts
        self.faults += other.faults
        for op, entries in other.requests.items():
            self.requests.setdefault(op, []).extend(entries)
