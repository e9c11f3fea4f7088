"""Replays of past steps. A world is restored from the nearest checkpoint and simulated up to a frame. Agents are traced in the
last step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from antdsl import plan
from antdsl.explain.history import History
from antdsl.explain.tracing import AgentTrace, list_noted_nodes, trace_agent
from antdsl.passes.hoist import hoist_factors
from antdsl.plan.ir import Plan, PlanNode
from antdsl.plan.lowering.source_map import SourceNotes
from antdsl.runtime import FaultStop, Population, World, state_hash, step
from antdsl.runtime.moving.scripted_walks import find_scripted_agents
from antdsl.runtime.phases import PHASES
from antdsl.scene.checks.scene_checks import resolve_layer_order

T = TypeVar("T")
_TRACED_PHASE = "effects"  # in this phase every block has run, and its inputs are unchanged


TraceReader = Callable[[World, Population, AgentTrace], T]


@dataclass(frozen=True, slots=True, eq=False)
class ReplayedStep(Generic[T]):
    """The result of replaying a step.

    - `results`: for each requested agent, the result of `read_trace`; None if the agent was dead at the start or in quarantine.
    - `end_world`: the world at the end of the step, valid until the next step changes it. `hash`: its state hash.
    - `checkpoint`: the frame from which the run was simulated again."""

    results: tuple[T | None, ...]
    end_world: World
    hash: str
    checkpoint: int


class StepReplay:
    """An object that replays the steps of a run. If frames are requested in ascending order, each is simulated only once.

    Raises ExplainError if a checkpoint is missing, or if a state differs from the known state of the run."""

    def __init__(self, history: History) -> None:
        self.history, self.shot = history, history.shot
        self._world: World | None = None
        self._checkpoint = 0
        self.notes: dict[str, SourceNotes] = {}
        self.replacement_by_node: dict[PlanNode, PlanNode] = {}  # noted nodes, and their replacements in the plan
        self.plan = self._build_annotated_plan()

    def _build_annotated_plan(self) -> Plan:
        """Return the plan of the program, with notes that link its nodes to the program text.

        Of the passes, only the one that changes rounding is applied. So all blocks give the same bits as in the run."""
        scene, program = self.shot.scene, self.shot.program
        orders = {
            name: order for name in scene.model.layers if (order := resolve_layer_order(scene, program, name)[0]) is not None
        }
        begun_with, proportions = self.shot.setting.initial_attributes, self.shot.proportions
        noted = plan.lower(
            program, orders=orders, notes=self.notes, scene_attributes=begun_with, proportions=proportions,
            period=self.shot.plan.period,
        )[0]  # fmt: skip
        self.replacement_by_node = {node: node for notes in self.notes.values() for node in list_noted_nodes(notes)}
        return hoist_factors(noted, self.replacement_by_node)

    def restore_step_start(self, frame: int) -> World:
        """Return the world at the start of the step that leads to `frame`. This is the world at the end of the previous frame."""
        world = self._world
        if world is None or not self._checkpoint <= world.frame <= frame - 1 or self._has_nearer_checkpoint(world.frame, frame):
            world = self._restore_checkpoint(frame - 1)
        while world.frame < frame - 1:
            self.history.apply_interventions(world)
            with suppress(FaultStop):  # the original run also continued after the fault
                step(world)
        self._require_known_hash(world)
        self._world = world
        return world

    def replay_step(self, frame: int, agents: Sequence[tuple[str, int]], read_trace: TraceReader[T]) -> ReplayedStep[T]:
        """Replay the step that leads to `frame` and trace the given agents (species, id).

        `read_trace`: called with the trace of each agent. At this time, all other agents, items and fields are still in their
        state at the start of the step."""
        world = self.restore_step_start(frame)
        self.history.apply_interventions(world)
        self._world = None  # until the step is complete
        results: tuple[T | None, ...] = ()
        for name, phase in PHASES:
            if name == _TRACED_PHASE:
                results = tuple(self._read_trace(world, species, agent, read_trace) for species, agent in agents)
            phase(world)
        self._world = world
        return ReplayedStep(results, world, self._require_known_hash(world), self._checkpoint)

    def _read_trace(self, world: World, species: str, agent: int, read_trace: TraceReader[T]) -> T | None:
        population = world.populations[species]
        row = int(population.find_rows(np.array([agent]))[0])
        if row < 0 or population.quarantined[row] or find_scripted_agents(world, population)[row]:
            return None
        return read_trace(
            world,
            population,
            trace_agent(world, population, self.plan.species[species], row, self.notes[species], self.replacement_by_node),
        )

    def _has_nearer_checkpoint(self, start_frame: int, frame: int) -> bool:
        return any(start_frame < point < frame for point in self.history.checkpoint_frames())

    def _restore_checkpoint(self, frame: int) -> World:
        """Return a world with the state of the last checkpoint at or before `frame` that is not damaged."""
        for point in reversed([point for point in self.history.checkpoint_frames() if point <= frame]):
            world = self.history.restore_world(point)
            if world is not None:
                self._checkpoint = point
                return world
        raise self.history.make_missing_error(frame)

    def _require_known_hash(self, world: World) -> str:
        """Return the state hash of the world. Raises ExplainError if the history has a different hash for this frame."""
        world_hash = state_hash(world)
        if self.history.find_hash(world.frame) not in (None, world_hash):
            self._world = None
            raise self.history.make_difference_error(world.frame)
        return world_hash
