"""Prevents agents with steps longer than a body from passing through each other (continuous collision detection).

After all agents have walked, pairs are listed by their distance at the end. That list does not contain bodies that met during
the step and separated again. This module finds such bodies on the straight lines between start and end. From the impact on,
such a body continues along the other body. Then changed paths are shortened until no two bodies collide on these lines. Agents
with short steps cannot pass each other, so a step without long ones costs one loop over all agents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.numerics.sorting import invert_order, sort_stably
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, NearbyCapsulePairs
from antdsl.runtime.moving.contacts.impacts import (
    CapsulePaths,
    PathEncounters,
    PathPairSearch,
    fill_paths,
    flag_long_steps,
    list_path_pairs,
)
from antdsl.runtime.moving.contacts.step_clamping import ClampBuffers, compute_rounding_constant
from antdsl.runtime.moving.correction_walks import CorrectionWalker, write_approach
from antdsl.runtime.moving.stopping import deflect_paths_at_impacts, find_next_impacts, list_corrections, shorten_paths
from antdsl.runtime.world import World
from antdsl.senses.touching import iterate_neighbour_searches

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

_FIRST_PAIRS_PER_AGENT = 2  # initial capacity for pairs
_FULL_MOTION_PASSES = 16  # the first passes use only impacts that are the first of both agents
_MAX_PASSES = 64  # after these passes, agents that still meet others do not move


@dataclass(frozen=True, slots=True, eq=False)
class StartPositions:
    """Positions (n, 3) mm and ground normals (n, 3) of agents at the start of a substep, by species."""

    positions: Mapping[str, Floats]
    normals: Mapping[str, NDArray[np.float32]]


def find_long_steps(crowd: CapsuleCrowd, start_positions: StartPositions) -> NDArray[np.int64] | None:
    """Return which agents of a crowd have long steps, as flags (n); None if no agent has one."""
    flags, total = np.empty(len(crowd), np.int64), 0
    for population, first in zip(crowd.species, crowd.first.tolist(), strict=False):
        start = start_positions.positions[population.name]
        total += flag_long_steps(population.position, start, crowd.half, crowd.radius, first, flags)
    return flags if total else None


def stop_long_steps_at_impacts(
    world: World,
    start_positions: StartPositions,
    long_flags: NDArray[np.int64],
    nearby_pairs: NearbyCapsulePairs,
    own_corrections: Floats,
    dt: float,
) -> bool:
    """Stop agents that would pass through others in a substep of `dt` s. Return whether there was such an agent. `long_flags`
    (n): whether each agent's step is long. `nearby_pairs`: pairs that are near each other at the end. `own_corrections` (3, k)
    mm: the corrections that contacts have made to the steps of agents in these pairs. If any agent is stopped, this function
    also applies these corrections."""
    crowd = CapsuleCrowd(world)
    paths, rank = _fill_paths(crowd, start_positions), invert_order(sort_stably(crowd.agent_keys)).astype(np.int64)
    walked = paths.displacement.copy()
    paths.displacement[:, nearby_pairs.rows] += own_corrections
    hits = _drop_nearby_pairs(_list_path_encounters(paths, rank, long_flags, True), nearby_pairs, rank)
    if not len(hits.first_rows):
        return False
    touched = _deflect_paths(crowd, paths, hits, dt)
    _shorten_paths(paths, _list_path_encounters(paths, rank, long_flags | touched, False), touched)
    moved, corrections = np.empty(len(crowd), np.int64), np.empty_like(walked)
    size = list_corrections(paths.displacement, walked, moved, corrections)
    CorrectionWalker(crowd, start_positions.positions, dt).walk_corrections(moved[:size], corrections[:, :size])
    return True


def _drop_nearby_pairs(
    encounters: PathEncounters, nearby_pairs: NearbyCapsulePairs, rank_by_row: NDArray[np.int64]
) -> PathEncounters:
    """Return the pairs that collide on their paths, without the pairs that are near each other at the end and so are in
    `nearby_pairs`."""
    known = (
        rank_by_row[nearby_pairs.rows.take(nearby_pairs.first_indices)] * len(rank_by_row)
        + rank_by_row[nearby_pairs.rows.take(nearby_pairs.second_indices)]
    )
    others = np.flatnonzero(
        ~np.isin(rank_by_row[encounters.first_rows] * len(rank_by_row) + rank_by_row[encounters.second_rows], known)
    )
    return PathEncounters(
        encounters.first_rows.take(others),
        encounters.second_rows.take(others),
        encounters.meeting_time.take(others),
        encounters.separation_axis.take(others, axis=1),
    )


def _fill_paths(crowd: CapsuleCrowd, start_positions: StartPositions) -> CapsulePaths:
    """Return the capsules and straight paths of all agents in this substep."""
    (displacement, ahead, up), (sag, mass) = np.empty((3, 3, len(crowd))), np.empty((2, len(crowd)))
    paths = CapsulePaths(crowd.middle.copy(), displacement, ahead, up, crowd.half, crowd.radius, sag, mass)
    for population, first in zip(crowd.species, crowd.first.tolist(), strict=False):
        now, name = population.now, population.name
        axes = (vec.get_vector_registers(now, "heading"), vec.get_vector_registers(now, "up"))
        fill_paths(
            population.position, start_positions.positions[name], start_positions.normals[name], *axes, now["mass"], first, paths
        )
    return paths


def _list_path_encounters(
    paths: CapsulePaths, rank_by_row: NDArray[np.int64], active_rows: NDArray[np.int64], only_impacts: bool
) -> PathEncounters:
    """Return the pairs of agents that have near paths and at least one active agent. The arguments are those of
    `impacts.list_path_pairs`."""
    middle = paths.middle + paths.displacement / 2
    reach = np.sqrt(vec.dot(paths.displacement, paths.displacement)) / 2 + paths.half_length + paths.radius + paths.path_sag
    searches = [PathPairSearch(*search) for search in iterate_neighbour_searches((middle[0], middle[1], middle[2]), reach)]
    space = _FIRST_PAIRS_PER_AGENT * len(rank_by_row)
    while True:
        (i, j), used = np.empty((2, space), np.int64), 0
        pairs = PathEncounters(i, j, np.empty(space), np.empty((3, space)))
        for search in searches:
            used = list_path_pairs(search, paths, rank_by_row, active_rows, only_impacts, used, pairs)
            if used < 0:
                break
        if used >= 0:
            order = sort_stably(rank_by_row[i[:used]] * len(rank_by_row) + rank_by_row[j[:used]])
            return PathEncounters(
                i.take(order), j.take(order), pairs.meeting_time.take(order), pairs.separation_axis.take(order, axis=1)
            )
        space *= 4


def _deflect_paths(crowd: CapsuleCrowd, paths: CapsulePaths, encounters: PathEncounters, dt: float) -> Flags:
    """Deflect paths along the bodies that they hit. Return which rows (n) hit another body."""
    n, m, approach = len(crowd), len(encounters.first_rows), np.empty((3, len(crowd)))
    for population, first in zip(crowd.species, crowd.first.tolist(), strict=False):
        write_approach(np.arange(len(population)), first, vec.get_vector_registers(population.start, "velocity"), dt, approach)
    (cut, sums), part, changed = np.empty((2, 3, n)), np.empty(n), np.empty(n, np.bool_)
    meeting_counts, bent_rows, stopped = np.empty((3, n), np.int64)
    buffers = ClampBuffers(np.empty((2, m)), sums, part, meeting_counts, bent_rows, np.empty(m, np.int64))
    deflect_paths_at_impacts(
        encounters, paths, approach, compute_rounding_constant(paths.displacement), buffers, cut, stopped, changed
    )
    paths.displacement[:] += cut
    changed[encounters.first_rows], changed[encounters.second_rows] = True, True
    return changed


def _shorten_paths(paths: CapsulePaths, pairs: PathEncounters, touched_flags: Flags) -> None:
    """Shorten paths until no agent that is flagged in `touched_flags` (n) collides with another. An agent with a shortened path
    is then flagged as well."""
    latest, first, factor = touched_flags.copy(), *np.empty((2, len(touched_flags)))
    for turn in count():
        if not find_next_impacts(pairs, paths, touched_flags, latest, first):
            return
        shorten_paths(pairs, paths, first, turn < _FULL_MOTION_PASSES, turn >= _MAX_PASSES, factor, touched_flags, latest)
