"""From a closed mesh to bricks: which nodes are inside by the winding number along lines, how far by the nearest triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.rasterise import triangle_cells
from antdsl.runtime.senses.rays import RayScene
from antdsl.runtime.solids.bricks import AIR, CUBE, SIDE, SOLID, Bricks, Unusable

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

_IN, _OUT = 2.0, 4.0  # voxels of the band inside and outside
_GRAIN = 65536.0  # parts of a voxel to which corners are rounded to decide sides exactly


def voxelise(vertices: Floats, faces: Index, voxel: float, cap: int) -> Bricks | Unusable:
    """As `Volume.from_mesh`."""
    if not (np.isfinite(voxel) and voxel > 0):
        return Unusable("the voxel is not a length greater than 0", "write a length, such as `voxel: 1 mm`")
    if not len(faces) or not len(vertices):
        return Unusable("the mesh has no faces", "name a closed mesh")
    used = vertices[faces.ravel()]
    if not np.isfinite(used).all():
        return Unusable("the mesh has corners that are not finite numbers", "export the mesh again")
    low, high = used.min(axis=0), used.max(axis=0)
    wanted = float(np.prod((high - low) / voxel + 1))
    if wanted > cap:
        least = voxel * (wanted / cap) ** (1 / 3)
        return Unusable(f"{wanted:,.0f} voxels are more than {cap:,}", f"take larger voxels, such as {least:.2g} mm")
    origin = low - (_OUT + 1.0) * voxel
    shape = tuple(int(n) for n in np.ceil(((high - origin) / voxel + _OUT + 2.0) / SIDE))
    corners = (vertices[faces] - origin) / voxel
    if _open_edges(corners):
        return Unusable(f"the mesh is not closed: {_open_edges(corners):,} edges border on air", "close its holes")
    bricks = Bricks(
        origin, voxel, shape, -_IN * voxel, _OUT * voxel, np.zeros(int(np.prod(shape)), np.int32), np.empty(0, np.float32), 2
    )
    _fill(bricks, vertices, faces, corners)
    bricks.begin()
    return bricks


def _rounded(corners: Floats) -> Index:
    return np.round(corners * _GRAIN).astype(np.int64)


def _open_edges(corners: Floats) -> int:
    """Edges where an odd number of faces meet."""
    names = np.unique(_rounded(corners).reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    a, b = names.ravel(), names[:, [1, 2, 0]].ravel()
    real = a != b
    pair = np.minimum(a, b)[real] * (names.max() + 1) + np.maximum(a, b)[real]
    return int((np.unique(pair, return_counts=True)[1] % 2).sum())


def _near(bricks: Bricks, corners: Floats) -> NDArray[np.bool_]:
    """Bricks with a node in the band."""
    grid = np.zeros(bricks.shape, bool)
    wide = int(_OUT) + 1
    for cell, _ in triangle_cells(corners, exact=False):
        first, last = (cell - wide) // SIDE, (cell + 1 + wide) // SIDE
        for x in (first, last):
            for y in (first, last):
                for z in (first, last):
                    grid[x[:, 0].clip(0), y[:, 1].clip(0), z[:, 2].clip(0)] = True
    return grid


def _fill(bricks: Bricks, vertices: Floats, faces: Index, corners: Floats) -> None:
    inside = _inside(bricks, corners)
    near = np.flatnonzero(_near(bricks, corners).ravel())
    middle = inside.reshape(bricks.shape[0], SIDE, bricks.shape[1], SIDE, bricks.shape[2], SIDE)[:, 0, :, 0, :, 0].ravel()
    bricks.table[:] = np.where(middle, SOLID, AIR)
    bricks.values = np.empty((2 + near.size) * CUBE, np.float32)
    pool = bricks.values.reshape(-1, CUBE)
    pool[AIR], pool[SOLID] = bricks.most, bricks.least
    scene = RayScene(vertices, faces.astype(np.int32))
    local = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    kept = 0
    for brick in near:
        nodes = np.stack(np.unravel_index(brick, bricks.shape)) * SIDE + local
        away = scene.closest(bricks.origin + nodes * bricks.voxel)[3]
        signed = np.where(inside[nodes[:, 0], nodes[:, 1], nodes[:, 2]], -away, away)
        signed = np.clip(signed, bricks.least, bricks.most).astype(np.float32)
        if (signed != signed[0]).any():
            pool[2 + kept] = signed
            bricks.table[brick] = 2 + kept
            kept += 1
    bricks.used = 2 + kept


def _inside(bricks: Bricks, corners: Floats) -> NDArray[np.bool_]:
    """Which nodes are inside, by the parity of crossings below them along the last axis."""
    nodes = bricks.nodes
    tri = _rounded(corners)
    crossings = np.zeros(nodes, np.int8)
    low = np.ceil(tri.min(axis=1) / _GRAIN).astype(np.int64)
    high = np.floor(tri.max(axis=1) / _GRAIN).astype(np.int64) + 1
    for t in range(len(tri)):
        x, y = (g.ravel() for g in np.meshgrid(np.arange(low[t, 0], high[t, 0]), np.arange(low[t, 1], high[t, 1]), indexing="ij"))
        weights = [_side(tri[t, a], tri[t, b], x, y) for a, b in ((1, 2), (2, 0), (0, 1))]
        sign = np.stack([w[0] for w in weights])
        hit = (sign > 0).all(axis=0) | (sign < 0).all(axis=0)
        x, y = x[hit], y[hit]
        w = np.stack([w[1][hit] for w in weights]).astype(np.float64)
        total = w.sum(axis=0)
        z = (w * tri[t, :, 2, None]).sum(axis=0) / np.where(total == 0, 1, total) / _GRAIN
        np.add.at(crossings, (x, y, np.floor(z).astype(np.int64) + 1), 1)
    return np.cumsum(crossings, axis=2, dtype=np.int8) % 2 == 1


def _side(a: Index, b: Index, x: Index, y: Index) -> tuple[Index, Index]:
    """On which side of the line a-b places (x, y) lie, never 0 (as if they were moved by next to nothing), and the area."""
    px, py = x * int(_GRAIN), y * int(_GRAIN)
    area = (b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0])
    tie = -np.sign(b[1] - a[1]) if b[1] != a[1] else np.sign(b[0] - a[0])
    return np.where(area == 0, tie, np.sign(area)), area
