"""Simulates some agents of a cache again, among all others as its edits leave them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from antdsl.explain.history import CacheHistory, open_shot
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.frame_maker import FrameMaker
from antdsl.outputs.cache_bodies import find_body_numbers
from antdsl.outputs.edits.edited_cache import EditedCache, find_next_ids
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY, FrameRows, keep_rows
from antdsl.outputs.edits.settled_layer import SettledFrames, SettledLayer
from antdsl.pipeline import Shot
from antdsl.runtime import World, state_hash, step
from antdsl.runtime.moving.contacts.contact_solver import record_stances, resolve_contacts
from antdsl.runtime.world import AXES
from antdsl.settling.affected import find_affected
from antdsl.settling.scripted_agents import Ids, hold_against_pushes, place_scripted_agents

_MAX_SETTLING_ROUNDS = 3
_REACTION_LEAD_SECONDS = 0.5  # before it is affected, an agent begins to react
_START_ROUNDS, _START_SECONDS = 8, 0.25  # of contacts that separate agents in the first frame of a cache


@dataclass(frozen=True, slots=True, eq=False)
class Settlement:
    """The agents that were simulated again. `checkpoint_frame`: the frame of the checkpoint from which they were simulated.

    `left_out_count`: the number of affected agents that the shot does not have."""

    frames: SettledFrames
    checkpoint_frame: int
    left_out_count: int


class SettlingError(Exception):
    """Error if agents cannot be simulated again. The message is complete without context. `help`: what to do."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


def settle_cache(
    cache: EditedCache, scene: Path | None = None, grants: Mapping[str, Path] | None = None, threads: int = 1
) -> Settlement | None:
    """Return the frames of the agents that the edits of a cache affect; None if there are none.

    Raises SettlingError, or ExplainError if the shot of the cache is not found or has changed."""
    affected = find_affected(cache)
    if not affected:
        return None
    shot = _open_shot(cache, scene, grants)
    settlement, rounds = _settle_agents(cache, shot, affected, threads), 1
    while rounds < _MAX_SETTLING_ROUNDS:  # settled agents may walk into others
        view = EditedCache(cache.folder, cache.manifest, SettledLayer.of(cache, settlement.frames), 3, cache.original)
        added = {key: first for key, first in find_affected(view, includes_touched=False).items() if key not in affected}
        if not added:
            break
        affected |= added
        settlement, rounds = _settle_agents(cache, shot, affected, threads), rounds + 1
    return settlement


def _open_shot(cache: EditedCache, scene: Path | None, grants: Mapping[str, Path] | None) -> Shot:
    """Return the shot of a cache with checkpoints. Raises SettlingError or ExplainError."""
    if not cache.original.checkpoints():
        raise SettlingError(
            f"`{cache.folder}` has no checkpoints, from which agents can be simulated again",
            "run the scene again, then edit and settle its cache: caches that `antdsl edit --to` wrote have none",
        )
    return open_shot(cache.original, scene, grants, "settling")


def _settle_agents(cache: EditedCache, shot: Shot, affected: dict[int, int], threads: int) -> Settlement:
    """Simulate affected agents again, from the nearest checkpoint."""
    chosen = _choose_agents(cache, shot, affected)
    if not chosen:
        raise SettlingError(
            f"edits affect {len(affected):,} agents, but only agents that they gave another body or species",
            "settle before `replace` and `merge`: write the cache with `--to`, or change their lines",
        )
    lead = round(_REACTION_LEAD_SECONDS / shot.setting.dt)
    begins = {key: max(first - lead, cache.frames()[0]) for key, first in chosen.items()}
    world, point = _restore_world(cache, shot, min(begins.values()), threads)
    return Settlement(_Resimulation(cache, shot, world, begins).run(), point, len(affected) - len(chosen))


def _choose_agents(cache: EditedCache, shot: Shot, affected: dict[int, int]) -> dict[int, int]:
    """Return the affected agents that the shot can simulate.

    They belong to its species and have bodies that edits did not replace."""
    chosen: dict[int, int] = {}
    for number, entry in enumerate(cache.manifest.species):
        keys = np.array([key for key in affected if key % SPECIES_PER_KEY == number], np.int64)
        if not len(keys) or entry.name not in shot.plan.species:
            continue
        ids = keys // SPECIES_PER_KEY
        is_same = find_body_numbers(cache.manifest, number, ids) == find_body_numbers(cache.original.manifest, number, ids)
        chosen |= {key: affected[key] for key in keys[is_same].tolist()}
    return chosen


