"""Digs balls out of a solid. The new distance of a node is the maximum of its old distance and the distances that the balls give.

So the order of the balls does not matter."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import (
    AIR_BRICK_SLOT,
    FILL_STEPS_PER_VOXEL,
    NODES_PER_BRICK,
    NODES_PER_BRICK_SIDE,
    UINT64_MASK,
    BrickGrid,
)
from antdsl.machine_code.kernels import F32, F64, I32, I64, U32, U64, Array1, Array2, inlined, kernel

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Distances = NDArray[np.float32]
NodeChanges = tuple[Index, Distances, Index]  # the fields of ChangedNodes

_LARGE_BALL_VOXELS = 24  # voxels; a ball with a larger reach is dug brick by brick

# Table, values, origin, voxel, shape, and the least and the greatest distance of the bricks
BrickTables = tuple[Array1[I32], Array1[F32], Array1[F64], F64, tuple[I64, I64, I64], F64, F32]
BallArrays = tuple[Array2[F64], Array1[F64]]  # centres and radii
ChangeArrays = tuple[Array1[I64], Array1[F32], Array1[I64]]  # nodes, new distances, balls

_HASH_MULTIPLIER1, _HASH_MULTIPLIER2, _HASH_MULTIPLIER3 = (
    np.uint64(0x9E3779B97F4A7C15),
    np.uint64(0xBF58476D1CE4E5B9),
    np.uint64(0x94D049BB133111EB),
)
_BLOOM_HASH_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)
_FILL_STEPS_OF_FULL_VOXEL = np.float32(FILL_STEPS_PER_VOXEL)


@dataclass(frozen=True, slots=True)
class ChangedNodes:
    """The changes that balls make to nodes, one row for each pair of a ball and a node.

    - `nodes`: brick number * 4096 + index of the node in the brick
    - `values`: the new distances
    - `balls`: the number of the ball"""

    nodes: Index
    values: Distances
    balls: Index


def carve_balls(bricks: BrickGrid, centres: Floats, radii: Floats, owners: Index) -> Floats:
    """Dig balls out of a solid. Same as `Volume.carve_balls`."""
    centres, radii = np.asarray(centres, np.float64).reshape(-1, 3), np.asarray(radii, np.float64).reshape(-1)
    # Independent of the order of the balls: at a tie, the lowest owner, then the lowest position, gets the voxel.
    order = np.lexsort((radii, centres[:, 2], centres[:, 1], centres[:, 0], np.asarray(owners, np.int64).reshape(-1)))
    centres, radii = centres[order], radii[order]
    reached = _find_changed_nodes(bricks, centres, radii)
    removed = np.zeros(len(order))
    if reached.nodes.size:
        brick = reached.nodes >> 12
        changed = np.zeros(bricks.table.size, bool)
        changed[brick] = True
        bricks.allocate_bricks(np.flatnonzero(changed))
        at = (bricks.table.take(brick).astype(np.int64) << 12) + (reached.nodes & (NODES_PER_BRICK - 1))
        lost = _write_node_changes_to_bricks(bricks, at, reached, len(order))
        bricks.volume_steps -= int(lost.sum())
        removed[order] = lost * bricks.step_volume
    return removed


def _select_balls_near_grid(bricks: BrickGrid, centres: Floats, radii: Floats) -> tuple[Index, Index]:
    """Return the balls that may change the grid, in ascending order. Also return the radius of influence of each ball in voxels,
    rounded up."""
    local = (centres - bricks.origin) / bricks.voxel
    reach = (radii - bricks.min_distance) / bricks.voxel
    with np.errstate(invalid="ignore"):
        meets = np.isfinite(local).all(axis=1) & np.isfinite(radii) & (radii > 0)
        meets &= ((local > -reach[:, None] - 1) & (local < np.array(bricks.node_counts) + reach[:, None] + 1)).all(axis=1)
    rows = np.flatnonzero(meets)
    # Limited to the width of the grid, for a ball of any size.
    return rows, np.ceil(np.minimum(reach[rows], 2.0 * max(bricks.node_counts))).astype(np.int64)


def _find_changed_nodes(bricks: BrickGrid, centres: Floats, radii: Floats) -> ChangedNodes:
    """Return the nodes that balls change, in the order of the balls."""
    rows, steps = _select_balls_near_grid(bricks, centres, radii)
    great = np.flatnonzero(steps > _LARGE_BALL_VOXELS)
    parts = [_carve_large_ball(bricks, centres, radii, int(ball)) for ball in rows[great]]
    small = np.flatnonzero(steps <= _LARGE_BALL_VOXELS)
    parts.append(_carve_small_balls(bricks, centres, radii, rows[small], steps[small]))
    nodes, values, balls = (np.concatenate(p) for p in zip(*parts, strict=True)) if len(parts) > 1 else parts[0]
    return ChangedNodes(nodes, values, balls)


def _carve_large_ball(bricks: BrickGrid, centres: Floats, radii: Floats, ball: int) -> NodeChanges:
    """Return the changes that one large ball makes to nodes. They are computed brick by brick, so that only changed nodes need
    memory."""
    centre, radius = centres[ball], radii[ball]
    ends = []
    for axis in range(3):
        low, high = (
            (centre[axis] + sign * (radius - bricks.min_distance) - bricks.origin[axis]) / bricks.voxel / NODES_PER_BRICK_SIDE
            for sign in (-1, 1)
        )
        ends.append(np.arange(math.floor(max(low, 0.0)), math.floor(min(high, bricks.shape[axis] - 1.0)) + 1))
    line = np.arange(NODES_PER_BRICK_SIDE)
    change_pairs = []
    for i, j, k in itertools.product(*ends):
        brick = (i * bricks.shape[1] + j) * bricks.shape[2] + k
        slot = int(bricks.table[brick])
        if slot == AIR_BRICK_SLOT:
            continue
        squares = []
        for axis, b in enumerate((i, j, k)):
            gap = (bricks.origin[axis] + (b * NODES_PER_BRICK_SIDE + line) * bricks.voxel) - centre[axis]
            squares.append(gap * gap)
        away = ((squares[0][:, None, None] + squares[1][:, None]) + squares[2]).ravel()
        value = np.minimum((radius - np.sqrt(away)).astype(np.float32), np.float32(bricks.max_distance))
        changes = np.flatnonzero(value > bricks.values[slot * NODES_PER_BRICK : (slot + 1) * NODES_PER_BRICK])
        change_pairs.append((brick * NODES_PER_BRICK + changes, value[changes]))
    nodes = np.concatenate([np.empty(0, np.int64), *(n for n, _ in change_pairs)])
    values = np.concatenate([np.empty(0, np.float32), *(v for _, v in change_pairs)])
    return nodes, values, np.full(nodes.size, ball, np.int64)


def _carve_small_balls(bricks: BrickGrid, centres: Floats, radii: Floats, rows: Index, steps: Index) -> NodeChanges:
    """Return the changes that the small balls `rows` make to nodes. `steps`: the radius of influence of each ball, in voxels."""
    capacity = int(((2 * steps + 2) ** 3).sum())
    nodes, values, balls = np.empty(capacity, np.int64), np.empty(capacity, np.float32), np.empty(capacity, np.int64)
    tables = (bricks.table, bricks.values, bricks.origin, bricks.voxel, bricks.shape, bricks.min_distance, bricks.max_distance)
    count = find_node_changes(tables, (centres, radii), rows, steps, (nodes, values, balls))
    return nodes[:count], values[:count], balls[:count]


def _write_node_changes_to_bricks(bricks: BrickGrid, value_indices: Index, changed_nodes: ChangedNodes, count: int) -> Index:
    """Store the maximum of the old and the new distances in each changed node. Return how many volume steps (the unit of the
    solid volume) each of `count` balls removed."""
    old_values = bricks.values.take(value_indices)
    lost = np.zeros(count, np.int64)
    best = np.full(1 << (2 * value_indices.size - 1).bit_length(), -1, np.int32)
    bits = (changed_nodes.values.view(np.uint32), old_values.view(np.uint32))
    changes = (changed_nodes.nodes, changed_nodes.values, changed_nodes.balls)
    bricks.node_hash_sum += write_node_changes(
        bricks.values, value_indices, changes, old_values, bits, 1.0 / bricks.voxel, best, lost
    )
    bricks.node_hash_sum &= UINT64_MASK
    return lost


@kernel
def find_node_changes(
    bricks: BrickTables, all_balls: BallArrays, rows: Array1[I64], steps: Array1[I64], changes: ChangeArrays
) -> I64:
    """Write to `changes` the changes that the balls `rows` make to nodes, and return their number. `steps`: the radius of
    influence of each ball, in voxels."""
    table, values, origin, voxel, shape, least, most = bricks
    centres, radii = all_balls
    nodes, news, balls = changes
    count = 0
    for row in range(rows.size):
        ball = rows[row]
        size = steps[row]
        radius = radii[ball]
        least_reach = radius - least
        square = least_reach * least_reach * (1 + 1e-9)
        cx, cy, cz = centres[ball, 0], centres[ball, 1], centres[ball, 2]
        bx = np.int64(np.floor((cx - origin[0]) / voxel)) - size
        by = np.int64(np.floor((cy - origin[1]) / voxel)) - size
        bz = np.int64(np.floor((cz - origin[2]) / voxel)) - size
        for i in range(max(bx, 0), min(bx + 2 * size + 2, shape[0] * 16)):
            gx = (origin[0] + i * voxel) - cx
            gx *= gx
            for j in range(max(by, 0), min(by + 2 * size + 2, shape[1] * 16)):
                gy = (origin[1] + j * voxel) - cy
                gy = gx + gy * gy
                if gy >= square:
                    continue
                line = ((i >> 4) * shape[1] + (j >> 4)) * shape[2]
                local = ((i & 15) << 8) + ((j & 15) << 4)
                for k in range(max(bz, 0), min(bz + 2 * size + 2, shape[2] * 16)):
                    gz = (origin[2] + k * voxel) - cz
                    away = gy + gz * gz
                    if away >= square:
                        continue
                    value = min(np.float32(radius - np.sqrt(away)), most)
                    brick = line + (k >> 4)
                    place = local + (k & 15)
                    if value > values[(table[brick] << 12) + place]:
                        nodes[count] = (brick << 12) + place
                        news[count] = value
                        balls[count] = ball
                        count += 1
    return count


@kernel
def write_node_changes(
    values: Array1[F32],
    value_indices: Array1[I64],
    changes: ChangeArrays,
    old_values: Array1[F32],
    bits: tuple[Array1[U32], Array1[U32]],
    scale: F32,
    strongest_rows: Array1[I32],
    removed_steps: Array1[I64],
) -> U64:
    """Raise the value at each of `value_indices` to the greatest new value. Add to `removed_steps` the volume steps (the unit of
    the solid volume) that each ball removes. Return the change of `node_hash_sum`.

    - `bits`: the bits of the new distances and of the `old_values`
    - `strongest_rows`: a hash table of row numbers; its size is a power of two, and all entries are -1 at the start"""
    nodes, news, balls = changes
    news_bits, old_bits = bits
    capacity = strongest_rows.size
    for row in range(value_indices.size):
        slot = np.int64((np.uint64(value_indices[row]) * _BLOOM_HASH_MULTIPLIER) >> np.uint64(32)) & (capacity - 1)
        while strongest_rows[slot] >= 0 and value_indices[strongest_rows[slot]] != value_indices[row]:
            slot = (slot + 1) & (capacity - 1)
        now = strongest_rows[slot]
        if now < 0 or news[row] > news[now] or (news[row] == news[now] and balls[row] < balls[now]):
            strongest_rows[slot] = row
    mark = np.uint64(0)
    for place in range(capacity):
        last = strongest_rows[place]
        if last >= 0:
            values[value_indices[last]] = news[last]
            removed_steps[balls[last]] += _compute_fill_step(old_values[last], scale) - _compute_fill_step(news[last], scale)
            mark += _hash_node(nodes[last], news_bits[last]) - _hash_node(nodes[last], old_bits[last])
    return mark


@inlined
def _compute_fill_step(distance: F32, scale: F32) -> I64:
    """Return the solid fraction of the voxel around one node, as `bricks.compute_fill_steps` does."""
    part = np.float32(0.5) - distance * scale
    part = min(max(part, np.float32(0)), np.float32(1))
    return np.int64(np.rint(part * _FILL_STEPS_OF_FULL_VOXEL))


@inlined
def _hash_node(node: I64, bits: I64) -> U64:
    """Return the pseudorandom number of one node and its distance, as `bricks.hash_nodes` does."""
    x = (np.uint64(node) << np.uint64(32)) ^ np.uint64(bits)
    x *= _HASH_MULTIPLIER1
    x = (x ^ (x >> np.uint64(30))) * _HASH_MULTIPLIER2
    x = (x ^ (x >> np.uint64(27))) * _HASH_MULTIPLIER3
    return x ^ (x >> np.uint64(31))
