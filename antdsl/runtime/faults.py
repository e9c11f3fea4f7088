"""Values that are not finite: who, where in the text, from what operands; and whether the run goes on (decision 24).

The agent is run again, alone, by the reference backend, which knows every value on the way.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.runtime.world import Population, World

_TOLD = 20  # faults told in full; the others are only counted


@dataclass(frozen=True, slots=True)
class Fault:
    """One refused value. `operands`: text (or operation) and value of what went into it."""

    frame: int
    species: str
    agent: int
    what: str
    span: Span | None
    operands: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        place = "" if self.span is None else f"{self.span}: "
        values = ", ".join(f"{text} = {value}" for text, value in self.operands)
        return f"{place}{self.species} {self.agent} at frame {self.frame}: `{self.what}` is not finite" + (f" ({values})" if values else "")


@dataclass(slots=True)
class FaultLog:
    """All faults of a run: how many, of which the first are told in full."""

    count: int = 0
    refused_births: int = 0  # beyond limits.AGENTS
    told: list[Fault] = field(default_factory=list)


class FaultStop(RuntimeError):
    """The run stops after the step in which something was at fault; `fault` is the first one told."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(str(fault))
        self.fault = fault


def gather(world: World) -> bool:
    """Count the faults of this step, tell the first ones, set the agents aside if so asked. Whether there were any."""
    found = False
    for population in world.populations.values():
        entries = population.effects.faults
        for entry in sorted(entries, key=lambda e: -1 if e.span is None else e.span.start):
            found = True
            world.faults.count += len(entry.rows)
            rows = entry.rows[population.ids[entry.rows].argsort()]
            for row in rows[: max(0, _TOLD - len(world.faults.told))]:
                world.faults.told.append(_tell(world, population, int(row), entry.block, entry.register, entry.span))
            if world.options.on_fault == "quarantine":
                population.quarantined[entry.rows] = True
        entries.clear()
    return found


def _tell(world: World, population: Population, row: int, block: str, what: str, span: Span | None) -> Fault:
    from antdsl.runtime.backends.reference import operands_of

    operands = operands_of(world, population, row, block, what, span)
    return Fault(world.frame, population.name, int(population.ids[row]), what, span, operands)
