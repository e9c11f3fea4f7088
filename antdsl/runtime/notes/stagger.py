"""The delay, in frames, of a note for each of its agents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.randomness import draw_uniform
from antdsl.numerics.records import match_ids
from antdsl.runtime.notes.targets import TargetPoints, find_ground_goal
from antdsl.runtime.world import World
from antdsl.scene.notes.notes_model import Note
from antdsl.scene.notes.stagger import Stagger

_STAGGER_RANDOM_SITE = "note.stagger"
_MAX_DELAY = 10**7  # frames: longer than any run
Rows = NDArray[np.intp]
Delays = NDArray[np.int64]


def get_or_compute_delays(
    world: World, note: Note, rows: Mapping[str, Rows], memory: dict[str, NDArray[Any]], key: str = ""
) -> dict[str, Delays]:
    """Return the delay of a note in frames for each of its agents, by species. It is 0 without a `stagger`.

    `memory`: stores the ids and delays (n, 2) of the note's agents, sorted by id, under names with `key`. Stored delays do not
    change. Agents without one get theirs from their position at the start of this step, or wait until the target exists."""
    if note.delay_rule is None:
        return {name: np.zeros(len(own), np.int64) for name, own in rows.items()}
    ids = {name: world.populations[name].ids[own] for name, own in rows.items()}
    known = {name: memory.get(_format_delays_name(key, name), np.empty((0, 2), np.int64)) for name in rows}
    new = {name: np.sort(own[~match_ids(own, known[name][:, 0])[1]]) for name, own in ids.items()}
    if any(map(len, new.values())) and not _has_stagger_target(world, note.delay_rule):
        new = {name: own[:0] for name, own in new.items()}
    delays = _compute_delays(world, note.delay_rule, new, sum(map(len, known.values())))
    result = {}
    for name, own in known.items():
        if len(new[name]):
            own = np.concatenate([own, np.stack([new[name], delays[name]], axis=1)])
            own = own[np.argsort(own[:, 0])]
        memory[_format_delays_name(key, name)] = own
        known_rows, is_known = match_ids(ids[name], own[:, 0])
        result[name] = np.full(len(ids[name]), _MAX_DELAY)
        result[name][is_known] = own[known_rows[is_known], 1]
    return result


def _has_stagger_target(world: World, stagger: Stagger) -> bool:
    """Return whether the origin of a stagger exists in this step. True if the stagger has no origin."""
    if stagger.origin is None:
        return True
    goal = find_ground_goal(world, stagger.origin)
    return not isinstance(goal, TargetPoints) or len(goal.points) > 0


def find_greatest_delay(world: World, key: str, memory: Mapping[str, NDArray[Any]]) -> int:
    """Return the greatest delay, in frames, that is stored for a note. 0 if none is stored."""
    known = (memory.get(_format_delays_name(key, name)) for name in world.populations)
    return max((int(own[:, 1].max(initial=0)) for own in known if own is not None), default=0)


def _format_delays_name(key: str, species: str) -> str:
    return f"{key}.{species}.delays"


def _compute_delays(world: World, stagger: Stagger, ids: Mapping[str, Delays], known_count: int) -> dict[str, Delays]:
    """Return the delays of agents with these ids, by species. `known_count`: the number of agents that already have one."""
    if not ids:
        return {}
    if stagger.random is not None:
        draws = {name: draw_uniform(world.setting.seed, 0, name, _STAGGER_RANDOM_SITE, 0, own) for name, own in ids.items()}
        return {name: np.floor(own.astype(np.float64) * (stagger.random + 1)).astype(np.int64) for name, own in draws.items()}
    distances = {name: _measure_distances(world, stagger, name, own) for name, own in ids.items()}
    if stagger.speed is not None:
        mm_per_frame = stagger.speed.to_base_units(world.setting.unit_mm, world.setting.dt) * world.dt
        return {name: np.rint(np.minimum(own / mm_per_frame, _MAX_DELAY)).astype(np.int64) for name, own in distances.items()}
    assert stagger.each is not None
    names = sorted(ids)
    distance, every_id = (np.concatenate([group[name] for name in names]) for group in (distances, ids))
    species = np.repeat(np.arange(len(names)), [len(ids[name]) for name in names])
    rank = np.empty(len(distance), np.int64)
    rank[np.lexsort((every_id, species, distance))] = np.arange(known_count, known_count + len(distance))
    return {name: np.minimum(rank[species == number] * stagger.each, _MAX_DELAY) for number, name in enumerate(names)}


def _measure_distances(world: World, stagger: Stagger, species: str, ids: Delays) -> NDArray[np.float64]:
    """Return the distance (mm) of each agent from the origin of a stagger. 0 without an origin."""
    if stagger.origin is None or not len(ids):
        return np.zeros(len(ids))
    population = world.populations[species]
    position = population.position[population.find_rows(ids)]
    return np.nan_to_num(find_ground_goal(world, stagger.origin).find_nearest(position)[1])
