"""Simulates the affected agents of an edited cache again, while all other agents follow the edited cache."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from antdsl.explain.history import CacheHistory, History, open_shot
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.frame_maker import FrameMaker
from antdsl.outputs.cache_bodies import find_body_numbers
from antdsl.outputs.edits.edited_cache import EditedCache, find_next_ids
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY, FrameRows, keep_rows
from antdsl.outputs.edits.settled_layer import SettledFrames, SettledLayer
from antdsl.pipeline import Shot
from antdsl.runtime import FaultStop, LimitStop, World, state_hash, step
from antdsl.runtime.moving.contacts.contact_solver import record_stances, resolve_contacts
from antdsl.runtime.world import AXES
from antdsl.settling.affected import find_affected_agents_by_frame
from antdsl.settling.scripted_agents import Ids, increase_mass_of_scripted_agents, place_scripted_agents

_MAX_SETTLING_ROUNDS = 3
_REACTION_LEAD_SECONDS = 0.5  # before it is affected, an agent begins to react
NOTHING_TO_SETTLE = "nothing to settle: after the edits, no agents overlap, and none has lost a neighbour"
_START_SEPARATION_ROUNDS, _START_SEPARATION_SECONDS = 8, 0.25  # of contacts that separate agents in the first frame of a cache


@dataclass(frozen=True, slots=True, eq=False)
class SettlingResult:
    """The agents that were simulated again. `checkpoint_frame`: the frame of the checkpoint from which they were simulated.

    `left_out_count`: the number of affected agents that could not be simulated because they are not in the shot."""

    frames: SettledFrames
    checkpoint_frame: int
    left_out_count: int

    def describe_result(self) -> str:
        """Return a text for the user that states the number of agents, their frames, and the checkpoint."""
        others = (
            f"; {self.left_out_count:,} other agents stay unchanged, because an edit changed their body or species"
            if self.left_out_count
            else ""
        )
        return f"settled {self.frames.describe_agents()}, from the checkpoint of frame {self.checkpoint_frame}{others}"


class SettlingError(Exception):
    """Error raised if agents cannot be simulated again. The message is complete; `help` states what the user can do."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


def settle_cache(
    cache: EditedCache, scene: Path | None = None, grants: Mapping[str, Path] | None = None, threads: int = 1
) -> SettlingResult | None:
    """Simulate the agents that the edits of a cache affect, and return their new frames; None if there are no such agents.

    Raises SettlingError, or ExplainError if the shot of the cache is not found or has changed."""
    settling = EditSettling(cache, lambda _: _open_history(cache, scene, grants, threads), find_next_ids(cache.original))
    for _ in settling.run_rounds():
        pass
    return settling.settlement


def _open_history(cache: EditedCache, scene: Path | None, grants: Mapping[str, Path] | None, threads: int) -> CacheHistory:
    """Return the history of a cache with checkpoints. Raises SettlingError or ExplainError."""
    if not cache.original.checkpoints():
        raise SettlingError(
            f"`{cache.folder}` has no checkpoints, but settling starts from a checkpoint",
            "settle the cache of a run instead: caches from `antdsl edit --to` have no checkpoints",
        )
    shot = open_shot(cache.original, scene, grants, "settling")
    return CacheHistory(cache.original, shot, threads, cache.original.read_state_hashes(), has_feet=True)


