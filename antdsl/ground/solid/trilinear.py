"""Interpolates the distance field between nodes, in float64. The field is trilinear in each cell and continuous everywhere, and
its gradient is exact. Points are projected onto the zero level by Newton steps of limited length along the gradient. Where the
field is flat, these steps follow a hint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.bricks import BrickGrid
from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, Array2, inlined, kernel, kernel_helper
from antdsl.numerics.kernel_vectors import Vec3, dot

SURFACE_TOLERANCE_VOXELS = 1e-5  # voxels; the resolution of float32 distances
MAX_PROJECTION_STEPS = 60
MIN_SQUARED_GRADIENT = 0.01  # squared length; a shorter gradient gives no direction
Floats = NDArray[np.float64]
BrickTables = tuple[
    Array1[I32], Array1[F32], F64, F64, F64, F64, I64, I64, I64
]  # table, values, origin, voxel and shape of bricks
PointColumns64 = tuple[Array1[F64], Array1[F64], Array1[F64]]

SMOOTH_NORMAL_REACH_VOXELS = 0.5  # voxels to both sides over which the smooth gradient is measured if there is no body


def make_brick_tables(bricks: BrickGrid) -> tuple[Any, ...]:
    """Return the tables of bricks that kernels read."""
    return bricks.table, bricks.values, *bricks.origin, bricks.voxel, *bricks.shape


def sample_distances(bricks: BrickGrid, x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the signed distances (mm) at positions (mm)."""
    signed_distances = np.empty(len(x))
    write_distances(make_brick_tables(bricks), _make_columns_contiguous(x, y, z), signed_distances)
    return signed_distances


