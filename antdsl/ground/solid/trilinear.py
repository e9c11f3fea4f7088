"""The field between the nodes: trilinear in each cell, continuous everywhere, with its exact gradient. Worked out in float64."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import Bricks
from antdsl.numerics import compiled

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Columns = Sequence[Floats]

_OFFSETS = (0, 1, 16, 17, 256, 257, 272, 273)  # of a cell's corners, in a brick
LEAN = 0.5  # voxels: how far around a place the smooth normal looks, each way, where no body says more


def distance(bricks: Bricks, x: Floats, y: Floats, z: Floats) -> Floats:
    """Signed distance at places (mm)."""
    if compiled.wanted(np.size(x)):
        return _compiled_distance(bricks, x, y, z)
    (v000, v001, v010, v011, v100, v101, v110, v111), (fx, fy, fz) = _corners(bricks, x, y, z)
    v0 = _mix(_mix(v000, v001, fz), _mix(v010, v011, fz), fy)
    return _mix(v0, _mix(_mix(v100, v101, fz), _mix(v110, v111, fz), fy), fx)


def field(bricks: Bricks, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Signed distance at places (mm), and its gradient."""
    if compiled.wanted(np.size(x)):
        return _compiled_field(bricks, x, y, z)
    (v000, v001, v010, v011, v100, v101, v110, v111), (fx, fy, fz) = _corners(bricks, x, y, z)
    d00, d01, d10, d11 = v001 - v000, v011 - v010, v101 - v100, v111 - v110
    v00, v01, v10, v11 = v000 + d00 * fz, v010 + d01 * fz, v100 + d10 * fz, v110 + d11 * fz
    e0, e1 = v01 - v00, v11 - v10
    v0, v1 = v00 + e0 * fy, v10 + e1 * fy
    gx = v1 - v0
    scale = 1.0 / bricks.voxel
    gz = _mix(_mix(d00, d01, fy), _mix(d10, d11, fy), fx) * scale
    return v0 + gx * fx, gx * scale, _mix(e0, e1, fx) * scale, gz


def smooth(bricks: Bricks, x: Floats, y: Floats, z: Floats, lean: Floats | float = LEAN) -> list[Floats]:
    """A gradient that changes steadily from place to place, unlike the field's own: differences along each axis, over `lean`
    voxels (one or for each place) either way."""
    a = np.asarray(lean) * bricks.voxel
    scale = 0.5 / a
    return [
        (distance(bricks, x + a, y, z) - distance(bricks, x - a, y, z)) * scale,
        (distance(bricks, x, y + a, z) - distance(bricks, x, y - a, z)) * scale,
        (distance(bricks, x, y, z + a) - distance(bricks, x, y, z - a)) * scale,
    ]


def _compiled_distance(bricks: Bricks, x: Floats, y: Floats, z: Floats) -> Floats:
    from antdsl.ground.solid import trilinear_compiled

    found = np.empty(np.size(x))
    trilinear_compiled.distance(_tables(bricks), _whole(x, y, z), found)
    return found


def _compiled_field(bricks: Bricks, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    from antdsl.ground.solid import trilinear_compiled

    d, gx, gy, gz = (np.empty(np.size(x)) for _ in range(4))
    trilinear_compiled.field(_tables(bricks), _whole(x, y, z), d, (gx, gy, gz))
    return d, gx, gy, gz


def _tables(bricks: Bricks) -> tuple[Any, ...]:
    return bricks.table, bricks.values, bricks.origin, 1.0 / bricks.voxel, bricks.shape


def _whole(*columns: Floats) -> list[Floats]:
    """Columns as kernels take them: one after another in memory, all of one kind."""
    return [np.ascontiguousarray(c, np.float64) for c in columns]


def _mix(a: Floats, b: Floats, t: Floats) -> Floats:
    return a + (b - a) * t


def _corners(bricks: Bricks, x: Floats, y: Floats, z: Floats) -> tuple[list[Floats], list[Floats]]:
    """Values at the corners of the cells that places lie in, and where in them, 0 .. 1. Places outside count as on the rim."""
    parts, nodes = [], []
    for axis, place in enumerate((x, y, z)):
        far = bricks.nodes[axis]
        # fmax and fmin take what is not a number to the rim.
        at = np.fmin(np.fmax((place - bricks.origin[axis]) * (1.0 / bricks.voxel), 0.0), far - 1.0)
        node = np.minimum(at.astype(np.int32), far - 2)
        parts.append(at - node)
        nodes.append(node)
    at = _place(bricks, nodes)
    local = [n & 15 for n in nodes]
    astride = np.flatnonzero((local[0] == 15) | (local[1] == 15) | (local[2] == 15))
    across = [n.take(astride) for n in nodes]
    found = []
    for corner, offset in enumerate(_OFFSETS):
        where = at + offset
        if astride.size:
            where[astride] = _place(bricks, [n + ((corner >> (2 - axis)) & 1) for axis, n in enumerate(across)])
        found.append(bricks.values.take(where).astype(np.float64))
    return found, parts


def _place(bricks: Bricks, nodes: list[NDArray[np.int32]]) -> Index:
    """Where the values of nodes are kept."""
    i, j, k = nodes
    slot = bricks.table.take(((i >> 4) * bricks.shape[1] + (j >> 4)) * bricks.shape[2] + (k >> 4)).astype(np.int64)
    where: Index = (slot << 12) + (((i & 15) << 8) + ((j & 15) << 4) + (k & 15))
    return where
