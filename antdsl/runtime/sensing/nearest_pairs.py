"""Finds, for each of many agents, the nearest agent of a complete species with a k-d tree.

Source: J. L. Bentley, Multidimensional binary search trees, Comm. ACM 18, 1975. The tree only gives candidates. Of these, the one
with the least float32 distance is chosen, then the least id. So the result is the same as if all pairs were measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.world import AXES, Population, World

Floats = NDArray[np.float32]
PairColumns = tuple[NDArray[np.intp], NDArray[np.intp], Floats, Floats, Floats, Floats]

_DISTANCE_SLACK_FACTOR = 1 + 1e-6  # exceeds the rounding of a float32 distance
_MIN_DISTANCE_MM = 1e-15  # squares of smaller float32 distances lose digits
_MAX_DISTANCE_MM = 1e15  # squares of larger float32 distances overflow
_FIRST_QUERY_NEIGHBOURS = 3  # neighbours in the first query
_QUERY_GROWTH_FACTOR = 4  # growth of the query if all results are equally near
_MAX_EQUAL_DISTANCES = 64  # with more equal float32 distances, all pairs are measured
_PAIRS_PER_CHUNK = 1 << 20  # pairs


def find_nearest_agents(
    world: World, other: Population, own_positions: tuple[Floats, ...], ids: NDArray[np.int64] | None
) -> PairColumns | None:
    """Return the nearest other agent of each requesting agent.

    The columns are: the indices of the requesting agents that have a result, ascending; the rows of the others; offsets x, y, z
    to the others; distances. None if a position is not finite, or if its square exceeds float32. `own_positions`: x, y and z of
    the requesting agents, float32[n] mm. `ids`: their ids if both are of the same species, so that no agent finds itself; else
    None."""
    mine, sites = np.stack(own_positions, axis=1).astype(np.float64), _get_position_tree(world, other)
    if sites is None or not (np.abs(mine) < _MAX_DISTANCE_MM).all():
        return None
    every = len(sites.first_rows)
    count, parts = min(every, _FIRST_QUERY_NEIGHBOURS), []
    asking = np.arange(len(mine))
    while len(asking):
        if count > _MAX_EQUAL_DISTANCES:
            parts += _measure_all_agents(other, own_positions, ids, asking)
            break
        left = []
        at_once = max(1, _PAIRS_PER_CHUNK // count)
        for first in range(0, len(asking), at_once):
            batch = asking[first : first + at_once]
            away, place = sites.tree.query(mine[batch], np.arange(1, count + 1))
            row, last = sites.first_rows.take(place), away[:, -1].copy()
            if ids is not None:
                row = np.where(other.ids.take(row) == ids.take(batch)[:, None], sites.second_rows.take(place), row)
                away[row < 0] = np.inf
            reach = np.maximum(away.min(axis=1) * _DISTANCE_SLACK_FACTOR, _MIN_DISTANCE_MM)
            is_complete = (last > reach) | (count == every)
            near = np.isfinite(away) & (away <= reach[:, None]) & is_complete[:, None]
            who, which = np.nonzero(near)
            parts.append(_measure_pairs(other, own_positions, batch.take(who), row[who, which]))
            left.append(batch[~is_complete])
        asking, count = np.concatenate(left), min(every, _QUERY_GROWTH_FACTOR * count)
    if not parts:
        return asking, asking, own_positions[0], own_positions[0], own_positions[0], own_positions[0]
    joined = [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
    order = np.argsort(joined[0])
    i, j, dx, dy, dz, distance = (array.take(order) for array in joined)
    return i, j, dx, dy, dz, distance


def _measure_all_agents(
    other: Population, own_positions: tuple[Floats, ...], ids: NDArray[np.int64] | None, requesting_rows: NDArray[np.intp]
) -> list[PairColumns]:
    """Return the nearest other agent for each of `requesting_rows`, by measuring the distance to all others."""
    order = other.get_rows_by_id()
    known, place = other.ids.take(order), [other.start[f"position.{axis}"].take(order) for axis in AXES]
    parts, at_once = [], max(1, _PAIRS_PER_CHUNK // len(order))
    for first in range(0, len(requesting_rows), at_once):
        batch = requesting_rows[first : first + at_once]
        dx, dy, dz = (theirs - mine.take(batch)[:, None] for theirs, mine in zip(place, own_positions, strict=True))
        distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
        if ids is not None:
            distance[known == ids.take(batch)[:, None]] = np.inf
        best = distance.argmin(axis=1)  # the first of several, with the least id
        hit_rows = np.flatnonzero(np.isfinite(distance[np.arange(len(batch)), best]))
        columns = (array[hit_rows, best.take(hit_rows)] for array in (dx, dy, dz, distance))
        parts.append((batch.take(hit_rows), order.take(best.take(hit_rows)), *columns))
    return parts


def _measure_pairs(other: Population, own_positions: tuple[Floats, ...], i: NDArray[np.intp], j: NDArray[np.intp]) -> PairColumns:
    """Return, for each requesting agent, its nearest pair. `i`, `j`: the requesting agents and the rows of the others."""
    dx, dy, dz = (other.start[f"position.{axis}"].take(j) - own_positions[k].take(i) for k, axis in enumerate(AXES))
    distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
    order = np.lexsort((other.ids.take(j), distance, i))
    first = np.concatenate((np.ones(min(1, len(i)), np.bool_), i.take(order[1:]) != i.take(order[:-1])))
    best = order[first]
    return i.take(best), j.take(best), dx.take(best), dy.take(best), dz.take(best), distance.take(best)


@dataclass(frozen=True, slots=True, eq=False)
class _AgentPositionTree:
    """The distinct positions of the agents of a species.

    `tree`: a k-d tree of the positions. `first_rows`: at each position, the row of the agent with the least id. `second_rows`:
    the row with the second least id, -1 if there is none. It is used if the first agent is the requester itself."""

    tree: Any
    first_rows: NDArray[np.intp]
    second_rows: NDArray[np.intp]


def _get_position_tree(world: World, other: Population) -> _AgentPositionTree | None:
    """Return the distinct positions of a species at the start of the step. The result is cached for the step.

    None if there are no agents, or if a position is not finite or is too far from the origin."""
    if other.name not in world.trees:
        world.trees[other.name] = _build_position_tree(other)
    sites: _AgentPositionTree | None = world.trees[other.name]
    return sites


def _build_position_tree(other: Population) -> _AgentPositionTree | None:
    """Return the distinct positions of a species. None in the same cases as for `_get_position_tree`."""
    from scipy.spatial import cKDTree

    x, y, z = (other.start[f"position.{axis}"] for axis in AXES)
    if not len(x) or not all((np.abs(each) < _MAX_DISTANCE_MM).all() for each in (x, y, z)):
        return None
    order = np.lexsort((other.ids, z, y, x))
    x, y, z = x.take(order), y.take(order), z.take(order)
    new = np.concatenate(([True], (x[1:] != x[:-1]) | (y[1:] != y[:-1]) | (z[1:] != z[:-1])))
    starts = np.flatnonzero(new)
    several = np.diff(np.append(starts, len(order))) > 1
    second = np.where(several, order.take(np.minimum(starts + 1, len(order) - 1)), -1)
    points = np.stack([each.take(starts) for each in (x, y, z)], axis=1).astype(np.float64)
    return _AgentPositionTree(cKDTree(points), order.take(starts), second)
