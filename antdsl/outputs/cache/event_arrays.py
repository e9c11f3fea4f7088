"""Events in the frames of a cache, for effects and sound: `events.KIND.FIELD`, one row an event, of the kinds that the scene's
`output` requests.

All have the agent's `species` int16 and `id` int64, `P` float32[k, 3] (scene units) and `N` float32[k, 3] (unit).

`emit`: `event` int16, an index into the manifest's `events`; `P` is the agent's position at the start of the step, `N` the normal
of its ground.

`contact`: overlapping bodies. The first of two by species and id has the row, with `other_species` int16, `other` int64 and
`depth` float32 (scene units). `P` is where they meet, `N` the direction from the other to the first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vectors import dot
from antdsl.outputs.cache.places import scene_places
from antdsl.program.tables.columns import CONTACT
from antdsl.runtime import World, take_emissions
from antdsl.runtime.moving.capsules import CapsuleCrowd, NearbyPairs, find_near_pairs

Arrays = dict[str, NDArray[Any]]


def events_of(world: World, kinds: tuple[str, ...], scale: float) -> Arrays:
    """Return the arrays of a frame with the events since the frame before. `scale`: scene units per millimetre."""
    return {f"events.{kind}.{name}": array for kind in kinds for name, array in EVENTS[kind](world, scale).items()}


def _emits(world: World, scale: float) -> Arrays:
    emissions = take_emissions(world)
    return emissions | {"P": scene_places(emissions["P"], scale)}


def _contacts(world: World, scale: float) -> Arrays:
    if len(world) < 2:
        return {column.field: np.zeros((0, *column.dimensions()), column.type) for column in CONTACT}
    crowd = CapsuleCrowd(world)
    near = find_near_pairs(crowd)
    pairs = np.flatnonzero(near.gap < 0)
    i, j, points = near.rows[near.i[pairs]], near.rows[near.j[pairs]], _contact_points(near, pairs)
    direction, gap = near.direction[:, pairs], near.gap[pairs]
    ids = crowd.of(lambda p: p.ids)
    names = sorted(world.populations)
    species = np.repeat([names.index(p.name) for p in crowd.species], np.diff(crowd.first)).astype(np.int16)
    order = np.lexsort((ids[j], species[j], ids[i], species[i]))
    i, j, points, direction, gap = i[order], j[order], points[:, order], direction[:, order], gap[order]
    return {
        "species": species[i], "id": ids[i], "P": scene_places(points.T, scale),
        "N": direction.T.astype(np.float32), "other_species": species[j], "other": ids[j],
        "depth": (-gap * scale).astype(np.float32),
    }  # fmt: skip


def _contact_points(near: NearbyPairs, pairs: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the contact points of two capsules (3, k) mm: midway between their surfaces, on the shortest line between their
    axes."""
    i, j, direction, gap = near.i[pairs], near.j[pairs], near.direction[:, pairs], near.gap[pairs]
    a, b, ri, rj = near.ahead[:, i], near.ahead[:, j], near.radius[i], near.radius[j]
    off = direction * (gap + ri + rj) - (near.middle[:, i] - near.middle[:, j])  # t a - s b
    across = dot(a, b)
    free = 1.0 - across * across
    t = np.where(free > 1e-6, (dot(off, a) - across * dot(off, b)) / np.maximum(free, 1e-6), dot(off, a) / 2)
    s = across * t - dot(off, b)
    t, s = np.clip(t, -near.half[i], near.half[i]), np.clip(s, -near.half[j], near.half[j])
    first = near.middle[:, i] + a * t - direction * (ri + gap / 2)
    second = near.middle[:, j] + b * s + direction * (rj + gap / 2)
    middle: NDArray[np.float64] = (first + second) / 2
    return middle


EVENTS: Mapping[str, Callable[[World, float], Arrays]] = {"emit": _emits, "contact": _contacts}
