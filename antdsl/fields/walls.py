"""Fields on what was dug: the walls that a step's balls left become cells of every field that lies on the solid."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.growing import GrowingCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.ground.solid import Volume

Floats = NDArray[np.float64]

_NEAR = 0.5  # voxels: a point of a ball that lies no farther from the surface is on a wall that it left
_FINEST = 16  # points along an edge of the cube whose sides are spread over a ball


def grow(fields: Iterable[PheromoneField], volume: Volume, middle: Floats, radius: Floats) -> None:
    """Give fields on a solid cells where balls, middles [k,3] and radii [k] in mm, left walls. The order of the balls counts."""
    by_cells: dict[int, list[PheromoneField]] = {}
    for field in fields:
        if isinstance(field.cells, GrowingCells):
            by_cells.setdefault(id(field.cells), []).append(field)
    for sharing in by_cells.values():
        cells = sharing[0].cells
        assert isinstance(cells, GrowingCells)
        points, normals = walls(volume, middle, radius, cells.cell)
        new = cells.grow(points, normals)
        if len(new):
            for field in sharing:
                field.grow(new)


def walls(volume: Volume, middle: Floats, radius: Floats, apart: float) -> tuple[Floats, Floats]:
    """Points [n,3] about half of `apart` from each other on what balls left of the surface, and its unit normals into the air."""
    found = [(np.empty((0, 3)), np.empty((0, 3)))]
    lines = np.minimum(np.ceil(4 * radius / apart).astype(np.int64), _FINEST)
    for number in np.unique(lines):
        rows, ways = np.flatnonzero(lines == number), _ways(max(int(number), 1))
        points = (middle[rows, None, :] + radius[rows, None, None] * ways).reshape(-1, 3)
        near = np.flatnonzero(np.abs(volume.sample(points)) < _NEAR * volume.voxel)
        found.append((points[near], -np.broadcast_to(ways, (len(rows), *ways.shape)).reshape(-1, 3)[near]))
    points, normals = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return points, normals


@cache
def _ways(lines: int) -> Floats:
    """Unit vectors [6 lines², 3] spread over a sphere: the middles of the squares of a cube's sides."""
    at = (np.arange(lines) + 0.5) / lines * 2 - 1
    u, v = (w.ravel() for w in np.meshgrid(at, at, indexing="ij"))
    sides = [np.roll(np.stack([np.full(u.size, s), u, v], axis=1), axis, axis=1) for axis in range(3) for s in (-1.0, 1.0)]
    ways = np.concatenate(sides)
    unit: Floats = ways / np.sqrt((ways * ways).sum(axis=1))[:, None]
    return unit
