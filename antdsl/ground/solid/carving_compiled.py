"""The two loops of `carving` compiled: same operations in the same order, so the same bits. Imported only where wanted."""

from __future__ import annotations

import numpy as np

from antdsl.ground.solid.bricks import STEPS
from antdsl.machine_code.kernels import F32, F64, I32, I64, U32, U64, Array1, Array2, inlined, kernel

# Table, values, origin, voxel, shape, and the least and the greatest distance of the bricks
Bricks = tuple[Array1[I32], Array1[F32], Array1[F64], F64, tuple[I64, I64, I64], F64, F32]
Balls = tuple[Array2[F64], Array1[F64]]  # centres and radii
Reached = tuple[Array1[I64], Array1[F32], Array1[I64]]  # nodes, new distances, and the balls that they are of

_M1, _M2, _M3 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SCATTER = np.uint64(0x9E3779B97F4A7C15)
_FULL = np.float32(STEPS)


@kernel
def reached(bricks: Bricks, all_balls: Balls, rows: Array1[I64], steps: Array1[I64], found: Reached) -> I64:
    """Fill `found` with what each of the balls `rows` changes within `steps` voxels; gives how much."""
    table, values, origin, voxel, shape, least, most = bricks
    centres, radii = all_balls
    nodes, news, balls = found
    count = 0
    for row in range(rows.size):
        ball = rows[row]
        size = steps[row]
        radius = radii[ball]
        reach = radius - least
        square = reach * reach * (1 + 1e-9)
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
def write(
    values: Array1[F32],
    at: Array1[I64],
    found: Reached,
    before: Array1[F32],
    bits: tuple[Array1[U32], Array1[U32]],
    scale: F32,
    best: Array1[I32],
    lost: Array1[I64],
) -> U64:
    """Put the greatest new value in each place `at`, count what balls took in `lost`, and give the change of the bricks' mark.
    `bits`: of the new distances and those `before`; `best`: a table of places, -1 all over, of a power of two of rows."""
    nodes, news, balls = found
    news_bits, before_bits = bits
    room = best.size
    for row in range(at.size):
        slot = np.int64((np.uint64(at[row]) * _SCATTER) >> np.uint64(32)) & (room - 1)
        while best[slot] >= 0 and at[best[slot]] != at[row]:
            slot = (slot + 1) & (room - 1)
        now = best[slot]
        if now < 0 or news[row] > news[now] or (news[row] == news[now] and balls[row] < balls[now]):
            best[slot] = row
    mark = np.uint64(0)
    for place in range(room):
        last = best[place]
        if last >= 0:
            values[at[last]] = news[last]
            lost[balls[last]] += _filled(before[last], scale) - _filled(news[last], scale)
            mark += _mixed(nodes[last], news_bits[last]) - _mixed(nodes[last], before_bits[last])
    return mark


@inlined
def _filled(distance, scale):  # type: ignore[no-untyped-def]
    part = np.float32(0.5) - distance * scale
    part = min(max(part, np.float32(0)), np.float32(1))
    return np.int64(np.rint(part * _FULL))


@inlined
def _mixed(node, bits):  # type: ignore[no-untyped-def]
    x = (np.uint64(node) << np.uint64(32)) ^ np.uint64(bits)
    x *= _M1
    x = (x ^ (x >> np.uint64(30))) * _M2
    x = (x ^ (x >> np.uint64(27))) * _M3
    return x ^ (x >> np.uint64(31))
