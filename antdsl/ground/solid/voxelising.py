"""From a closed mesh to bricks: which nodes are inside by the winding number along lines, how far by the nearest triangle."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.casting.rasterise import triangle_cells
from antdsl.ground.solid.bricks import AIR, CUBE, SIDE, SOLID, Bricks, Unusable
from antdsl.ground.solid.triangles import distances
from antdsl.ground.solid.winding import Shell, brick_signs

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

_IN, _OUT = 1.75, 4.0  # voxels of the band inside and outside; a cell that the surface crosses has corners within 1.733
_ASIDE = (0.37, 0.41, 0.43)  # voxels
_BLOCK = 4.0  # voxels
_ROOM = 24  # bytes of memory for each node near the surface while distances are found


def voxelise(vertices: Floats, faces: Index, voxel: float, cap: int) -> Bricks | Unusable:
    """As `Volume.from_mesh`."""
    if not (math.isfinite(voxel) and voxel > 0):
        return Unusable("the voxel is not a length greater than 0", "write a length, such as `voxel: 1 mm`")
    if not len(faces):
        return Unusable("the mesh has no faces", "name a closed mesh")
    corners = vertices[faces]
    if not np.isfinite(corners).all():
        return Unusable("the mesh has corners that are not finite numbers", "export the mesh again")
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    sides = (high - low) / voxel
    shape = tuple(math.ceil((float(side) + 2 * _OUT + 4.0) / SIDE) for side in sides)
    wanted = float(np.prod(sides + 1))
    # A thin sheet or a rod needs room for whole bricks.
    if wanted > cap or float(np.prod(shape)) * CUBE > 8.0 * cap:
        return _too_many(max(wanted, float(np.prod(shape)) * CUBE / 8), cap, voxel)
    # Not a whole number of voxels from the mesh: sides of a box would run through nodes, where the field has no clear slope.
    origin = low - (_OUT + 1.0 + np.array(_ASIDE)) * voxel
    corners = (corners - origin) / voxel
    shell = Shell(corners)
    if shell.open_edges:
        edges = "1 edge borders" if shell.open_edges == 1 else f"{shell.open_edges:,} edges border"
        return Unusable(f"the mesh is not closed: {edges} on nothing", "close its holes, so that it has an inside")
    bricks = Bricks(
        origin=origin,
        voxel=voxel,
        shape=shape,  # type: ignore[arg-type]
        least=-_IN * voxel,
        most=_OUT * voxel,
        table=np.zeros(math.prod(shape), np.int32),
        values=np.empty(0, np.float32),
        used=2,
    )
    near = _near(bricks, corners)
    if near.size * CUBE * _ROOM > limits.GRID_BYTES:
        return _too_many(float(near.size) * CUBE, limits.GRID_BYTES // _ROOM, voxel)
    _fill(bricks, shell, near, corners)
    bricks.begin()
    return bricks


def _too_many(wanted: float, cap: float, voxel: float) -> Unusable:
    least = voxel * max((wanted / cap) ** (1 / 3), 1.1)
    digits = 1 - math.floor(math.log10(least))
    size = math.ceil(least * 10**digits) / 10**digits
    return Unusable(f"{wanted:,.0f} voxels of {voxel:g} mm are more than {cap:,.0f}", f"take larger ones: `voxel: {size:g} mm`")


def _near(bricks: Bricks, corners: Floats) -> Index:
    """Bricks, ascending, that may have a node in the band: those that the band around a brick's triangles reaches."""
    grid = np.zeros(bricks.shape, bool)
    wide = _OUT + 1.0
    for cells, _ in triangle_cells(corners / _BLOCK):
        block = np.unique((cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2])
        at = np.stack([block >> 42, (block >> 21) & 0x1FFFFF, block & 0x1FFFFF], axis=1) * _BLOCK
        first = np.floor((at - wide) / SIDE).astype(np.int64).clip(0)
        last = np.floor((at + (_BLOCK + wide)) / SIDE).astype(np.int64)
        for ends in np.ndindex(2, 2, 2):
            i, j, k = (np.minimum((first, last)[e][:, axis], bricks.shape[axis] - 1) for axis, e in enumerate(ends))
            grid[i, j, k] = True
    return np.flatnonzero(grid)


def _fill(bricks: Bricks, shell: Shell, near: Index, corners: Floats) -> None:
    """Distances of the bricks near the surface, signs of all."""
    flags, inside = brick_signs(shell, bricks.shape, near)
    away = distances(bricks.shape, near, corners, _OUT).reshape(-1, CUBE)
    np.minimum(away, np.float32(_OUT), out=away)
    np.negative(away, out=away, where=inside)
    np.maximum(away, np.float32(-_IN), out=away)
    kept = np.flatnonzero((away != away[:, :1]).any(axis=1))
    bricks.table[:] = np.where(flags, SOLID, AIR)
    bricks.table[near[kept]] = np.arange(2, 2 + kept.size)
    bricks.values = np.empty((2 + kept.size) * CUBE, np.float32)
    pool = bricks.values.reshape(-1, CUBE)
    np.multiply(away[kept], np.float32(bricks.voxel), out=pool[2:])
    np.clip(pool[2:], np.float32(bricks.least), np.float32(bricks.most), out=pool[2:])
    pool[AIR], pool[SOLID] = bricks.most, bricks.least
    bricks.used = 2 + kept.size
