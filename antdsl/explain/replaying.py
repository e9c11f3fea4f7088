"""Old steps again: a world from the nearest checkpoint, stepped to a frame, with some agents traced in the last step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from antdsl import plan
from antdsl.explain.opening import ExplainError
from antdsl.explain.tracing import Trace, of_notes, traced
from antdsl.outputs.cache import Cache
from antdsl.outputs.cache_writer import read_checkpoint
from antdsl.passes.hoist import hoist
from antdsl.pipeline import Shot
from antdsl.plan.ir import Node, Plan
from antdsl.plan.noting import Notes
from antdsl.runtime import CheckpointError, Options, Population, World, bind, restore, state_hash, step
from antdsl.runtime.phases import PHASES
from antdsl.scene.matching import layer_order

T = TypeVar("T")
_TRACED_BEFORE = "effects"  # every block has run, and nothing that it read has changed


Look = Callable[[World, Population, Trace], T]


@dataclass(frozen=True, slots=True, eq=False)
class Step(Generic[T]):
    """A step that was done again. `seen`: what was made of each agent's trace, None for who did not live when it began or was
    set aside after a fault. `after` and `hash`: the world as it ended; it goes on with the next step. `checkpoint`: the frame
    that it was continued from."""

    seen: tuple[T | None, ...]
    after: World
    hash: str
    checkpoint: int


class Replay:
    """The run of a cache, to be done again from where one asks. Frames asked for in order are stepped through once.

    Raises ExplainError where a checkpoint is missing or a state differs from the one that the cache has a hash of."""

    def __init__(self, cache: Cache, shot: Shot, threads: int = 1) -> None:
        self.cache, self.shot = cache, shot
        self._options = Options(threads=threads, on_fault="quarantine")
        self._hashes = cache.hashes()
        self._world: World | None = None
        self._checkpoint = 0
        self.notes: dict[str, Notes] = {}
        self.became: dict[Node, Node] = {}  # noted nodes, and what stands for them in the plan
        self.plan = self._noted()

    def _noted(self) -> Plan:
        """The plan with notes, after the one pass that moves last bits: its blocks give the same bits as the plan that runs."""
        scene, program = self.shot.scene, self.shot.program
        orders = {name: order for name in scene.model.layers if (order := layer_order(scene, program, name)[0]) is not None}
        noted = plan.lower(program, orders=orders, notes=self.notes)[0]
        self.became = {node: node for notes in self.notes.values() for node in of_notes(notes)}
        return hoist(noted, self.became)

    def begin(self, frame: int) -> World:
        """The world as the step to a frame begins: at the frame before."""
        world = self._world
        if world is None or not self._checkpoint <= world.frame <= frame - 1 or self._nearer(world.frame, frame):
            world = self._restored(frame - 1)
        while world.frame < frame - 1:
            step(world)
        self._same(world)
        self._world = world
        return world

    def step(self, frame: int, agents: Sequence[tuple[str, int]], look: Look[T]) -> Step[T]:
        """The step to a frame, with agents by species and id. `look` sees each one's trace while others, items and fields are
        still as they were when the step began."""
        world = self.begin(frame)
        seen: tuple[T | None, ...] = ()
        for name, phase in PHASES:
            if name == _TRACED_BEFORE:
                seen = tuple(self._look(world, species, agent, look) for species, agent in agents)
            phase(world)
        return Step(seen, world, self._same(world), self._checkpoint)

    def _look(self, world: World, species: str, agent: int, look: Look[T]) -> T | None:
        population = world.populations[species]
        row = int(population.rows_of(np.array([agent]))[0])
        if row < 0 or population.quarantined[row]:
            return None
        return look(
            world, population, traced(world, population, self.plan.species[species], row, self.notes[species], self.became)
        )

    def _nearer(self, here: int, frame: int) -> bool:
        return any(here < point < frame for point in self.cache.checkpoints())

    def _restored(self, frame: int) -> World:
        """A world at the last good checkpoint that is not after a frame."""
        points = [point for point in self.cache.checkpoints() if point <= frame]
        for point in reversed(points):
            arrays = read_checkpoint(self.cache, point)
            if arrays is None:
                continue
            world = bind(self.shot.plan, self.shot.setting, self._options)
            try:
                restore(world, arrays)
            except CheckpointError:
                continue
            if state_hash(world) == self._hashes.get(point):
                self._checkpoint = point
                return world
        what = "no good checkpoint" if points else "no checkpoint"
        raise ExplainError(
            f"`{self.cache.folder}` has {what} up to frame {frame}", "run the scene again: each run writes checkpoints"
        )

    def _same(self, world: World) -> str:
        """The hash of the state, which is the one that the cache has."""
        found = state_hash(world)
        if found != self._hashes.get(world.frame, found):
            self._world = None
            raise ExplainError(
                f"frame {world.frame} comes out otherwise than `{self.cache.folder}` has it",
                "it was written by another version, or by `antdsl test` with a spec's own settings: run the scene again",
            )
        return found
