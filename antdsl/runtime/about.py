"""Who is about an agent, in the plane of its own ground: for the velocity by which it meets nobody, and for the widest gap."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.numerics import compiled
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import Vector
from antdsl.runtime.cell_grids import grid_for
from antdsl.runtime.planes import Plane, known
from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.clear_velocity import Others, clear_velocities
from antdsl.senses.neighbours import Pairs
from antdsl.senses.widest_gap import widest_gaps

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]


def clear_velocity(
    world: World, population: Population, rows: Rows, wish: Vector, within: Floats, horizon: Floats, most: Floats
) -> tuple[NDArray[np.float32], ...]:
    """Velocities (mm/s, x y z) along the ground of some agents, nearest to a wish, by which they meet none of the `most` nearest
    others of any species `within` mm, on their side of the ground, for `horizon` s. Each is as it was when the step began."""
    threads = world.options.threads
    plane = Plane.of(population, rows, threads)
    moves = plane.moves(population, rows, wish, threads)
    others = _others(world, population, rows, within, most, moves.own, plane)
    sound = np.where(horizon > 0, np.minimum(horizon, 1e6), 1e6)
    x, y = clear_velocities(others, moves.velocity, moves.wish, moves.fastest, sound, world.dt, threads)
    return plane.raised(x, y, threads)


def widest_gap(world: World, population: Population, rows: Rows, within: Floats, most: Floats) -> tuple[NDArray[np.float32], ...]:
    """Unit ways (x y z) of some agents along their ground into the widest gap between the `most` nearest others of any species
    `within` mm, on their side of the ground; 0 without any."""
    plane = Plane.of(population, rows, world.options.threads)
    others = _others(world, population, rows, within, most, None, plane)
    return plane.raised(*widest_gaps(others.x, others.y, others.there), world.options.threads)


def _others(
    world: World,
    population: Population,
    rows: Rows,
    within: Floats,
    most: Floats,
    own: Vector | None,
    plane: Plane,
) -> Others:
    """The nearest others of all species, at most `most` of each agent; their velocities where its `own` is given."""
    count = np.minimum(np.where(most > 0, most, 0), limits.NEIGHBOURS).astype(np.intp)
    n, widest = len(rows), int(count.max(initial=0))
    place = tuple(np.ascontiguousarray(population.start[f"position.{axis}"][rows]) for axis in AXES)
    reach = np.where(within > 0, within, -1).astype(np.float32)
    ids, radius = population.ids[rows], _radius(population, rows)
    far = float(reach.max(initial=0.0, where=np.isfinite(reach)))
    if compiled.wanted(n):
        return _by_loops(world, population, (ids, radius, place, reach, far), count, own, plane)
    found: list[tuple[NDArray[Any], ...]] = []
    for number, (name, other) in enumerate(world.populations.items()):
        if not len(other) or not widest:
            continue
        p = _near(world, other, ids if other is population else None, place, reach, far)
        theirs = known(vec.take(vec.named(other.start, "up"), p.j))
        kept = np.flatnonzero(vec.dot(vec.take(plane.up, p.i), theirs) > 0)
        i, j = p.i.take(kept), p.j.take(kept)
        way = tuple(each.take(kept).astype(np.float64) for each in (p.dx, p.dy, p.dz))
        moves = [] if own is None else [vec.sub(vec.take(own, i), known(vec.take(vec.named(other.start, "velocity"), j)))]
        first = ids[i] < other.ids[j] if other is population else np.full(len(i), population.name < name)
        flat = [vec.dot(v, vec.take(axis, i)) for v in (way, *moves) for axis in (plane.ahead, plane.left)]  # type: ignore[arg-type]
        flat += [np.zeros(len(i))] * (4 - len(flat))
        room = radius[i] + _radius(other, j)
        found.append((i, p.distance.take(kept), np.full(len(i), number), other.ids[j], *flat, room, first))
    shape = (n, widest)
    x, y, vx, vy, both = table = [np.zeros(shape) for _ in range(5)]
    there, first = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    if found:
        columns = [np.concatenate(column) for column in zip(*found, strict=True)]
        order = _order(*columns[:4])
        columns = [column.take(order) for column in columns]
        asking = columns[0]
        place_of = np.arange(len(asking)) - np.searchsorted(asking, asking)
        kept = np.flatnonzero(place_of < count.take(asking))
        at = asking.take(kept), place_of.take(kept)
        for whole, column in zip(table, columns[4:9], strict=True):
            whole[at] = column.take(kept)
        there[at], first[at] = True, columns[9].take(kept)
    return Others(x, y, vx, vy, both, there, first)


def _near(
    world: World, other: Population, ids: NDArray[np.int64] | None, place: Any, reach: NDArray[np.float32], far: float
) -> Pairs:
    """Pairs of places and of those of a species within their `reach`, at most `far` (mm); `ids`: of the places, if they are of
    this species."""
    grid = grid_for(world, other, far if far > 0 else 1.0)
    return grid.pairs(None, reach, qx=place[0], qy=place[1], qz=place[2], qid=ids, threads=world.options.threads)


def _by_loops(
    world: World, population: Population, asking: tuple[Any, ...], count: Rows, own: Vector | None, plane: Plane
) -> Others:
    """`_others` by kernels: the nearest are chosen as pairs are met, and only these are looked at further."""
    from antdsl.runtime.about_compiled import choose, lay

    ids, radius, place, reach, far = asking
    n, widest = len(ids), int(count.max(initial=0))
    shape = (n, widest)
    x, y, vx, vy, room = (np.zeros(shape) for _ in range(5))
    there, first = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    nearest = np.empty(shape, np.float32), *(np.empty(shape, np.int64) for _ in range(3)), np.zeros(n, np.int64)
    up, ahead, left = (compiled.plain(*each) for each in (plane.up, plane.ahead, plane.left))
    moving = ahead if own is None else compiled.plain(*own)
    found = []
    for number, (name, other) in enumerate(world.populations.items()):
        if not len(other) or not widest:
            continue
        p = _near(world, other, ids if other is population else None, place, reach, far)
        theirs = compiled.plain(*vec.named(other.start, "up"))
        choose(p.i, p.j, p.distance, up, theirs, other.ids, number, count, nearest)
        found.append((number, name, other, p))
    for number, name, other, p in found:
        velocity = compiled.plain(*vec.named(other.start, "velocity"))
        both = radius, _radius(other)
        who = ids, other is population, population.name < name
        lay(
            nearest, number, p.j, (p.dx, p.dy, p.dz), ahead, left, own is not None, moving, velocity, *both, *who, x, y, vx, vy,
            room, there, first,
        )  # fmt: skip
    return Others(x, y, vx, vy, room, there, first)


def _order(asking: Rows, distance: NDArray[np.float32], species: Rows, ids: NDArray[np.int64]) -> Rows:
    """The order of pairs by who asks and how far away the other is, at a tie by species and id."""
    near = np.asarray(distance, np.float32).view(np.int32)  # bits of numbers that are not negative have their order
    key = (asking.astype(np.int64) << 32) | near
    order = np.argsort(key)
    following = key.take(order)
    if (following[1:] == following[:-1]).any():
        order = np.lexsort((ids, species, key))
    return order


def _radius(population: Population, rows: Rows | slice = slice(None)) -> Floats:
    radius = population.start["radius"][rows].astype(np.float64)
    return np.where(np.isfinite(radius) & (radius > 0), radius, 0.0)