class EditSettling:
    """A new simulation of the agents that the edits of a cache affect. `run_rounds` is a generator, so that callers can do
    other work between frames.

    - `open_history`: returns the history of the cache for the first frame that is simulated again
    - `next_ids`: for each species, the first id that no agent of the run uses
    - `attributes`: the names of the agent arrays in frames, by default those of the scene's output
    - `settlement`: the result; None until `run_rounds` has ended, or if edits affect no agent"""

    def __init__(
        self,
        cache: EditedCache,
        open_history: Callable[[int], History],
        next_ids: Mapping[str, int],
        attributes: tuple[str, ...] = (),
    ) -> None:
        self.cache, self.next_ids, self.attributes = cache, next_ids, attributes
        self.settlement: SettlingResult | None = None
        self._open_history = open_history

    def run_rounds(self) -> Iterator[str]:
        """Settle the cache.

        Yield a text about the progress after each frame. Raises SettlingError and the errors of `open_history`."""
        affected: dict[int, int] = {}
        yield from self._find_affected(self.cache, affected, includes_touched=True)
        if not affected:
            return
        history = self._open_history(min(affected.values()))
        settlement = yield from self._settle_agents(history, affected)
        for _ in range(_MAX_SETTLING_ROUNDS - 1):  # settled agents may walk into others
            layer = SettledLayer.of(self.cache, settlement.frames)
            view, all_affected = (
                EditedCache(self.cache.folder, self.cache.manifest, layer, 3, self.cache.original),
                dict(affected),
            )
            yield from self._find_affected(view, all_affected, includes_touched=False)
            if len(all_affected) == len(affected):
                break
            affected = all_affected
            settlement = yield from self._settle_agents(history, affected)
        self.settlement = settlement

    def _find_affected(self, cache: EditedCache, affected: dict[int, int], *, includes_touched: bool) -> Iterator[str]:
        """Add affected agents to `affected`, which maps the key of an agent to the first frame in which it is affected. Yield
        texts about the progress."""
        for number, keys in find_affected_agents_by_frame(cache, includes_touched=includes_touched):
            for key in keys:
                affected.setdefault(key, number)
            yield f"frame {number} is examined"

    def _settle_agents(self, history: History, affected: dict[int, int]) -> Generator[str, None, SettlingResult]:
        """Simulate affected agents again, from the nearest checkpoint."""
        cache, shot = self.cache, history.shot
        chosen = _choose_agents(cache, shot, affected)
        if not chosen:
            raise SettlingError(
                f"the {len(affected):,} affected agents cannot be settled: edits changed the body or species of each",
                "settle before you apply `replace` and `merge`: write the cache with `--to`, or change these edits",
            )
        lead = round(_REACTION_LEAD_SECONDS / shot.setting.dt)
        start, earliest = cache.frames()[0], min(history.checkpoint_frames(), default=0)
        begins = {key: max(first - lead, min(first, earliest), start) for key, first in chosen.items()}
        world, point = _restore_world(history, min(begins.values()))
        attributes = self.attributes or shot.scene.model.output.attributes
        resimulation = _Resimulation(cache, history, world, begins, self.next_ids, attributes)
        yield from resimulation.simulate_frames()
        return SettlingResult(SettledFrames.of(resimulation.frames, resimulation.begins), point, len(affected) - len(chosen))


def _choose_agents(cache: EditedCache, shot: Shot, affected: dict[int, int]) -> dict[int, int]:
    """Return the affected agents that the shot can simulate.

    They belong to species of the shot, and edits did not replace their bodies."""
    chosen: dict[int, int] = {}
    for number, entry in enumerate(cache.manifest.species):
        keys = np.array([key for key in affected if key % SPECIES_PER_KEY == number], np.int64)
        if not len(keys) or entry.name not in shot.plan.species:
            continue
        ids = keys // SPECIES_PER_KEY
        is_same = find_body_numbers(cache.manifest, number, ids) == find_body_numbers(cache.original.manifest, number, ids)
        chosen |= {key: affected[key] for key in keys[is_same].tolist()}
    return chosen


def _restore_world(history: History, frame: int) -> tuple[World, int]:
    """Return a world at `frame` in which contacts are on. Also return the frame of the checkpoint from which the world was
    simulated.

    Raises ExplainError if no valid checkpoint leads to this frame."""
    points = reversed([each for each in history.checkpoint_frames() if each <= frame])
    world = next((restored for point in points if (restored := history.restore_world(point)) is not None), None)
    if world is None:
        raise history.make_missing_error(frame)
    point = world.frame
    while world.frame < frame:
        _step(history, world)
    if history.find_hash(frame) not in (None, state_hash(world)):
        raise history.make_difference_error(frame)
    if world.setting.contacts == "off":
        world.setting = replace(world.setting, contacts="hard")
    return world, point


