"""Events in the frames of a cache, for effects and sound: `events.KIND.FIELD`, one row per event.

Frames have the kinds of events that the scene's `output` requests.

Fields of all kinds:
`species` int16 and `id` int64: the agent.
`P` float32[k, 3]: a position in scene units.
`N` float32[k, 3]: a unit vector.

`emit`: a named event that an agent emits.
`event` int16: the index in the manifest's `events`.
`P`: the agent's position at the start of the step.
`N`: the normal of the agent's ground.

`contact`: two bodies that overlap. `species` and `id` are the agent that is first by species and id.
`other_species` int16 and `other` int64: the second agent.
`depth` float32: the penetration depth in scene units.
`P`: the contact point.
`N`: the direction from the second agent to the first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vectors import dot
from antdsl.outputs.cache.scene_positions import to_scene_positions
from antdsl.program.tables.columns import CONTACT_COLUMNS
from antdsl.runtime import World, collect_emissions
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, NearbyCapsulePairs, find_near_pairs

Arrays = dict[str, NDArray[Any]]


def make_event_arrays(world: World, kinds: tuple[str, ...], scale: float) -> Arrays:
    """Return the arrays of events of the requested `kinds`. `scale`: scene units per millimetre."""
    return {f"events.{kind}.{name}": array for kind in kinds for name, array in EVENT_ARRAY_MAKERS[kind](world, scale).items()}


def _make_emit_arrays(world: World, scale: float) -> Arrays:
    """Return the arrays of the events emitted since the previous frame."""
    emissions = collect_emissions(world)
    return emissions | {"P": to_scene_positions(emissions["P"], scale)}


def _make_contact_arrays(world: World, scale: float) -> Arrays:
    """Return the arrays of overlapping bodies, sorted by species and id."""
    if len(world) < 2:
        return {column.field: np.zeros((0, *column.compute_dimensions()), column.type) for column in CONTACT_COLUMNS}
    crowd = CapsuleCrowd(world)
    near = find_near_pairs(crowd)
    pairs = np.flatnonzero(near.gap < 0)
    i = near.rows[near.first_indices[pairs]]
    j, points = near.rows[near.second_indices[pairs]], _compute_contact_points(near, pairs)
    direction, gap = near.direction[:, pairs], near.gap[pairs]
    ids = crowd.concatenate_species(lambda p: p.ids)
    names = sorted(world.populations)
    species = np.repeat([names.index(p.name) for p in crowd.species], np.diff(crowd.first)).astype(np.int16)
    order = np.lexsort((ids[j], species[j], ids[i], species[i]))
    i, j, points, direction, gap = i[order], j[order], points[:, order], direction[:, order], gap[order]
    return {
        "species": species[i], "id": ids[i], "P": to_scene_positions(points.T, scale),
        "N": direction.T.astype(np.float32), "other_species": species[j], "other": ids[j],
        "depth": (-gap * scale).astype(np.float32),
    }  # fmt: skip


def _compute_contact_points(near_pairs: NearbyCapsulePairs, pairs: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the contact points (3, k) in mm for `pairs`, indices of pairs of capsules.

    A contact point is halfway between the two surfaces, on the shortest line between the axes of the capsules."""
    i, j = near_pairs.first_indices[pairs], near_pairs.second_indices[pairs]
    direction, gap = near_pairs.direction[:, pairs], near_pairs.gap[pairs]
    a, b, ri, rj = near_pairs.axis_directions[:, i], near_pairs.axis_directions[:, j], near_pairs.radius[i], near_pairs.radius[j]
    off = direction * (gap + ri + rj) - (near_pairs.middle[:, i] - near_pairs.middle[:, j])  # t a - s b
    across = dot(a, b)
    free = 1.0 - across * across
    t = np.where(free > 1e-6, (dot(off, a) - across * dot(off, b)) / np.maximum(free, 1e-6), dot(off, a) / 2)
    s = across * t - dot(off, b)
    t = np.clip(t, -near_pairs.half_lengths[i], near_pairs.half_lengths[i])
    s = np.clip(s, -near_pairs.half_lengths[j], near_pairs.half_lengths[j])
    first = near_pairs.middle[:, i] + a * t - direction * (ri + gap / 2)
    second = near_pairs.middle[:, j] + b * s + direction * (rj + gap / 2)
    middle: NDArray[np.float64] = (first + second) / 2
    return middle


EVENT_ARRAY_MAKERS: Mapping[str, Callable[[World, float], Arrays]] = {"emit": _make_emit_arrays, "contact": _make_contact_arrays}
