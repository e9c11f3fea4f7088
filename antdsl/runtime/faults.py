"""Records faults, which are non-finite values: the agent, the location in the source, and the operands. Also decides whether
the run continues (decision 24). To find the operands, the reference backend repeats the agent's step, because it computes
every intermediate value separately."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from antdsl.runtime.backends.reference import find_fault_operands
from antdsl.runtime.requests import FaultEntry
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.runtime.world import Population, World

_MAX_REPORTED_FAULTS = 20  # faults reported in full; the others are only counted


@dataclass(frozen=True, slots=True)
class Fault:
    """A rejected value of one agent, or of a complete species (`agent` is -1).

    `operands`: for each operand, its source text (or operation) and its value. `reason`: the reason; messages put it after the
    name of the rejected value."""

    frame: int
    species: str
    agent: int
    value_name: str
    span: Span | None
    operands: tuple[tuple[str, str], ...]
    reason: str = "is not finite"

    def __str__(self) -> str:
        return self._describe_fault("" if self.span is None else f"{self.span}: ")

    @property
    def brief_text(self) -> str:
        """Return a description of the fault without the path of the file, which should not leave this machine."""
        if self.span is None:
            return self._describe_fault("")
        line, column = self.span.source.find_line_column(self.span.start)
        return self._describe_fault(f"{PurePath(self.span.source.path).name}:{line}:{column}: ")

    def _describe_fault(self, place: str) -> str:
        values = ", ".join(f"{text} = {value}" for text, value in self.operands)
        subject = self.species if self.agent < 0 else f"{self.species} {self.agent}"
        return f"{place}{subject} at frame {self.frame}: `{self.value_name}` {self.reason}" + (f" ({values})" if values else "")


@dataclass(slots=True)
class FaultLog:
    """The faults of a run: their total number, and details of the first ones. `rejected_births`: the number of births that
    were rejected at the limit of agents. `fault_of_step`: the first fault of the current step."""

    fault_count: int = 0
    rejected_births: int = 0  # births rejected because of `limits.AGENTS`
    reported_faults: list[Fault] = field(default_factory=list)
    fault_of_step: Fault | None = None  # the first fault of the last step


class FaultStop(RuntimeError):
    """Error that stops a run with `on_fault: stop` after a step with a fault. `fault` is the first fault of the step."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(str(fault))
        self.fault = fault


class LimitStop(FaultStop):
    """Error that stops a step which would exceed a limit. The world is unusable afterwards."""


def collect_faults(world: World) -> None:
    """Count the faults since the last call, report the first ones, and quarantine their agents if `on_fault` requires it."""
    log = world.faults
    for population in world.populations.values():
        if not population.effects.faults:
            continue
        groups: dict[tuple[int, str, str], list[FaultEntry]] = {}
        for entry in population.effects.faults:
            place = -1 if entry.span is None else entry.span.start
            groups.setdefault((place, entry.block, _find_register_display_name(entry.register)), []).append(entry)
        population.effects.faults = []
        for (_, _, word), entries in sorted(groups.items(), key=lambda pair: pair[0]):
            # a vector has three components but counts as one fault
            rows = np.unique(np.concatenate([entry.rows for entry in entries]))
            rows = rows[np.argsort(population.ids[rows])]
            log.fault_count += len(rows)
            for row in rows[: max(_MAX_REPORTED_FAULTS - len(log.reported_faults), 0 if log.fault_of_step else 1)]:
                entry = min((e for e in entries if row in e.rows), key=lambda e: e.register)
                fault = _make_fault(world, population, int(row), entry, word)
                log.fault_of_step = log.fault_of_step or fault
                if len(log.reported_faults) < _MAX_REPORTED_FAULTS:
                    log.reported_faults.append(fault)
            if world.options.on_fault == "quarantine":
                population.quarantined[rows] = True


def _find_register_display_name(register: str) -> str:
    """Return the name of a register for messages: a vector without its axis, or the purpose of a temporary register."""
    name = register.removesuffix(".x").removesuffix(".y").removesuffix(".z")
    return {"~steer": "steer", "~gaze": "face", "~face": "face", "~left": "push", "~held": "the vector"}.get(name, name)


def _make_fault(world: World, population: Population, row: int, entry: FaultEntry, word: str) -> Fault:
    operands = find_fault_operands(world, population, row, entry.block, entry.register, entry.span)
    return Fault(world.display_frame, population.name, int(population.ids[row]), word, entry.span, operands)
