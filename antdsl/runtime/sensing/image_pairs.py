"""Pairs of agents in a periodic world. A pair consists of an agent and the nearest image of another agent.

For radii below half a width, pairs are found with a cell grid of all agents and their images near the box. For larger radii, the
distances of all agents are measured."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.numerics.periodic_box import PeriodicBox, measure_offset
from antdsl.runtime.world import AXES, Items, Population, World
from antdsl.senses.neighbours import CellGrid, NeighbourPairs, ViewConeColumns

Floats = NDArray[np.float32]
Rows = NDArray[np.intp]
PairColumns = tuple[NDArray[Any], ...]  # requesting row, other row, offset x, y, z, distance

# Share of the least width: up to this radius no two images of an agent are in reach, in spite of rounding
_MAX_GRID_REACH_SHARE = 0.499
_PAIRS_PER_CHUNK = 1 << 20


def measure_offsets(world: World, other_positions: Any, own_positions: Any) -> tuple[NDArray[Any], ...]:
    """Return the vectors x, y, z (mm) from positions `own_positions` to positions `other_positions`. In a periodic world, they
    lead to the nearest images."""
    if world.periodic is None:
        return tuple(other - own for other, own in zip(other_positions, own_positions, strict=True))
    return tuple(measure_offset(*each) for each in zip(other_positions, own_positions, world.periodic.box.widths, strict=True))


class ImageGrid(CellGrid):
    """A cell grid of the agents of a species, and of their images within `reach` (mm) of the box of a periodic world."""

    def __init__(self, box: PeriodicBox, other: Population, cell: float, reach: float, threads: int) -> None:
        position = tuple(other.start[f"position.{axis}"] for axis in AXES)
        self._sources, (x, y, z) = box.find_image_rows(position, min(reach, box.least_width / 2))
        super().__init__(x, y, z, other.ids.take(self._sources), cell, threads)

    def find_pairs(self, *arguments: Any, **options: Any) -> NeighbourPairs:
        pairs = super().find_pairs(*arguments, **options)
        return replace(pairs, j=self._sources.take(pairs.j))


def can_use_image_grid(world: World, radius: float) -> bool:
    """Return whether an image grid can serve a search with this radius (mm): no agent may have two images in reach."""
    return world.periodic is None or radius < _MAX_GRID_REACH_SHARE * world.periodic.box.least_width


def get_image_reach_by_axis(world: World) -> Floats:
    """Return, for each axis, the distance (mm) within which others count at their nearest image, float32[3]. It is slightly less
    than half a width, so that an agent never has two images within it. It is infinite along axes that do not wrap."""
    widths = np.zeros(3) if world.periodic is None else np.array(world.periodic.box.widths)
    return np.where(widths > 0, _MAX_GRID_REACH_SHARE * widths, np.inf).astype(np.float32)


def measure_pairs_within(
    world: World,
    others: Population | Items,
    own_positions: tuple[Floats, ...],
    ids: NDArray[np.int64] | None,
    radius: Any,
    view: ViewConeColumns | None = None,
) -> PairColumns:
    """Return the pairs within a radius (mm) and in view, found by measuring every pair (brute force).

    In a periodic world, the nearest image of each agent or item counts. Each agent gets at most
    `limits.MAX_QUERY_NEIGHBOURS` neighbours, the nearest by distance and id. Items are not limited.
    `ids`: the ids of the requesting agents if the others are of the same species, else None."""
    is_agents = isinstance(others, Population)
    source = others.start if isinstance(others, Population) else others.visible_values
    theirs = [np.asarray(source[f"position.{axis}" if is_agents else axis], np.float32) for axis in AXES]
    reach = np.broadcast_to(np.asarray(radius, np.float32), own_positions[0].shape)
    parts, at_once = [], max(1, _PAIRS_PER_CHUNK // max(1, len(theirs[0])))
    for first in range(0, len(reach), at_once):
        last = min(first + at_once, len(reach))
        mine = [own[first:last, None] for own in own_positions]
        dx, dy, dz = measure_offsets(world, [each[None, :] for each in theirs], mine)
        distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
        near = distance <= reach[first:last, None]
        if ids is not None and isinstance(others, Population):
            near &= others.ids[None, :] != ids[first:last, None]
        i, j = np.nonzero(near)
        own = [i, j, *(each[i, j] for each in (dx, dy, dz, distance))]
        if isinstance(others, Population):
            own = _limit_neighbours(own, others.ids, None if view is None else [each[first:last] for each in view])
        parts.append([own[0] + first, *own[1:]])
    if not parts:
        none = np.empty(0, np.intp)
        return none, none, *np.empty((4, 0), np.float32)
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def _limit_neighbours(columns: list[NDArray[Any]], ids: NDArray[np.int64], view: list[Floats] | None) -> list[NDArray[Any]]:
    """Return the pairs reduced to the nearest `limits.MAX_QUERY_NEIGHBOURS` neighbours of each requesting row, and then to those
    in view."""
    i, j, *_, distance = columns
    order = np.lexsort((ids.take(j), distance, i))
    columns = [each.take(order) for each in columns]
    i = columns[0]
    starts = np.searchsorted(i, i, side="left")
    nearest = np.flatnonzero(np.arange(len(i)) - starts < limits.MAX_QUERY_NEIGHBOURS)
    columns = [each.take(nearest) for each in columns]
    if view is None:
        return columns
    i, _, dx, dy, dz, distance = columns
    hx, hy, hz, cosine = (each.take(i) for each in view)
    visible = np.flatnonzero((dx * hx + dy * hy) + dz * hz >= cosine * distance)
    return [each.take(visible) for each in columns]
