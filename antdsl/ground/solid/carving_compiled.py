"""The two loops of `carving` compiled: same operations in the same order, so the same bits. Imported only where wanted."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import STEPS
from antdsl.numerics.kernel_cache import njit

Array = NDArray[Any]

_M1, _M2, _M3 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SCATTER = np.uint64(0x9E3779B97F4A7C15)
_FULL = np.float32(STEPS)


@njit(cache=True, nogil=True, error_model="numpy")
def reached(  # type: ignore[no-untyped-def]  # numba takes the types from the call
    table, values, origin, voxel, shape, least, most, centres, radii, rows, steps, nodes, news, balls
):  # fmt: skip
    """Fill `nodes`, `news` and `balls` with what each of the balls `rows` changes within `steps` voxels; gives how many."""
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
                    if value > values[(np.int64(table[brick]) << 12) + place]:
                        nodes[count] = (brick << 12) + place
                        news[count] = value
                        balls[count] = ball
                        count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def write(values, at, nodes, news, news_bits, before, before_bits, balls, scale, lost):  # type: ignore[no-untyped-def]
    """Put the greatest new value in each place, count what balls took in `lost`, and give the change of the bricks' mark."""
    room = 1
    while room < 2 * at.size:
        room *= 2
    best = np.full(room, -1, np.int32)
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


@njit(cache=True, nogil=True, error_model="numpy")
def _filled(distance, scale):  # type: ignore[no-untyped-def]
    part = np.float32(0.5) - distance * scale
    part = min(max(part, np.float32(0)), np.float32(1))
    return np.int64(np.rint(part * _FULL))


@njit(cache=True, nogil=True, error_model="numpy")
def _mixed(node, bits):  # type: ignore[no-untyped-def]
    x = (np.uint64(node) << np.uint64(32)) ^ np.uint64(bits)
    x *= _M1
    x = (x ^ (x >> np.uint64(30))) * _M2
    x = (x ^ (x >> np.uint64(27))) * _M3
    return x ^ (x >> np.uint64(31))