def sample_with_gradients(bricks: BrickGrid, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the signed distances (mm) at positions (mm), and the x, y and z of their gradients."""
    d, gx, gy, gz = np.empty((4, len(x)))
    write_distance_and_gradient(make_brick_tables(bricks), _make_columns_contiguous(x, y, z), d, (gx, gy, gz))
    return d, gx, gy, gz


def sample_smooth_gradients(
    bricks: BrickGrid, x: Floats, y: Floats, z: Floats, reach_voxels: float = SMOOTH_NORMAL_REACH_VOXELS
) -> list[Floats]:
    """Return gradients that vary smoothly, unlike the exact gradients. Along each axis, they are central differences over
    `reach_voxels` voxels on either side."""
    a = reach_voxels * bricks.voxel
    scale = 0.5 / a
    return [
        (sample_distances(bricks, x + a, y, z) - sample_distances(bricks, x - a, y, z)) * scale,
        (sample_distances(bricks, x, y + a, z) - sample_distances(bricks, x, y - a, z)) * scale,
        (sample_distances(bricks, x, y, z + a) - sample_distances(bricks, x, y, z - a)) * scale,
    ]


def _make_columns_contiguous(*columns: Floats) -> list[Floats]:
    """Return columns in the form that kernels need: contiguous in memory, and all of the same type."""
    return [np.ascontiguousarray(c, np.float64) for c in columns]


@kernel
def write_distances(bricks: BrickTables, positions: PointColumns64, signed_distances: Array1[F64]) -> None:
    """Write the signed distances at points to `signed_distances`."""
    x, y, z = positions
    for n in range(signed_distances.size):
        signed_distances[n] = interpolate_distance(bricks[0], bricks[1], bricks[2:], (x[n], y[n], z[n]))


@kernel
def write_distance_and_gradient(bricks: BrickTables, positions: PointColumns64, d: Array1[F64], gradient: PointColumns64) -> None:
    """Write the signed distances at points to `d`, and the gradients to `gradient`."""
    x, y, z = positions
    gx, gy, gz = gradient
    for n in range(d.size):
        d[n], (gx[n], gy[n], gz[n]) = interpolate_distance_and_gradient(bricks[0], bricks[1], bricks[2:], (x[n], y[n], z[n]))


@kernel_helper
def compute_smooth_gradient(
    table: Array1[I32], values: Array1[F32], grid: tuple[F64, F64, F64, F64, I64, I64, I64], reach_voxels: F64, p: Vec3
) -> Vec3:
    """Return the gradient at one position, as defined by `sample_smooth_gradients`."""
    a = reach_voxels * grid[3]
    scale = 0.5 / a
    x, y, z = p
    return (
        (interpolate_distance(table, values, grid, (x + a, y, z)) - interpolate_distance(table, values, grid, (x - a, y, z)))
        * scale,
        (interpolate_distance(table, values, grid, (x, y + a, z)) - interpolate_distance(table, values, grid, (x, y - a, z)))
        * scale,
        (interpolate_distance(table, values, grid, (x, y, z + a)) - interpolate_distance(table, values, grid, (x, y, z - a)))
        * scale,
    )


@inlined
def _clamp_to_node(place: F64, low: F64, inverse_voxel: F64, nodes: I64) -> tuple[I64, F64]:
    """Return the index of the node below a point along one axis, and the offset of the point from this node, in voxels."""
    at = (place - low) * inverse_voxel
    at = at if at >= 0.0 else 0.0
    at = min(at, nodes - 1.0)
    node = min(np.int64(at), nodes - 2)
    return node, at - node


@inlined
def load_cell_corners(
    table: Array1[I32], values: Array1[F32], grid: tuple[F64, F64, F64, F64, I64, I64, I64], p: Vec3
) -> tuple[tuple[F64, F64, F64, F64], tuple[F64, F64, F64, F64], Vec3]:
    """Return the values at the corners of the cell around a point, and the position of the point in the cell, from 0 to 1.

    The first four values are at the lower x, the other four at the upper x. A point outside the grid, or with NaN, is moved to
    the border of the grid."""
    over = 1.0 / grid[3]
    i, fx = _clamp_to_node(p[0], grid[0], over, grid[4] * 16)
    j, fy = _clamp_to_node(p[1], grid[1], over, grid[5] * 16)
    k, fz = _clamp_to_node(p[2], grid[2], over, grid[6] * 16)
    i1, j1, k1 = i + 1, j + 1, k + 1
    bx0, bx1 = (i >> 4) * grid[5] * grid[6], (i1 >> 4) * grid[5] * grid[6]
    by0, by1 = (j >> 4) * grid[6], (j1 >> 4) * grid[6]
    bz0, bz1 = k >> 4, k1 >> 4
    x0, x1, y0, y1, z0, z1 = (i & 15) << 8, (i1 & 15) << 8, (j & 15) << 4, (j1 & 15) << 4, k & 15, k1 & 15
    return (
        (
            _load_node_value(table, values, bx0 + by0 + bz0, x0 + y0 + z0),
            _load_node_value(table, values, bx0 + by0 + bz1, x0 + y0 + z1),
            _load_node_value(table, values, bx0 + by1 + bz0, x0 + y1 + z0),
            _load_node_value(table, values, bx0 + by1 + bz1, x0 + y1 + z1),
        ),
        (
            _load_node_value(table, values, bx1 + by0 + bz0, x1 + y0 + z0),
            _load_node_value(table, values, bx1 + by0 + bz1, x1 + y0 + z1),
            _load_node_value(table, values, bx1 + by1 + bz0, x1 + y1 + z0),
            _load_node_value(table, values, bx1 + by1 + bz1, x1 + y1 + z1),
        ),
        (fx, fy, fz),
    )  # fmt: skip


@inlined
def _load_node_value(table: Array1[I32], values: Array1[F32], brick: I64, place: I64) -> F64:
    return np.float64(values[(table[brick] << 12) + place])


@inlined
def interpolate_distance(table: Array1[I32], values: Array1[F32], grid: tuple[F64, F64, F64, F64, I64, I64, I64], p: Vec3) -> F64:
    """Return the signed distance (mm) at a position (mm)."""
    a, b, f = load_cell_corners(table, values, grid, p)
    v00, v01 = a[0] + (a[1] - a[0]) * f[2], a[2] + (a[3] - a[2]) * f[2]
    v10, v11 = b[0] + (b[1] - b[0]) * f[2], b[2] + (b[3] - b[2]) * f[2]
    v0, v1 = v00 + (v01 - v00) * f[1], v10 + (v11 - v10) * f[1]
    return v0 + (v1 - v0) * f[0]


@kernel_helper
def interpolate_distance_and_gradient(
    table: Array1[I32], values: Array1[F32], grid: tuple[F64, F64, F64, F64, I64, I64, I64], p: Vec3
) -> tuple[F64, Vec3]:
    """Return the signed distance (mm) at a position (mm), and its gradient."""
    a, b, f = load_cell_corners(table, values, grid, p)
    d00, d01, d10, d11 = a[1] - a[0], a[3] - a[2], b[1] - b[0], b[3] - b[2]
    v00, v01, v10, v11 = a[0] + d00 * f[2], a[2] + d01 * f[2], b[0] + d10 * f[2], b[2] + d11 * f[2]
    e0, e1 = v01 - v00, v11 - v10
    v0, v1 = v00 + e0 * f[1], v10 + e1 * f[1]
    gx = v1 - v0
    scale = 1.0 / grid[3]
    z0, z1 = d00 + (d01 - d00) * f[1], d10 + (d11 - d10) * f[1]
    return v0 + gx * f[0], (gx * scale, (e0 + (e1 - e0) * f[0]) * scale, (z0 + (z1 - z0) * f[0]) * scale)


@dataclass(frozen=True, slots=True)
class SurfacePoints:
    """Points on the surface float64[n,3], unit normals out of the solid float64[n,3], and whether each point is within reach."""

    points: Floats
    normals: Floats
    is_in_reach: NDArray[np.bool_]


def project_to_surface(bricks: BrickGrid, points: Floats, hints: Floats, reach: float | None = None) -> SurfacePoints:
    """Project points onto the surface, as `Volume.project_to_surface` does. A point that has no projection is returned unchanged,
    with its hint as the normal."""
    start = np.array(points, np.float64, order="C").reshape(-1, 3)
    hint = np.array(np.broadcast_to(np.asarray(hints, np.float64), start.shape), order="C")
    landed, turned, is_in_reach = np.empty_like(start), np.empty_like(start), np.empty(len(start), np.bool_)
    project_points_to_surface(
        make_brick_tables(bricks), start, hint, SURFACE_TOLERANCE_VOXELS * bricks.voxel, landed, turned, is_in_reach
    )
    far = 2 * bricks.voxel if reach is None else float(reach)
    is_in_reach &= ((landed - start) ** 2).sum(axis=1) <= far * far
    return SurfacePoints(np.where(is_in_reach[:, None], landed, start), np.where(is_in_reach[:, None], turned, hint), is_in_reach)


@kernel
def project_points_to_surface(
    bricks: BrickTables,
    start: Array2[F64],
    hints: Array2[F64],
    tolerance: F64,
    positions: Array2[F64],
    normals: Array2[F64],
    is_on_surface: Array1[BOOL],
) -> None:
    """Apply `project_point_to_surface` to the points `start` and their `hints` [n,3]. Write the results to the last three
    arrays."""
    for i in range(is_on_surface.size):
        p, hint = (start[i, 0], start[i, 1], start[i, 2]), (hints[i, 0], hints[i, 1], hints[i, 2])
        is_on_surface[i], q, normal = project_point_to_surface(bricks[0], bricks[1], bricks[2:], p, hint, tolerance)
        for k in range(3):
            positions[i, k], normals[i, k] = q[k], normal[k]


@kernel_helper
def project_point_to_surface(
    table: Array1[I32], values: Array1[F32], grid: tuple[F64, F64, F64, F64, I64, I64, I64], p: Vec3, hint: Vec3, tolerance: F64
) -> tuple[BOOL, Vec3, Vec3]:
    """Project the point `p` onto the surface. Return whether this succeeded, a point within `tolerance` (mm) of the surface, and
    the normal there.

    If it failed, the point and the normal are `p` and `hint`. Each Newton step is as long as the distance, but at most one voxel,
    along the gradient. Where the field is flat, as in the middle of a cave or deep in the solid, steps follow the hint: against
    it in air, along it in the solid."""
    voxel = grid[3]
    q = p
    if not np.isfinite(p[0] + p[1] + p[2]):
        return False, p, hint
    for turn in range(MAX_PROJECTION_STEPS):
        d, g = interpolate_distance_and_gradient(table, values, grid, q)
        square = dot(g, g)
        if abs(d) <= tolerance:
            if square > 0:
                size = np.sqrt(square)
                return True, q, (g[0] / size, g[1] / size, g[2] / size)
            return True, q, hint
        # Between two caves that meet, gradients oscillate: every third step follows the hint.
        flat = square < MIN_SQUARED_GRADIENT or turn % 3 == 2
        step = -d if flat else -d / square
        length = abs(step) * np.sqrt(square)
        if not (flat or length <= voxel):
            step = step * (voxel / length)
        ahead = hint if flat else g
        q = (q[0] + step * ahead[0], q[1] + step * ahead[1], q[2] + step * ahead[2])
    return False, p, hint
