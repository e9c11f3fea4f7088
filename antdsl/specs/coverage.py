"""Coverage: a record of the states that agents were in and the transitions that they took, over all runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from antdsl.program.model import Machine, Program
from antdsl.runtime.world import World
from antdsl.source import Span

CoverageKey = tuple[str, int, str]  # source, offset in it, name


@dataclass(slots=True)
class CoverageEntry:
    """A state or a transition, and how often it occurred.

    `name`: the qualified name, such as `forager.main.search` for a state, or `forager.main.search->approach#1` for a transition.
    `count`: for a state, the number of agents in it, summed over all frames; for a transition, how many times agents took it."""

    name: str
    span: Span
    count: int = 0


@dataclass(frozen=True, slots=True)
class _MachineCoverageTable:
    """The coverage entries of one machine's states and transitions, in the order of their numbers in the plan.

    `claim_changes`: the numbers of the transitions that depend on a claim."""

    species: str
    name: str
    states: tuple[CoverageEntry, ...]
    changes: tuple[CoverageEntry, ...]
    claim_changes: tuple[int, ...]


@dataclass(slots=True)
class SpecCoverage:
    """A record of the states and transitions that occurred in any run."""

    states: dict[CoverageKey, CoverageEntry] = field(default_factory=dict)
    changes: dict[CoverageKey, CoverageEntry] = field(default_factory=dict)

    @property
    def covered_share(self) -> float:
        """Return the fraction of all states and transitions that occurred, from 0 to 1. Return 1 if there are none."""
        all = [*self.states.values(), *self.changes.values()]
        return sum(each.count > 0 for each in all) / len(all) if all else 1.0

    def watch_world(self, world: World, program: Program) -> None:
        """Start to count for a world, from the current frame on: the states of its agents, and the transitions in its later
        steps."""
        machines = [self._make_machine_coverage(s.name, m) for s in program.species.values() for m in s.machines]
        for machine in machines:
            states = world.populations[machine.species].now.get(f"{machine.name}.state")
            if states is not None:
                _count_states(machine, states)
        world.watchers.append(partial(_count_all_changes, machines=machines))

    def _make_machine_coverage(self, species: str, machine: Machine) -> _MachineCoverageTable:
        """Return the coverage entries of a machine. Missing entries are added with count 0."""
        pairs = [change for state in machine.states for change in state.transitions]
        return _MachineCoverageTable(
            species,
            machine.name,
            tuple(self._get_entry(self.states, f"{species}.{machine.name}.{s.name}", s.span) for s in machine.states),
            tuple(self._get_entry(self.changes, change.key, change.span) for change in pairs),
            tuple(number for number, change in enumerate(pairs, 1) if change.take_action is not None),
        )

    @staticmethod
    def _get_entry(table: dict[CoverageKey, CoverageEntry], name: str, span: Span) -> CoverageEntry:
        return table.setdefault((span.source.path, span.start, name), CoverageEntry(name, span))


def _count_states(machine: _MachineCoverageTable, states: np.ndarray) -> None:
    for state, number in zip(machine.states, np.bincount(states, minlength=len(machine.states)), strict=True):
        state.count += int(number)


def _count_all_changes(world: World, machines: list[_MachineCoverageTable]) -> None:
    for machine in machines:
        _count_changes(world, machine)


def _count_changes(world: World, machine: _MachineCoverageTable) -> None:
    """Count the transitions of a machine that happened in a step. Call this after all agents have acted, but before dead agents
    are removed.

    Transitions are numbered as in `plan.machines`."""
    population = world.populations[machine.species]
    previous_states, next_states = (table.get(f"{machine.name}.state") for table in (population.start, population.now))
    if previous_states is not None and next_states is not None:
        _count_states(
            machine, np.concatenate([next_states, previous_states[previous_states != next_states]])
        )  # newborn agents may have left the state already
    pending, won = (population.now.get(f"~{machine.name}.{word}") for word in ("pending", "won"))
    if pending is None:
        return
    if machine.claim_changes and won is not None:
        pending = np.where(np.isin(pending, machine.claim_changes) & ~won, 0, pending)
    change_counts = np.bincount(pending, minlength=len(machine.changes) + 1)
    for change, number in zip(machine.changes, change_counts[1:], strict=True):
        change.count += int(number)
