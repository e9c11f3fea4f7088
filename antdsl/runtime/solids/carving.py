"""Digging balls out of a solid: every node becomes the greatest of what it was and what the balls make it, in any order."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.solids.bricks import CUBE, SOLID, Bricks, filling

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

_PIECE = 1 << 18  # pairs of ball and node looked at together


def carve(bricks: Bricks, centres: Floats, radii: Floats, owners: Index) -> Floats:
    """As `Volume.carve`."""
    centres, radii, owners = (
        np.asarray(centres, np.float64).reshape(-1, 3),
        np.asarray(radii, np.float64).reshape(-1),
        np.asarray(owners, np.int64).reshape(-1),
    )
    # The same whatever order the balls come in: at a tie the least owner, then the least place.
    order = np.lexsort((radii, centres[:, 2], centres[:, 1], centres[:, 0], owners))
    centres, radii = centres[order], radii[order]
    nodes, values, balls = _reached(bricks, centres, radii)
    removed = np.zeros(len(order))
    if nodes.size:
        best = np.lexsort((balls, -values, nodes))
        nodes, values, balls = nodes[best], values[best], balls[best]
        first = np.concatenate(([True], nodes[1:] != nodes[:-1]))
        lost = _write(bricks, nodes[first], values[first])
        steps = np.bincount(balls[first], weights=lost, minlength=len(order))
        bricks.steps -= int(lost.sum())
        removed[order] = steps * bricks.step_volume
    return removed


def _reached(bricks: Bricks, centres: Floats, radii: Floats) -> tuple[Index, NDArray[np.float32], Index]:
    """Nodes that balls change: brick * 4096 + place in it, the new distance and the ball, one row for each ball and node."""
    voxel = bricks.voxel
    local = (centres - bricks.origin) / voxel
    limit = np.array(bricks.nodes, np.float64)
    reach = (radii - bricks.least) / voxel
    meets = np.isfinite(local).all(axis=1) & np.isfinite(radii) & (radii > 0)
    meets &= ((local > -reach[:, None] - 1) & (local < limit + reach[:, None] + 1)).all(axis=1)
    rows = np.flatnonzero(meets)
    class_of = np.ceil(reach[rows]).astype(np.int64)
    found: list[tuple[Index, NDArray[np.float32], Index]] = []
    for steps in np.unique(class_of):
        around = _around(int(steps))
        alike = rows[class_of == steps]
        many = max(_PIECE // len(around), 1)
        for a in range(0, len(alike), many):
            found.append(_pairs(bricks, centres, radii, alike[a : a + many], around))
    if not found:
        return np.empty(0, np.int64), np.empty(0, np.float32), np.empty(0, np.int64)
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))  # type: ignore[return-value]


@cache
def _around(steps: int) -> Index:
    """Offsets (m, 3) from the node below a centre to all nodes that can be within `steps` of it."""
    line = np.arange(-steps, steps + 2)
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    gap = np.maximum(np.abs(grid - 0.5) - 0.5, 0.0)
    near: Index = grid[(gap * gap).sum(axis=1) <= steps * steps]
    return near


def _pairs(
    bricks: Bricks, centres: Floats, radii: Floats, rows: Index, around: Index
) -> tuple[Index, NDArray[np.float32], Index]:
    below = np.floor((centres[rows] - bricks.origin) / bricks.voxel).astype(np.int64)
    away = np.zeros((len(rows), len(around)))
    place = np.zeros((len(rows), len(around)), np.int64)
    inside = np.ones((len(rows), len(around)), bool)
    spans = ((bricks.shape[1] * bricks.shape[2] * CUBE, 256), (bricks.shape[2] * CUBE, 16), (CUBE, 1))
    for axis, (brick, stride) in enumerate(spans):
        node = below[:, axis, None] + around[None, :, axis]
        gap = (bricks.origin[axis] + node * bricks.voxel) - centres[rows, axis, None]
        away += gap * gap
        inside &= (node >= 0) & (node < bricks.nodes[axis])
        place += (node >> 4) * brick + (node & 15) * stride
    value = np.minimum((radii[rows, None] - np.sqrt(away)).astype(np.float32), np.float32(bricks.most))
    ball, offset = np.nonzero(inside & (value > np.float32(bricks.least)))
    place, value = place[ball, offset], value[ball, offset]
    slot = bricks.table[place // CUBE].astype(np.int64)
    changes = value > bricks.values[slot * CUBE + place % CUBE]
    return place[changes], value[changes], rows[ball[changes]]


def _write(bricks: Bricks, nodes: Index, values: NDArray[np.float32]) -> Index:
    """Put distances into nodes, each named once, ascending; gives the steps of volume that each lost."""
    brick = nodes // CUBE
    changed = brick[np.concatenate(([True], brick[1:] != brick[:-1]))]
    bricks.own(changed[bricks.table[changed] <= SOLID])
    at = bricks.table[brick].astype(np.int64) * CUBE + nodes % CUBE
    lost = filling(bricks.values[at], bricks.voxel) - filling(values, bricks.voxel)
    bricks.values[at] = values
    bricks.touched[changed] = bricks.unread[changed] = True
    bricks.mark_fresh(changed)
    return lost.astype(np.int64)