def _restore_world(cache: EditedCache, shot: Shot, frame: int, threads: int) -> tuple[World, int]:
    """Return a world at a frame, from the nearest good checkpoint, and the frame of that checkpoint."""
    setting = replace(shot.setting, contacts="hard") if shot.setting.contacts == "off" else shot.setting
    hashes = cache.original.read_state_hashes()
    history = CacheHistory(cache.original, replace(shot, setting=setting), threads, hashes, has_feet=True)
    points = reversed([each for each in history.checkpoint_frames() if each <= frame])
    world = next((restored for point in points if (restored := history.restore_world(point)) is not None), None)
    if world is None:
        raise SettlingError(
            f"`{cache.folder}` has no good checkpoint up to frame {frame}", "run the scene again, then edit and settle its cache"
        )
    point = world.frame
    world.setting = shot.setting
    while world.frame < frame:
        step(world)
    if state_hash(world) != hashes.get(frame):
        raise SettlingError(
            f"frame {frame} is computed differently than in `{cache.folder}`",
            "it was written by another version: run the scene again, then edit and settle its cache",
        )
    world.setting = setting
    return world, point


class _Resimulation:
    """A run in which only some agents are free; all others follow the cache.

    `begins`: by agent, the last frame in which the agent is as edits leave it. It is free afterwards."""

    def __init__(self, cache: EditedCache, shot: Shot, world: World, first_frames: dict[int, int]) -> None:
        self.cache, self.world, self.begins = cache, world, first_frames
        self.next_ids = find_next_ids(cache.original)
        output = shot.scene.model.output
        self.maker = FrameMaker(world, shot.program, output.attributes, None, output.events)

    def run(self) -> SettledFrames:
        """Return the frames of the free agents."""
        world, frames, first = self.world, {}, self.cache.frames()[0]
        start = world.frame
        for number in (each for each in self.cache.frames() if each >= start):
            free = self._find_free(number)
            if number > start:
                with hold_against_pushes(world, free):
                    step(world)
            self._place_others(number, free)
            if number == first:
                self.begins = {key: first - 1 if begin == first else begin for key, begin in self.begins.items()}
                free = self._find_free(number)
                self._separate_at_start(number, free)
            rows = self._copy_free_rows(free)
            if len(rows["id"]):
                frames[number] = rows
        return SettledFrames.of(frames, self.begins)

    def _find_free(self, number: int) -> dict[str, Ids]:
        """Return the ids of the agents that are free in the step to a frame, by species."""
        free = [key for key, begin in self.begins.items() if begin < number]
        return {
            entry.name: np.array(sorted(key // SPECIES_PER_KEY for key in free if key % SPECIES_PER_KEY == k), np.int64)
            for k, entry in enumerate(self.cache.manifest.species)
        }

    def _place_others(self, number: int, free_ids: Mapping[str, Ids]) -> None:
        arrays, following = (self.cache.frame(min(each, self.cache.frames()[-1])) for each in (number, number + 1))
        place_scripted_agents(self.world, arrays, following, self.cache.manifest, free_ids, self.next_ids)
        for name, population in self.world.populations.items():
            population.next_id = max(population.next_id, self.next_ids.get(name, 0))

    def _separate_at_start(self, number: int, free_ids: Mapping[str, Ids]) -> None:
        """Separate bodies in the first frame of a cache, without a step."""
        for _ in range(_START_ROUNDS):
            with hold_against_pushes(self.world, free_ids), np.errstate(all="ignore"):
                stances = record_stances(self.world)
                if stances is not None:
                    resolve_contacts(self.world, stances, _START_SECONDS)
            self._place_others(number, free_ids)
        for population in self.world.populations.values():
            for k, axis in enumerate(AXES):
                for registers in (population.now, population.start):
                    registers[f"position.{axis}"][:] = population.position[:, k]

    def _copy_free_rows(self, free_ids: Mapping[str, Ids]) -> Arrays:
        """Return the arrays of the free agents in the world's current frame, as a cache has them."""
        names = [entry.name for entry in self.cache.manifest.species]
        keys = np.concatenate([ids * SPECIES_PER_KEY + names.index(name) for name, ids in free_ids.items()])
        arrays = self.maker.frame(self.world)
        if "species" in self.cache.manifest.attributes:
            own = [names.index(name) for name in sorted(self.world.populations)]
            known = arrays.get("species", np.zeros(len(arrays["id"]), np.int16))
            arrays["species"] = np.array(own, np.int16)[known]
        frame = keep_rows(arrays, self.cache.manifest, lambda agent_keys: np.isin(agent_keys, keys))
        return {name: frame[name] for name, _ in FrameRows(frame, self.cache.manifest).iterate_agent_arrays()}