def _step(history: History, world: World) -> None:
    """Advance a world by one frame. Agents with faults do not change. Raises SettlingError if the limits stop the world."""
    history.apply_interventions(world)
    try:
        step(world)
    except LimitStop as stop:
        why = f"frame {world.frame + 1} cannot be simulated again: {stop.fault.brief_text}"
        raise SettlingError(why, "remove the agents that cause this with an edit, such as `kill`") from None
    except FaultStop:
        pass  # the run continued after the fault


class _Resimulation:
    """A run in which only some agents are simulated freely; all others follow the cache.

    `begins`: for each agent, the last frame in which it follows the edits; from the next frame on, it is free. `frames`: the
    arrays of the free agents, by frame."""

    def __init__(
        self,
        cache: EditedCache,
        history: History,
        world: World,
        first_frames: dict[int, int],
        next_ids: Mapping[str, int],
        attributes: tuple[str, ...],
    ) -> None:
        self.cache, self.history, self.world, self.begins = cache, history, world, first_frames
        self.next_ids, self.frames = next_ids, dict[int, Arrays]()
        self.maker = FrameMaker(world, history.shot.program, attributes, None, history.shot.scene.model.output.events)

    def simulate_frames(self) -> Iterator[str]:
        """Simulate all frames. Yield a progress text after each frame."""
        world, first = self.world, self.cache.frames()[0]
        start = world.frame
        for number in (each for each in self.cache.frames() if each >= start):
            free = self._find_free(number)
            if number > start:
                with increase_mass_of_scripted_agents(world, free):
                    _step(self.history, world)
            self._place_others(number, free)
            if number == first:
                self.begins = {key: first - 1 if begin == first else begin for key, begin in self.begins.items()}
                free = self._find_free(number)
                self._separate_at_start(number, free)
            rows = self._copy_free_rows(free)
            if len(rows["id"]):
                self.frames[number] = rows
            yield f"frame {number} is simulated again"

    def _find_free(self, number: int) -> dict[str, Ids]:
        """Return, by species, the ids of the agents that are simulated freely in the step that leads to frame `number`."""
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
        """Separate overlapping bodies in the first frame of a cache directly, because no step leads to this frame."""
        for _ in range(_START_SEPARATION_ROUNDS):
            with increase_mass_of_scripted_agents(self.world, free_ids), np.errstate(all="ignore"):
                stances = record_stances(self.world)
                if stances is not None:
                    resolve_contacts(self.world, stances, _START_SEPARATION_SECONDS)
            self._place_others(number, free_ids)
        for population in self.world.populations.values():
            for k, axis in enumerate(AXES):
                for registers in (population.now, population.start):
                    registers[f"position.{axis}"][:] = population.position[:, k]

    def _copy_free_rows(self, free_ids: Mapping[str, Ids]) -> Arrays:
        """Return the arrays of the free agents in the world's current frame, in the format of a cache."""
        names = [entry.name for entry in self.cache.manifest.species]
        keys = np.concatenate([ids * SPECIES_PER_KEY + names.index(name) for name, ids in free_ids.items()])
        arrays = self.maker.frame(self.world)
        if "species" in self.cache.manifest.attributes:
            own = [names.index(name) for name in sorted(self.world.populations)]
            known = arrays.get("species", np.zeros(len(arrays["id"]), np.int16))
            arrays["species"] = np.array(own, np.int16)[known]
        frame = keep_rows(arrays, self.cache.manifest, lambda agent_keys: np.isin(agent_keys, keys))
        return {name: frame[name] for name, _ in FrameRows(frame, self.cache.manifest).iterate_agent_arrays()}
