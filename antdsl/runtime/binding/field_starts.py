"""Finds the cells in which a scene starts a field, and the values that they get."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from antdsl.casting.rasterise import iterate_triangle_cells
from antdsl.fields.cells import SurfaceCells
from antdsl.ground.protocol import Flags, Floats, Index
from antdsl.scene.setting import FieldGridData, FieldStartData, MeshData

if TYPE_CHECKING:
    from antdsl.runtime.world import World

_EDGE_TOLERANCE = 1e-9  # share of a sample or of a width; exceeds the rounding of positions


def find_start_values(
    world: World, cells: SurfaceCells, start: FieldStartData | FieldGridData, meshes: Mapping[str, MeshData]
) -> tuple[Index, Floats]:
    """Return the cells that a starting value of a field reaches, ascending, and the value of each.

    Values have the type float64[cells], or float64[cells, 3] for fields of vectors.
    `meshes`: the surfaces of the field. Positions are relative to the world's origin."""
    chosen = np.ones(len(cells), np.bool_)
    if start.on is not None and start.on in meshes:
        chosen = _find_cells_on(cells, meshes[start.on])
    if isinstance(start, FieldGridData):
        reached = meshes if start.on is None else {name: mesh for name, mesh in meshes.items() if name == start.on}
        rows, columns, is_inside = _find_samples(world, cells, start, reached)
        cell_rows = np.flatnonzero(chosen & is_inside)
        return cell_rows, start.values[rows[cell_rows], columns[cell_rows]]
    if start.around is not None:
        away = cells.compute_offsets(cells.position, np.asarray([start.around], np.float64) - world.origin)
        distance = np.sqrt((away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1]) + away[:, 2] * away[:, 2])
        chosen &= distance <= (np.inf if start.radius is None else start.radius)
    cell_rows = np.flatnonzero(chosen)
    return cell_rows, np.full((len(cell_rows), *np.shape(start.value)), start.value, np.float64)


def _find_cells_on(cells: SurfaceCells, mesh: MeshData) -> Flags:
    """Return a mask of the cells that a mesh touches with its own sides."""
    is_touched = np.zeros(len(cells), np.bool_)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    has_area = (normals != 0).any(axis=1)
    corners, normals = corners[has_area], normals[has_area]
    for voxel, face in iterate_triangle_cells(corners / cells.cell + 0.5):
        cell_rows = cells.find_cells(voxel.astype(np.float64) * cells.cell, normals[face])
        is_touched[cell_rows[cell_rows >= 0]] = True
    return is_touched


def _find_samples(
    world: World, cells: SurfaceCells, grid: FieldGridData, meshes: Mapping[str, MeshData]
) -> tuple[Index, Index, Flags]:
    """Return the row and the column of the sample over each cell, and a mask of the cells below the grid.

    Columns go along +x. Seen from above, with +x to the right, rows go down. A sample covers a rectangle of the grid: cells with
    their middle in it have the same value."""
    points = [mesh.vertices for mesh in meshes.values() if len(mesh.vertices)]
    if not points:
        none = np.zeros(len(cells), np.int64)
        return none, none, np.zeros(len(cells), np.bool_)
    low, high = np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)
    box = None if world.periodic is None else world.periodic.box
    if box is not None:
        for axis in box.axes:
            low[axis], high[axis] = box.low[axis], box.low[axis] + box.widths[axis]
    down = 2 if world.setting.up[1] else 1  # the axis of the rows; they go along +z, or along -y if z points up
    is_inside, indices = np.ones(len(cells), np.bool_), []
    for k, (axis, count) in enumerate(((down, grid.values.shape[0]), (0, grid.values.shape[1]))):
        sign = -1.0 if axis == 1 else 1.0
        extent = float(high[axis] - low[axis]) if grid.extent is None else grid.extent[1 - k]
        centre = (low[axis] + high[axis]) / 2 if grid.centre is None else grid.centre[axis] - world.origin[axis]
        # the middle of the cell, which does not depend on how the surface is cut into triangles
        middle = np.clip(np.floor(cells.position[:, axis] / cells.cell + 0.5) * cells.cell, low[axis], high[axis])
        along = sign * (middle - centre) + extent / 2
        if box is not None and axis in box.axes:
            width = box.widths[axis]
            along = along - np.floor(along / width + _EDGE_TOLERANCE) * width
        is_inside &= (along >= -_EDGE_TOLERANCE * extent) & (along <= extent * (1 + _EDGE_TOLERANCE))
        share = along / extent * count if extent else np.zeros(len(cells))  # a flat wall has no extent along one axis
        indices.append(np.clip(np.floor(share + _EDGE_TOLERANCE), 0, count - 1).astype(np.int64))
    return indices[0], indices[1], is_inside
