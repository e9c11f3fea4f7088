"""What agents are told of others for the velocity by which they meet nobody: places, velocities and radii in the plane of
their own ground."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import Vector
from antdsl.runtime.cell_grids import grid_for
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.clear_velocity import Others, clear_velocities

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]


def clear_velocity(
    world: World, population: Population, rows: Rows, wish: Vector, within: Floats, horizon: Floats, most: Floats
) -> tuple[NDArray[np.float32], ...]:
    """Velocities (mm/s, x y z) along the ground of some agents, nearest to a wish, by which they meet none of the `most` nearest
    others of any species `within` mm, on their side of the ground, for `horizon` s. Each is as it was when the step began."""
    start = population.start
    up = _known(vec.take(vec.named(start, "up"), rows))
    ahead = vec.unit(vec.flat(_known(vec.take(vec.named(start, "heading"), rows)), up), vec.across(up))
    side = vec.cross(up, ahead)

    def laid(vector: Vector) -> tuple[Floats, Floats]:
        return vec.dot(vector, ahead), vec.dot(vector, side)

    own = _known(vec.take(vec.named(start, "velocity"), rows))
    goal = laid(_known(wish))
    fastest = np.where(start["max_speed"][rows] > 0, start["max_speed"][rows], 0).astype(np.float64)
    count = np.clip(np.where(most > 0, most, 0), 0, limits.NEIGHBOURS).astype(np.intp)
    others = _others(world, population, rows, within, count, own, up, (ahead, side))
    sound = np.where(horizon > 0, np.minimum(horizon, 1e6), 1e6)
    x, y = clear_velocities(others, laid(own), goal, np.minimum(fastest, 1e9), sound, world.dt)
    found = vec.add(vec.scale(ahead, x), vec.scale(side, y))
    return tuple(component.astype(np.float32) for component in found)


def _known(vector: Vector) -> Vector:
    """Vectors in float64, 0 where one is no number."""
    x, y, z = (np.asarray(component, np.float64) for component in vector)
    good = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    return vec.choose(good, (x, y, z), (np.zeros_like(x),) * 3)


def _others(
    world: World,
    population: Population,
    rows: Rows,
    within: Floats,
    count: NDArray[np.intp],
    own: Vector,
    up: Vector,
    axes: tuple[Vector, Vector],
) -> Others:
    """The nearest others of all species, at most `count` of each agent."""
    n, widest = len(rows), int(count.max(initial=0))
    place = tuple(np.ascontiguousarray(population.start[f"position.{axis}"][rows]) for axis in AXES)
    reach = np.where(within > 0, within, -1).astype(np.float32)
    radius = _radius(population)[rows]
    found: list[tuple[NDArray[Any], ...]] = []
    far = float(reach.max(initial=0.0, where=np.isfinite(reach)))
    for number, (name, other) in enumerate(world.populations.items()):
        if not len(other) or not widest:
            continue
        grid = grid_for(world, other, far if far > 0 else 1.0)
        qid = population.ids[rows] if other is population else None
        p = grid.pairs(None, reach, qx=place[0], qy=place[1], qz=place[2], qid=qid, threads=world.options.threads)
        theirs = _known(vec.take(vec.named(other.start, "up"), p.j))
        kept = np.flatnonzero(vec.dot(vec.take(up, p.i), theirs) > 0)
        i, j = p.i.take(kept), p.j.take(kept)
        way = tuple(each.take(kept).astype(np.float64) for each in (p.dx, p.dy, p.dz))
        theirs = _known(vec.take(vec.named(other.start, "velocity"), j))
        change = vec.sub(vec.take(own, i), theirs)
        first = population.ids[rows][i] < other.ids[j] if other is population else np.full(len(i), population.name < name)
        flat = [vec.dot(v, vec.take(axis, i)) for v in (way, change) for axis in axes]  # type: ignore[arg-type]
        room = radius[i] + _radius(other)[j]
        found.append((i, p.distance.take(kept), np.full(len(i), number), other.ids[j], *flat, room, first))
    shape = (n, widest)
    x, y, vx, vy, both = table = [np.zeros(shape) for _ in range(5)]
    there, first = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    if found:
        columns = [np.concatenate(column) for column in zip(*found, strict=True)]
        order = np.lexsort((columns[3], columns[2], columns[1], columns[0]))  # by distance, then species and id
        columns = [column.take(order) for column in columns]
        asking = columns[0]
        place_of = np.arange(len(asking)) - np.searchsorted(asking, asking)
        kept = np.flatnonzero(place_of < count.take(asking))
        at = asking.take(kept), place_of.take(kept)
        for whole, column in zip(table, columns[4:9], strict=True):
            whole[at] = column.take(kept)
        there[at], first[at] = True, columns[9].take(kept)
    return Others(x, y, vx, vy, both, there, first)


def _radius(population: Population) -> Floats:
    radius = population.start["radius"].astype(np.float64)
    return np.where(np.isfinite(radius) & (radius > 0), radius, 0.0)
