"""A kernel that finds the pheromone cell of each point. A cell is identified by the point's voxel and the side of its face."""

from typing import NamedTuple

import numpy as np

from antdsl.machine_code.kernels import BOOL, F64, I8, I32, I64, Array1, allocate_scratch, inlined, kernel, prefetch, simd_range
from antdsl.numerics.sorting import find_lower_bound

_PREFETCH_GROUP_SIZE = 64  # points with cells prefetched together


@inlined
def _find_voxel_along_axis(coordinate: F64, voxel_width: F64, lowest_voxel: I64, voxel_count: I64) -> I64:
    """Return the index of the voxel that contains `coordinate` (mm) along one axis of a box of voxels; -1 outside the box.

    `voxel_width`: the edge length of a voxel (mm). `lowest_voxel`, `voxel_count`: the first voxel of the box along this axis, and
    the number of voxels."""
    step = np.floor(coordinate / voxel_width + 0.5) - np.float64(lowest_voxel)
    if step >= 0.0 and step < np.float64(voxel_count):
        return np.int64(step)
    return -1


@inlined
def _find_cell_by_key(
    direct_table: Array1[I32], has_direct_table: BOOL, keys: Array1[I64], block_shift: I64, block_starts: Array1[I32], key: I64
) -> I64:
    """Return the cell with the key `key`, or -1 if there is none. The other arguments are fields of `VoxelCellIndex`."""
    if has_direct_table:
        return np.int64(direct_table[key])
    a = find_lower_bound(keys, key, np.int64(block_starts[key >> block_shift]), np.int64(block_starts[(key >> block_shift) + 1]))
    return a if a < keys.size and keys[a] == key else -1


class VoxelCellIndex(NamedTuple):
    """A lookup table for the cells in a box of voxels. A cell's key combines the number of its voxel with its side.

    `voxel_width`: in mm. `lowest_voxel`, `voxels_per_axis`: the first voxel of the box, and its number of voxels along each axis.
    `direct_table`: the cell of every key; empty if the box is too large for such a table. Then a key is searched in a block of
    `keys` by bisection. `keys`: the keys of the cells, ascending. `block_shift`: each block covers 2**shift keys. `block_starts`
    [blocks + 1]: the position of each block's first key in `keys`."""

    voxel_width: F64
    lowest_voxel: Array1[I64]
    voxels_per_axis: Array1[I64]
    direct_table: Array1[I32]
    keys: Array1[I64]
    block_shift: I64
    block_starts: Array1[I32]


@kernel
def update_cell_lookups(
    points: tuple[Array1[F64], Array1[F64], Array1[F64]],
    sides: Array1[I8],
    index: VoxelCellIndex,
    previous_keys: Array1[I64],
    previous_cells: Array1[I32],
    cells: Array1[I32],
    begin: I64,
    end: I64,
) -> I64:
    """Write the cell of each point to `cells` [n], -1 for none. Return how many points have no cell. Points from `begin` to
    before `end` are processed. `points`: x, y, z [n] mm. `sides` [n]: the side of the face under each point. `previous_keys`
    [n]: the key of each point at the previous call, -1 outside the box; it is updated. `previous_cells` [n]: the cell of each
    point at the previous call; it is updated."""
    cell, box, size, direct, keys, shift, start = index
    has_direct_table = direct.size > 0
    point_keys, is_changed, others = (
        allocate_scratch(_PREFETCH_GROUP_SIZE, I64),
        allocate_scratch(_PREFETCH_GROUP_SIZE, I64),
        allocate_scratch(_PREFETCH_GROUP_SIZE, I64),
    )
    missing_count = 0
    for low in range(begin, end, _PREFETCH_GROUP_SIZE):
        high = min(low + _PREFETCH_GROUP_SIZE, end)
        for n in simd_range(low, high):
            x = _find_voxel_along_axis(points[0][n], cell, box[0], size[0])
            y = _find_voxel_along_axis(points[1][n], cell, box[1], size[1])
            z = _find_voxel_along_axis(points[2][n], cell, box[2], size[2])
            key = -1
            if x >= 0 and y >= 0 and z >= 0:
                key = ((x * size[1] + y) * size[2] + z) * 6 + sides[n]
            point_keys[n - low] = key
            is_changed[n - low] = 1 if key != previous_keys[n] or previous_cells[n] < 0 else 0
        count = 0
        for n in range(low, high):
            others[count] = n
            count += is_changed[n - low]
        for k in range(count):
            key = max(point_keys[others[k] - low], 0)
            if has_direct_table:
                prefetch(direct, key)
            else:
                prefetch(start, key >> shift)
        if not has_direct_table:
            for k in range(count):
                prefetch(keys, start[max(point_keys[others[k] - low], 0) >> shift])
        for k in range(count):
            n = others[k]
            key = point_keys[n - low]
            previous_keys[n] = key
            previous_cells[n] = _find_cell_by_key(direct, has_direct_table, keys, shift, start, key) if key >= 0 else -1
            missing_count += 1 if previous_cells[n] < 0 else 0
        for n in simd_range(low, high):
            cells[n] = previous_cells[n]
    return missing_count
