"""Converts a closed mesh to bricks of signed distances.

The winding number decides whether a node is inside. It is counted along grid lines: each crossed triangle adds or subtracts 1.
The nearest triangle gives the distance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.casting.rasterise import iterate_triangle_cells
from antdsl.ground.solid.bricks import (
    AIR_BRICK_SLOT,
    NODES_PER_BRICK,
    NODES_PER_BRICK_SIDE,
    SOLID_BRICK_SLOT,
    BrickGrid,
    UnusableMeshReason,
)
from antdsl.ground.solid.triangles import compute_node_distances, iterate_lattice_points
from antdsl.scene.geometry.closed_meshes import count_open_edges_and_sides, round_to_voxels

_PAIRS_PER_CHUNK = 1 << 16  # pairs of a triangle and a line per chunk
Floats = NDArray[np.float64]
Index = NDArray[np.int64]

# Width of the band in voxels, inside and outside; corners of a cell that the surface crosses are within 1.733
_INNER_BAND_VOXELS, _OUTER_BAND_VOXELS = 1.75, 4.0
_RAY_OFFSETS_VOXELS = (0.37, 0.41, 0.43)  # offset of the grid, so that sides of a box do not pass through nodes
_BLOCK_WIDTH_VOXELS = 4.0  # voxels
_BYTES_PER_NEAR_NODE = 24  # memory in bytes for each node near the surface during conversion


def voxelise_mesh(vertices: Floats, faces: Index, voxel: float, cap: int) -> BrickGrid | UnusableMeshReason:
    """Return the solid inside a closed mesh. Same as `Volume.from_mesh`."""
    if not (math.isfinite(voxel) and voxel > 0):
        return UnusableMeshReason("the voxel size must be greater than 0", "write a length, such as `voxel: 1 mm`")
    if not len(faces):
        return UnusableMeshReason("the mesh has no faces", "name a closed mesh")
    corners = vertices[faces]
    if not np.isfinite(corners).all():
        return UnusableMeshReason("the mesh has corners that are not finite numbers", "export the mesh again")
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    sides = (high - low) / voxel
    shape = tuple(math.ceil((float(side) + 2 * _OUTER_BAND_VOXELS + 4.0) / NODES_PER_BRICK_SIDE) for side in sides)
    voxel_count = float(np.prod(sides + 1))
    # A thin sheet or a rod still needs complete bricks.
    if voxel_count > cap or float(np.prod(shape)) * NODES_PER_BRICK > 8.0 * cap:
        return _describe_too_many_voxels(max(voxel_count, float(np.prod(shape)) * NODES_PER_BRICK / 8), cap, voxel)
    # Offset from the mesh by a fraction of a voxel: otherwise sides of a box pass through nodes, where the gradient is ambiguous.
    origin = low - (_OUTER_BAND_VOXELS + 1.0 + np.array(_RAY_OFFSETS_VOXELS)) * voxel
    corners = (corners - origin) / voxel
    shell = TriangleShell(corners)
    if shell.open_edges:
        edges = "1 edge belongs" if shell.open_edges == 1 else f"{shell.open_edges:,} edges belong"
        return UnusableMeshReason(
            f"the mesh is not closed: {edges} to only one face", "close the holes of the mesh, so that it has an inside"
        )
    bricks = BrickGrid(
        origin=origin,
        voxel=voxel,
        shape=shape,  # type: ignore[arg-type]
        min_distance=-_INNER_BAND_VOXELS * voxel,
        max_distance=_OUTER_BAND_VOXELS * voxel,
        table=np.zeros(math.prod(shape), np.int32),
        values=np.empty(0, np.float32),
        used_slots=2,
    )
    near = _find_near_bricks(bricks, corners)
    if near.size * NODES_PER_BRICK * _BYTES_PER_NEAR_NODE > limits.MAX_GRID_BYTES:
        return _describe_too_many_voxels(float(near.size) * NODES_PER_BRICK, limits.MAX_GRID_BYTES // _BYTES_PER_NEAR_NODE, voxel)
    _write_brick_distances(bricks, shell, near, corners)
    bricks.record_start_values()
    return bricks


def _describe_too_many_voxels(voxel_count: float, cap: float, voxel: float) -> UnusableMeshReason:
    """Return the reason that a mesh has too many voxels, with a suggested voxel size."""
    least = voxel * max((voxel_count / cap) ** (1 / 3), 1.1)
    digits = 1 - math.floor(math.log10(least))
    size = math.ceil(least * 10**digits) / 10**digits
    return UnusableMeshReason(
        f"{voxel_count:,.0f} voxels of {voxel:g} mm are more than the limit of {cap:,.0f}",
        f"write larger voxels: `voxel: {size:g} mm`",
    )


def _find_near_bricks(bricks: BrickGrid, corners: Floats) -> Index:
    """Return the bricks that may have a node in the band around the triangles, in ascending order."""
    grid = np.zeros(bricks.shape, bool)
    wide = _OUTER_BAND_VOXELS + 1.0
    for cells, _ in iterate_triangle_cells(corners / _BLOCK_WIDTH_VOXELS):
        block = np.unique((cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2])
        at = np.stack([block >> 42, (block >> 21) & 0x1FFFFF, block & 0x1FFFFF], axis=1) * _BLOCK_WIDTH_VOXELS
        first = np.floor((at - wide) / NODES_PER_BRICK_SIDE).astype(np.int64).clip(0)
        last = np.floor((at + (_BLOCK_WIDTH_VOXELS + wide)) / NODES_PER_BRICK_SIDE).astype(np.int64)
        for ends in np.ndindex(2, 2, 2):
            i, j, k = (np.minimum((first, last)[e][:, axis], bricks.shape[axis] - 1) for axis, e in enumerate(ends))
            grid[i, j, k] = True
    return np.flatnonzero(grid)


def _write_brick_distances(bricks: BrickGrid, shell: TriangleShell, near_bricks: Index, corners: Floats) -> None:
    """Write the distances of the nodes in bricks near the surface. Set all other bricks to air or undug solid."""
    flags, inside = compute_brick_signs(shell, bricks.shape, near_bricks)
    away = compute_node_distances(bricks.shape, near_bricks, corners, _OUTER_BAND_VOXELS).reshape(-1, NODES_PER_BRICK)
    np.minimum(away, np.float32(_OUTER_BAND_VOXELS), out=away)
    np.negative(away, out=away, where=inside)
    np.maximum(away, np.float32(-_INNER_BAND_VOXELS), out=away)
    mixed_bricks = np.flatnonzero((away != away[:, :1]).any(axis=1))
    bricks.table[:] = np.where(flags, SOLID_BRICK_SLOT, AIR_BRICK_SLOT)
    bricks.table[near_bricks[mixed_bricks]] = np.arange(2, 2 + mixed_bricks.size)
    bricks.values = np.empty((2 + mixed_bricks.size) * NODES_PER_BRICK, np.float32)
    pool = bricks.values.reshape(-1, NODES_PER_BRICK)
    np.multiply(away[mixed_bricks], np.float32(bricks.voxel), out=pool[2:])
    np.clip(pool[2:], np.float32(bricks.min_distance), np.float32(bricks.max_distance), out=pool[2:])
    pool[AIR_BRICK_SLOT], pool[SOLID_BRICK_SLOT] = bricks.max_distance, bricks.min_distance
    bricks.used_slots = 2 + mixed_bricks.size


class TriangleShell:
    """A mesh with integer coordinates, which make tests of the side of a line exact. It is built from corners float64[n,3,3] in
    voxels."""

    def __init__(self, corners: Floats) -> None:
        self.corners, self.units_per_voxel = round_to_voxels(corners)
        self.open_edges, self.has_consistent_winding = count_open_edges_and_sides(self.corners)


def compute_brick_signs(
    shell: TriangleShell, shape: tuple[int, int, int], near_bricks: Index
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return two masks: whether the first node of each brick is inside, and whether each node of the bricks `near_bricks`
    (ascending) is inside, bool[bricks, 4096].

    A node is inside if its winding number is not 0; if faces have inconsistent winding, the number must be odd."""
    x, y, z, windings = _find_line_crossings(shell)
    nodes = [n * NODES_PER_BRICK_SIDE for n in shape]
    slab = x >> 4
    order = np.argsort(slab, kind="stable")
    place = (((x & 15) * nodes[1] + y) * nodes[2] + z)[order]
    windings = windings[order]
    ends = np.searchsorted(slab[order], np.arange(shape[0] + 1))
    flags = np.zeros(shape, bool)
    inside = np.zeros((near_bricks.size, NODES_PER_BRICK), bool)
    per_slab = shape[1] * shape[2]
    parts = np.searchsorted(near_bricks, np.arange(shape[0] + 1) * per_slab)
    count = np.zeros(NODES_PER_BRICK_SIDE * nodes[1] * nodes[2], np.int16)
    for s in range(shape[0]):
        count[:] = 0
        np.add.at(count, place[ends[s] : ends[s + 1]], windings[ends[s] : ends[s + 1]])
        wound = np.cumsum(count.reshape(NODES_PER_BRICK_SIDE * nodes[1], nodes[2]), axis=1, dtype=np.int16)
        within = (wound != 0 if shell.has_consistent_winding else wound % 2 != 0).reshape(
            NODES_PER_BRICK_SIDE, shape[1], NODES_PER_BRICK_SIDE, shape[2], NODES_PER_BRICK_SIDE
        )
        flags[s] = within[0, :, 0, :, 0]
        chosen = near_bricks[parts[s] : parts[s + 1]] - s * per_slab
        inside[parts[s] : parts[s + 1]] = within[:, chosen // shape[2], :, chosen % shape[2], :].reshape(
            chosen.size, NODES_PER_BRICK
        )
    return flags.ravel(), inside


