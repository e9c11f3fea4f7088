"""Digging balls out of a solid: every node becomes the greatest of what it was and what the balls make it, in any order."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import AIR, CUBE, SIDE, WHOLE, Bricks, filling, mixed
from antdsl.numerics import compiled

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Distances = NDArray[np.float32]
Pairs = tuple[Index, Distances, Index]  # as of Reached

_PIECE = 1 << 17  # pairs of ball and node looked at together
_GREAT = 24  # voxels that a ball reaches, above which it is dug brick by brick
_LIKE_AGENTS = 4  # a ball is as much work as so many agents who do other things


@dataclass(frozen=True, slots=True)
class Reached:
    """Nodes that balls change, one row for each ball and node: brick * 4096 + place in it, new distance, ball."""

    nodes: Index
    values: Distances
    balls: Index


def carve(bricks: Bricks, centres: Floats, radii: Floats, owners: Index) -> Floats:
    """As `Volume.carve`."""
    centres, radii = np.asarray(centres, np.float64).reshape(-1, 3), np.asarray(radii, np.float64).reshape(-1)
    # The same whatever order the balls come in: at a tie the least owner, then the least place.
    order = np.lexsort((radii, centres[:, 2], centres[:, 1], centres[:, 0], np.asarray(owners, np.int64).reshape(-1)))
    centres, radii = centres[order], radii[order]
    fast = compiled.wanted(len(order) * _LIKE_AGENTS)
    reached = _reached(bricks, centres, radii, fast)
    removed = np.zeros(len(order))
    if reached.nodes.size:
        brick = reached.nodes >> 12
        changed = np.zeros(bricks.table.size, bool)
        changed[brick] = True
        bricks.open(np.flatnonzero(changed))
        at = (bricks.table.take(brick).astype(np.int64) << 12) + (reached.nodes & (CUBE - 1))
        lost = (_compiled_write if fast else _write)(bricks, at, reached, len(order))
        bricks.steps -= int(lost.sum())
        removed[order] = lost * bricks.step_volume
    return removed


def _meeting(bricks: Bricks, centres: Floats, radii: Floats) -> tuple[Index, Index]:
    """Balls, ascending, that may reach into the grid, and for each how many voxels it reaches, rounded up."""
    local = (centres - bricks.origin) / bricks.voxel
    reach = (radii - bricks.least) / bricks.voxel
    with np.errstate(invalid="ignore"):
        meets = np.isfinite(local).all(axis=1) & np.isfinite(radii) & (radii > 0)
        meets &= ((local > -reach[:, None] - 1) & (local < np.array(bricks.nodes) + reach[:, None] + 1)).all(axis=1)
    rows = np.flatnonzero(meets)
    # No further than the grid is wide, however great the ball.
    return rows, np.ceil(np.minimum(reach[rows], 2.0 * max(bricks.nodes))).astype(np.int64)


def _reached(bricks: Bricks, centres: Floats, radii: Floats, fast: bool) -> Reached:
    rows, steps = _meeting(bricks, centres, radii)
    great = np.flatnonzero(steps > _GREAT)
    parts = [_great(bricks, centres, radii, int(ball)) for ball in rows[great]]
    small = np.flatnonzero(steps <= _GREAT)
    rows, steps = rows[small], steps[small]
    if fast and rows.size:
        parts.append(_compiled_pairs(bricks, centres, radii, rows, steps))
    else:
        for size in np.unique(steps):
            alike = rows[steps == size]
            around = _around(int(size))
            many = max(_PIECE // around.shape[1], 1)
            for a in range(0, len(alike), many):
                parts.append(_pairs(bricks, centres, radii, alike[a : a + many], int(size), around))
    if not parts:
        return Reached(np.empty(0, np.int64), np.empty(0, np.float32), np.empty(0, np.int64))
    nodes, values, balls = (np.concatenate(p) for p in zip(*parts, strict=True)) if len(parts) > 1 else parts[0]
    return Reached(nodes, values, balls)


def _great(bricks: Bricks, centres: Floats, radii: Floats, ball: int) -> Pairs:
    """What one great ball changes, brick by brick: memory for what is changed and no more."""
    centre, radius = centres[ball], radii[ball]
    ends = []
    for axis in range(3):
        low, high = (
            (centre[axis] + way * (radius - bricks.least) - bricks.origin[axis]) / bricks.voxel / SIDE for way in (-1, 1)
        )
        ends.append(np.arange(math.floor(max(low, 0.0)), math.floor(min(high, bricks.shape[axis] - 1.0)) + 1))
    line = np.arange(SIDE)
    found = []
    for i, j, k in itertools.product(*ends):
        brick = (i * bricks.shape[1] + j) * bricks.shape[2] + k
        slot = int(bricks.table[brick])
        if slot == AIR:
            continue
        squares = []
        for axis, b in enumerate((i, j, k)):
            gap = (bricks.origin[axis] + (b * SIDE + line) * bricks.voxel) - centre[axis]
            squares.append(gap * gap)
        away = ((squares[0][:, None, None] + squares[1][:, None]) + squares[2]).ravel()
        value = np.minimum((radius - np.sqrt(away)).astype(np.float32), np.float32(bricks.most))
        changes = np.flatnonzero(value > bricks.values[slot * CUBE : (slot + 1) * CUBE])
        found.append((brick * CUBE + changes, value[changes]))
    nodes = np.concatenate([np.empty(0, np.int64), *(n for n, _ in found)])
    values = np.concatenate([np.empty(0, np.float32), *(v for _, v in found)])
    return nodes, values, np.full(nodes.size, ball, np.int64)


def _compiled_pairs(bricks: Bricks, centres: Floats, radii: Floats, rows: Index, steps: Index) -> Pairs:
    from antdsl.ground.solid.carving_compiled import reached

    room = int(((2 * steps + 2) ** 3).sum())
    nodes, values, balls = np.empty(room, np.int64), np.empty(room, np.float32), np.empty(room, np.int64)
    tables = (bricks.table, bricks.values, bricks.origin, bricks.voxel, bricks.shape, bricks.least, bricks.most)
    count = reached(tables, (centres, radii), rows, steps, (nodes, values, balls))
    return nodes[:count], values[:count], balls[:count]


@cache
def _around(size: int) -> Index:
    """Which of 2 * size + 2 nodes of a line along each axis (3, m) can be within `size` of a centre between the middle two."""
    line = np.arange(-size, size + 2)
    gap = np.maximum(np.abs(line - 0.5) - 0.5, 0.0) ** 2
    near = gap[:, None, None] + gap[None, :, None] + gap[None, None, :] <= size * size
    return np.stack(np.nonzero(near)).astype(np.int64)


def _pairs(bricks: Bricks, centres: Floats, radii: Floats, rows: Index, size: int, around: Index) -> Pairs:
    """What some balls that reach equally far change; the squares of distances and the places add up axis by axis."""
    away = place = None
    for axis, brick in enumerate((bricks.shape[1] * bricks.shape[2], bricks.shape[2], 1)):
        centre = centres[rows, axis, None]
        node = np.floor((centre - bricks.origin[axis]) / bricks.voxel).astype(np.int64) + np.arange(-size, size + 2)
        gap = (bricks.origin[axis] + node * bricks.voxel) - centre
        square = np.where((node >= 0) & (node < bricks.nodes[axis]), gap * gap, np.inf)
        where = (((node >> 4) * brick) << 12) + ((node & 15) << (8 - 4 * axis))
        square, where = square.take(around[axis], axis=1), where.take(around[axis], axis=1)
        away = square if away is None else np.add(away, square, out=away)
        place = where if place is None else np.add(place, where, out=place)
    assert away is not None and place is not None
    reach = radii[rows] - bricks.least
    near = np.flatnonzero(away < (reach * reach * (1 + 1e-9))[:, None])
    ball = rows.take(near // around.shape[1])
    place = place.take(near)
    value = np.minimum((radii.take(ball) - np.sqrt(away.take(near))).astype(np.float32), np.float32(bricks.most))
    slot = bricks.table.take(place >> 12).astype(np.int64)
    changes = np.flatnonzero(value > bricks.values.take((slot << 12) + (place & (CUBE - 1))))
    return place.take(changes), value.take(changes), ball.take(changes)


def _write(bricks: Bricks, at: Index, reached: Reached, count: int) -> Index:
    """Put the greatest of the new distances into each node; gives the steps of volume that each ball took."""
    values, balls = reached.values, reached.balls.astype(np.int32)
    before = bricks.values.take(at)
    rows = np.arange(at.size)
    while rows.size:
        bricks.values[at[rows]] = values[rows]
        rows = rows[values[rows] > bricks.values[at[rows]]]
    best = np.flatnonzero(values == bricks.values.take(at))
    # Of those as deep the first ball has the node: while that is found, its number stands in place of the distance.
    names = bricks.values.view(np.int32)
    rows = best
    while rows.size:
        names[at[rows]] = balls[rows]
        rows = rows[balls[rows] < names[at[rows]]]
    won = best[balls[best] == names.take(at[best])]
    bricks.values[at[won]] = values[won]
    lost = filling(before[won], bricks.voxel) - filling(values[won], bricks.voxel)
    bricks.mark += int((mixed(reached.nodes[won], values[won]) - mixed(reached.nodes[won], before[won])).sum(dtype=np.uint64))
    bricks.mark &= WHOLE
    return np.bincount(balls[won], weights=lost, minlength=count).astype(np.int64)


def _compiled_write(bricks: Bricks, at: Index, reached: Reached, count: int) -> Index:
    from antdsl.ground.solid.carving_compiled import write

    before = bricks.values.take(at)
    lost = np.zeros(count, np.int64)
    best = np.full(1 << (2 * at.size - 1).bit_length(), -1, np.int32)
    bits = (reached.values.view(np.uint32), before.view(np.uint32))
    found = (reached.nodes, reached.values, reached.balls)
    bricks.mark += write(bricks.values, at, found, before, bits, 1.0 / bricks.voxel, best, lost)
    bricks.mark &= WHOLE
    return lost
