"""Values that are not finite: which agent, where in the text, from which operands, and whether the run continues (decision 24).

The reference backend runs the agent again, alone, because it has every intermediate value."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from antdsl.runtime.backends.reference import fault_operands
from antdsl.runtime.requests import FaultEntry
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.runtime.world import Population, World

_MAX_REPORTED_FAULTS = 20  # faults reported in full; the others are only counted


@dataclass(frozen=True, slots=True)
class Fault:
    """One rejected value, of one agent or of a whole species (`agent` -1). `operands`: text (or operation) and value of each
    operand. `why`: the reason, written after the name of the rejected value."""

    frame: int
    species: str
    agent: int
    what: str
    span: Span | None
    operands: tuple[tuple[str, str], ...]
    why: str = "is not finite"

    def __str__(self) -> str:
        return self._describe("" if self.span is None else f"{self.span}: ")

    @property
    def brief(self) -> str:
        """Return the same text with only the name of the file, for readers that do not need its location on this machine."""
        if self.span is None:
            return self._describe("")
        line, column = self.span.source.line_column(self.span.start)
        return self._describe(f"{PurePath(self.span.source.path).name}:{line}:{column}: ")

    def _describe(self, place: str) -> str:
        values = ", ".join(f"{text} = {value}" for text, value in self.operands)
        subject = self.species if self.agent < 0 else f"{self.species} {self.agent}"
        return f"{place}{subject} at frame {self.frame}: `{self.what}` {self.why}" + (f" ({values})" if values else "")


@dataclass(slots=True)
class FaultLog:
    """All faults of a run: their number, and the first ones in full."""

    count: int = 0
    refused_births: int = 0  # beyond limits.AGENTS
    reported: list[Fault] = field(default_factory=list)
    latest: Fault | None = None  # the first of the last step


class FaultStop(RuntimeError):
    """Raised after a step with a fault, to stop the run; `fault` is the first one reported."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(str(fault))
        self.fault = fault


class LimitStop(FaultStop):
    """The run stops in the middle of a step that would exceed the limits. The world cannot be used afterwards."""


def gather(world: World) -> None:
    """Count the faults since the last call, report the first ones, and quarantine their agents if requested."""
    log = world.faults
    for population in world.populations.values():
        if not population.effects.faults:
            continue
        groups: dict[tuple[int, str, str], list[FaultEntry]] = {}
        for entry in population.effects.faults:
            place = -1 if entry.span is None else entry.span.start
            groups.setdefault((place, entry.block, _register_word(entry.register)), []).append(entry)
        population.effects.faults = []
        for (_, _, word), entries in sorted(groups.items(), key=lambda pair: pair[0]):
            rows = np.unique(np.concatenate([entry.rows for entry in entries]))  # a vector has three parts and one fault
            rows = rows[np.argsort(population.ids[rows])]
            log.count += len(rows)
            for row in rows[: max(_MAX_REPORTED_FAULTS - len(log.reported), 0 if log.latest else 1)]:
                entry = min((e for e in entries if row in e.rows), key=lambda e: e.register)
                fault = _make_fault(world, population, int(row), entry, word)
                log.latest = log.latest or fault
                if len(log.reported) < _MAX_REPORTED_FAULTS:
                    log.reported.append(fault)
            if world.options.on_fault == "quarantine":
                population.quarantined[rows] = True


def _register_word(register: str) -> str:
    """Return the author's name for a register: a vector without its axis, a temp of the plan by its purpose."""
    name = register.removesuffix(".x").removesuffix(".y").removesuffix(".z")
    return {"~steer": "steer", "~gaze": "face", "~face": "face", "~left": "push", "~held": "the vector"}.get(name, name)


def _make_fault(world: World, population: Population, row: int, entry: FaultEntry, word: str) -> Fault:
    operands = fault_operands(world, population, row, entry.block, entry.register, entry.span)
    return Fault(world.display_frame, population.name, int(population.ids[row]), word, entry.span, operands)