def _find_line_crossings(shell: TriangleShell) -> tuple[Index, Index, Index, NDArray[np.int16]]:
    """Return the crossings of triangles with grid lines along the last axis: the coordinates of the lines and nodes, and the
    change of the winding number."""
    tri = shell.corners
    grain = shell.units_per_voxel
    low = -((-tri.min(axis=1)) // grain)
    count = tri.max(axis=1) // grain - low + 1
    crossings = [
        _find_crossings_in_batch(tri, grain, *box) for box in iterate_lattice_points(low[:, :2], count[:, :2], _PAIRS_PER_CHUNK)
    ]
    if not crossings:
        none = np.empty(0, np.int64)
        return none, none, none, np.empty(0, np.int16)
    x, y, z, windings = (np.concatenate(parts) for parts in zip(*crossings, strict=True))
    return x, y, z, windings


def _find_crossings_in_batch(
    tri: Index, units_per_voxel: int, t: Index, x: Index, y: Index
) -> tuple[Index, Index, Index, NDArray[np.int16]]:
    """Return the crossings of triangles with grid lines, in the form of `_find_line_crossings`. Each pair of a triangle `t` and a
    grid line `x`, `y` is tested."""
    px, py = x * units_per_voxel, y * units_per_voxel
    areas, above, below = [], np.ones(t.size, bool), np.ones(t.size, bool)
    for i, j in ((1, 2), (2, 0), (0, 1)):
        ax, ay, bx, by = tri[t, i, 0], tri[t, i, 1], tri[t, j, 0], tri[t, j, 1]
        area = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        # Lines are treated as shifted by an infinitesimal distance along x, and a smaller one along y, so none meets the end of
        # an edge.
        tie = np.where(by != ay, ay - by, bx - ax)
        side = np.where(area != 0, area, tie)
        above &= side > 0
        below &= side < 0
        areas.append(area)
    hit = np.flatnonzero(above | below)
    weight = [area[hit].astype(np.float64) for area in areas]
    total = (weight[0] + weight[1]) + weight[2]
    t = t[hit]
    height = (weight[0] * tri[t, 0, 2] + weight[1] * tri[t, 1, 2]) + weight[2] * tri[t, 2, 2]
    level = np.floor(height / (total * units_per_voxel)).astype(np.int64) + 1
    return x[hit], y[hit], level, np.where(above[hit], 1, -1).astype(np.int16)
