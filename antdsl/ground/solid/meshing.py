"""The zero level as triangles, brick by brick, by marching cubes; neighbouring pieces share the coordinates of their seam."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import CUBE, SIDE, Bricks

Piece = tuple[int, NDArray[np.float64], NDArray[np.int32]]

_GRAIN = 4096.0  # parts of a voxel to which vertices are rounded, so that both sides of a seam have the same


def surface(bricks: Bricks, changed_only: bool) -> Iterator[Piece]:
    """As `Volume.surface`."""
    asked = np.flatnonzero(bricks.fresh) if changed_only else np.arange(bricks.table.size)
    if not changed_only:
        asked = np.flatnonzero(_reaching(bricks))
    for brick in asked:
        bricks.fresh[brick] = False
        yield _piece(bricks, int(brick))


def _reaching(bricks: Bricks) -> NDArray[np.bool_]:
    """Bricks whose cells touch a node that is stored."""
    stored = (bricks.table >= 2).reshape(bricks.shape)
    reach = stored.copy()
    for axis in range(3):
        moved = np.zeros_like(reach)
        ahead: list[slice] = [slice(None)] * 3
        behind: list[slice] = [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        moved[tuple(behind)] = reach[tuple(ahead)]
        reach |= moved
    return reach.ravel()


def cells(bricks: Bricks, brick: int) -> NDArray[np.float32]:
    """Values (17, 17, 17) at the corners of a brick's cells; fewer at the grid's end."""
    at = np.unravel_index(brick, bricks.shape)
    pool = bricks.values.reshape(-1, CUBE)
    sizes = [SIDE + (1 if at[axis] + 1 < bricks.shape[axis] else 0) for axis in range(3)]
    result = np.empty(sizes, np.float32)
    table = bricks.table.reshape(bricks.shape)
    for a in range(2):
        for b in range(2):
            for c in range(2):
                into = tuple(slice(SIDE * d, SIDE + d * (sizes[axis] - SIDE)) for axis, d in enumerate((a, b, c)))
                if result[into].size:
                    block = pool[table[at[0] + a, at[1] + b, at[2] + c]].reshape(SIDE, SIDE, SIDE)
                    result[into] = block[tuple(slice(0, s.stop - s.start) for s in into)]
    return result


def _piece(bricks: Bricks, brick: int) -> Piece:
    from skimage.measure import marching_cubes

    values = cells(bricks, brick)
    if not (values.min() < 0 < values.max()):
        return brick, np.empty((0, 3)), np.empty((0, 3), np.int32)
    cut: Any = marching_cubes
    vertices, faces, _, _ = cut(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    corner = np.stack(np.unravel_index(brick, bricks.shape)).astype(np.float64) * SIDE
    places = np.round(vertices.astype(np.float64) * _GRAIN) / _GRAIN + corner
    return brick, bricks.origin + places * bricks.voxel, np.ascontiguousarray(faces, np.int32)
