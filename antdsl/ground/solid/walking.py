"""Walking on a solid, in short steps along the tangent plane, each of which is projected onto the zero level. Headings rotate
with the normal."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.ground.protocol import Floats, Footing, GroundMove
from antdsl.ground.solid.bricks import BrickGrid
from antdsl.ground.solid.trilinear import (
    SMOOTH_NORMAL_REACH_VOXELS,
    SURFACE_TOLERANCE_VOXELS,
    BrickTables,
    compute_smooth_gradient,
    interpolate_distance,
    interpolate_distance_and_gradient,
    load_cell_corners,
    make_brick_tables,
    project_point_to_surface,
)
from antdsl.ground.solid.volume import Volume
from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, Array2, Array3, inlined, kernel, kernel_helper
from antdsl.numerics.kernel_vectors import Vec3, cross, dot

Vectors = Array2[F64]

MAX_STRIDE_VOXELS = 1.0  # largest partial step, in voxels
MIN_STRIDE_VOXELS = 1 / 128  # smallest partial step, in voxels
# Voxels between the middle of a partial step and the surface; a larger distance cuts an edge or passes a thin wall
MAX_CHORD_ERROR_VOXELS = 0.12
# cosine between normals before and after a partial step; below it, the agent may have reached another wall
MIN_TURN_COSINE = -0.25
MAX_STRIDE_STRETCH = 1.3  # maximum length of a projected partial step, as a multiple of its length
EDGE_STRIDE_VOXELS = 0.1  # voxels; in a shorter step, a sharp turn of the normal is an edge, not another wall
NEWTON_STEPS = 4
MAX_BISECTIONS = 24
REMAINING_TOLERANCE_VOXELS = 1e-6  # voxels; a smaller remaining distance counts as zero
MAX_STRIDES = 400  # maximum number of partial steps of a move
STANCE_REACH_BODY_LENGTHS = 0.4  # body lengths to both sides over which the normal of the stance is measured
MIN_SMOOTH_GRADIENT = 0.1  # length of that gradient; below it, the normal at the point itself is used

_PREFETCH_GROUP_SIZE = 16  # agents with cells prefetched together


def move_over_solid(
    volume: Volume, points: Floats, steps: Floats, heading: Floats, up: Floats, size: Floats | float, number: int = 0
) -> GroundMove:
    """Walk agents on the surface of a solid, from `points` [n,3] by `steps` [n,3]. Steps are rotated into the surface, with the
    same length.

    - `up` [n,3]: the unit normal of the body before the step
    - `heading` [n,3]: the direction that the body faces; it rotates with the smooth normal of the body, not with each small bump
    - `size`: the size of the body (mm, one or [n]); positions are within a ten-thousandth of it from the surface
    - `number`: the number of the solid in the footings

    An agent in air, because the ground was dug away, is first moved to the surface. A step that is not finite counts as zero. A
    step at more than 60 degrees to the surface is shortened.

    `up` of the result is the outward normal, smoothed over the length of the body. So the body begins to tilt before an edge and
    does not jerk. A lost agent stays at its position."""
    bricks = volume.bricks
    columns = [np.ascontiguousarray(np.asarray(v, np.float64).reshape(-1, 3).T) for v in (points, steps, heading, up)]
    count = columns[0].shape[1]
    body = np.broadcast_to(np.asarray(size, np.float64), (count,))
    close = np.clip(3e-5 * body, SURFACE_TOLERANCE_VOXELS * bricks.voxel, 1e-3 * bricks.voxel)
    with np.errstate(over="ignore", invalid="ignore"):
        lean = compute_normal_reach(bricks, body)
    vectors, distances = np.empty((4, 3, count)), np.empty(count)
    blocked, lost = np.empty(count, bool), np.empty(count, bool)
    walk_all_agents_on_solid(
        make_brick_tables(bricks), *columns, np.ascontiguousarray(close), lean, vectors, distances, blocked, lost
    )
    place, stance_up, head, direction = (v.T for v in vectors)
    return GroundMove(Footing.from_solids(number, place), place, stance_up, head, direction, distances, blocked, lost)


def compute_normal_reach(bricks: BrickGrid, body: Floats) -> Floats:
    """Return the radius, in voxels around a point, over which a body's normal is measured."""
    return np.maximum(body * (STANCE_REACH_BODY_LENGTHS / bricks.voxel), SMOOTH_NORMAL_REACH_VOXELS)


@kernel
def walk_all_agents_on_solid(
    bricks: BrickTables,
    points: Vectors,
    steps: Vectors,
    heading: Vectors,
    up: Vectors,
    tolerances: Array1[F64],
    normal_reaches: Array1[F64],
    results: Array3[F64],
    distances: Array1[F64],
    is_blocked: Array1[BOOL],
    is_lost: Array1[BOOL],
) -> None:
    """Move all agents by one step. Inputs are (3, n): positions, steps, headings and up vectors.

    - `tolerances`: the greatest distance of each agent from the surface (mm)
    - `normal_reaches`: the radius over which the normal of each agent is measured (voxels)
    - `results` (4, 3, n): receives position, up, heading and direction
    - `distances`, `is_blocked`, `is_lost`: receive the distances travelled, and the flags of `GroundMove`"""
    table, values = bricks[:2]
    grid = bricks[2:]
    for i in range(distances.size):
        if i % _PREFETCH_GROUP_SIZE == 0:
            distances[i] = _prefetch_cells(table, values, grid, points, i, min(i + _PREFETCH_GROUP_SIZE, distances.size))
        start = (points[0, i], points[1, i], points[2, i])
        old_up = (up[0, i], up[1, i], up[2, i])
        head = (heading[0, i], heading[1, i], heading[2, i])
        wish = (steps[0, i], steps[1, i], steps[2, i])
        if not np.isfinite(wish[0] + wish[1] + wish[2]):
            wish = (0.0, 0.0, 0.0)
        normal = _normalise_or_fallback(compute_smooth_gradient(table, values, grid, SMOOTH_NORMAL_REACH_VOXELS, start), old_up)
        wish = _rotate_from_normal_to_normal(wish, old_up, normal, head)
        p, n, direction, distances[i], is_blocked[i], is_lost[i] = _walk_agent(
            table, values, grid, start, normal, wish, tolerances[i]
        )
        slope = compute_smooth_gradient(table, values, grid, normal_reaches[i], p)
        stance_up = _normalise_or_fallback(slope, n) if dot(slope, slope) > MIN_SMOOTH_GRADIENT * MIN_SMOOTH_GRADIENT else n
        head, _ = _project_on_tangent_plane(_rotate_from_normal_to_normal(head, old_up, stance_up, head), stance_up)
        direction, _ = _project_on_tangent_plane(_rotate_from_normal_to_normal(direction, n, stance_up, direction), stance_up)
        for k in range(3):
            results[0, k, i], results[1, k, i], results[2, k, i], results[3, k, i] = p[k], stance_up[k], head[k], direction[k]


@kernel_helper
def _prefetch_cells(
    table: Array1[I32],
    values: Array1[F32],
    grid: tuple[F64, F64, F64, F64, I64, I64, I64],
    points: Array2[F64],
    first: I64,
    last: I64,
) -> F64:
    """Read the cells around the positions of agents `first` to `last`, so that they are in the processor's cache. The reads are
    independent of each other. The returned sum has no meaning; it prevents the compiler from removing the reads."""
    total = 0.0
    for i in range(first, last):
        a, b, _ = load_cell_corners(table, values, grid, (points[0, i], points[1, i], points[2, i]))
        total += (a[0] + a[2]) + (b[0] + b[2])
    return total


class WalkResult(NamedTuple):
    """The result of the short steps of one agent: position, normal, direction, distance travelled (mm), and whether it is blocked
    or lost."""

    position: Vec3
    normal: Vec3
    direction: Vec3
    length: F64
    is_blocked: BOOL
    is_lost: BOOL


@kernel_helper
def _walk_agent(
    table: Array1[I32],
    values: Array1[F32],
    grid: tuple[F64, F64, F64, F64, I64, I64, I64],
    p: Vec3,
    n: Vec3,
    wish: Vec3,
    tolerance: F64,
) -> WalkResult:
    """Move one agent from `p`, with the normal `n`, by `wish` in short steps along the surface."""
    voxel = grid[3]
    direction, flat = _project_on_tangent_plane(wish, n)
    left = min(np.sqrt(dot(wish, wish)), 2 * flat)
    stride, walked = MAX_STRIDE_VOXELS, 0.0
    settled, blocked = False, False
    if not left > 0:
        is_settled, p, new_normal = project_point_to_surface(table, values, grid, p, n, tolerance)
        if not is_settled:
            return WalkResult(p, n, direction, walked, False, True)
        direction = _rotate_direction(direction, n, new_normal)
        return WalkResult(p, new_normal, direction, walked, False, False)
    for _ in range(MAX_STRIDES):
        if not left > 0:
            break
        length = min(left, stride * voxel)
        q, g, d = _project_to_surface(table, values, grid, p, n, direction, length, tolerance)
        new_normal = _normalise_or_fallback(g, n)
        middle = interpolate_distance(table, values, grid, ((p[0] + q[0]) * 0.5, (p[1] + q[1]) * 0.5, (p[2] + q[2]) * 0.5))
        displacement = (q[0] - p[0], q[1] - p[1], q[2] - p[2])
        far = MAX_STRIDE_STRETCH * length
        good = (
            dot(displacement, displacement) <= far * far and abs(d) <= tolerance and abs(middle) <= MAX_CHORD_ERROR_VOXELS * voxel
        )
        if good and (length <= EDGE_STRIDE_VOXELS * voxel or dot(new_normal, n) > MIN_TURN_COSINE):
            direction = _rotate_direction(direction, n, new_normal)
            p, n = q, new_normal
            rest = left - length
            left = rest if rest > REMAINING_TOLERANCE_VOXELS * voxel else 0.0
            walked += length
            stride = min(stride * 2, MAX_STRIDE_VOXELS)
            settled, blocked = True, False
        elif not settled:
            is_settled, p, new_normal = project_point_to_surface(table, values, grid, p, n, tolerance)
            if not is_settled:
                return WalkResult(p, n, direction, walked, blocked, True)
            direction = _rotate_direction(direction, n, new_normal)
            n = new_normal
            settled = True
        else:
            stride = length * (0.5 / voxel)
            if stride < MIN_STRIDE_VOXELS:
                if blocked:
                    break
                # At the bottom of a groove or the top of a ridge, change to the other wall, once per move.
                beyond = 2 * MIN_STRIDE_VOXELS * voxel
                _, g = interpolate_distance_and_gradient(
                    table,
                    values,
                    grid,
                    (p[0] + direction[0] * beyond, p[1] + direction[1] * beyond, p[2] + direction[2] * beyond),
                )
                new_normal = _normalise_or_fallback(g, n)
                direction = _rotate_direction(direction, n, new_normal)
                n = new_normal
                stride, blocked = EDGE_STRIDE_VOXELS, True
    return WalkResult(p, n, direction, walked, blocked, False)


@kernel_helper
def _project_to_surface(
    table: Array1[I32],
    values: Array1[F32],
    grid: tuple[F64, F64, F64, F64, I64, I64, I64],
    p: Vec3,
    n: Vec3,
    direction: Vec3,
    length: F64,
    tolerance: F64,
) -> tuple[Vec3, Vec3, F64]:
    """Project the end of a short step of `length` from `p`, a point on the surface. Return the projected point, and the gradient
    and signed distance there.

    It uses Newton's method. Where the gradient jumps between cells, as at a sharp edge, Newton steps may oscillate. The search
    then uses two points: one just below the start, which is in the solid, and one just above, which is in air. The surface is
    between the current point and one of these two."""
    voxel = grid[3]
    far = (p[0] + direction[0] * length, p[1] + direction[1] * length, p[2] + direction[2] * length)
    q = far
    d, g = interpolate_distance_and_gradient(table, values, grid, q)
    beyond = d > 0
    limit = 0.5 * voxel
    for _ in range(NEWTON_STEPS):
        if not abs(d) > tolerance:
            return q, g, d
        square = max(dot(g, g), 1e-4)
        step = -d / square
        size = abs(step) * np.sqrt(square)
        if size > limit:
            step = step * (limit / max(size, limit))
        q = (q[0] + step * g[0], q[1] + step * g[1], q[2] + step * g[2])
        d, g = interpolate_distance_and_gradient(table, values, grid, q)
    part = 0.5
    while abs(d) > tolerance and part > 1e-4:
        depth = (-part if beyond else part) * length
        near = (p[0] + depth * n[0], p[1] + depth * n[1], p[2] + depth * n[2])
        if (interpolate_distance(table, values, grid, near) > 0) != beyond:
            for _ in range(MAX_BISECTIONS):
                q = ((near[0] + far[0]) * 0.5, (near[1] + far[1]) * 0.5, (near[2] + far[2]) * 0.5)
                d, g = interpolate_distance_and_gradient(table, values, grid, q)
                if not abs(d) > tolerance:
                    break
                if (d > 0) == beyond:
                    far = q
                else:
                    near = q
            break
        part = part * 0.2  # the opposite wall is nearer
    return q, g, d


@inlined
def _rotate_direction(direction: Vec3, old_normal: Vec3, new_normal: Vec3) -> Vec3:
    """Return a direction after the rotation from the old to the new normal, projected onto the new tangent plane."""
    direction, _ = _project_on_tangent_plane(
        _rotate_from_normal_to_normal(direction, old_normal, new_normal, direction), new_normal
    )
    return direction


@kernel_helper
def _rotate_from_normal_to_normal(v: Vec3, old_normal: Vec3, new_normal: Vec3, direction: Vec3) -> Vec3:
    """Return the vector `v` after the smallest rotation from the old to the new unit normal. For opposite normals, the rotation
    goes through `direction`."""
    cosine = dot(old_normal, new_normal)
    if cosine < -1 + 1e-9:
        hinge = cross(old_normal, direction)
        twice = 2 * dot(hinge, v)
        return (twice * hinge[0] - v[0], twice * hinge[1] - v[1], twice * hinge[2] - v[2])
    axis = cross(old_normal, new_normal)
    part = dot(axis, v) / (1.0 + cosine)
    swept = cross(axis, v)
    return (
        cosine * v[0] + swept[0] + part * axis[0],
        cosine * v[1] + swept[1] + part * axis[1],
        cosine * v[2] + swept[2] + part * axis[2],
    )


@kernel_helper
def _project_on_tangent_plane(v: Vec3, normal: Vec3) -> tuple[Vec3, F64]:
    """Project `v` onto the plane perpendicular to the normal. Return the unit direction of the projection, and its length."""
    along = dot(v, normal)
    flat = (v[0] - along * normal[0], v[1] - along * normal[1], v[2] - along * normal[2])
    size = np.sqrt(dot(flat, flat))
    if size > 1e-9:
        return (flat[0] / size, flat[1] / size, flat[2] / size), size
    axis = (0.0, 1.0, 0.0) if abs(normal[0]) > 0.9 else (1.0, 0.0, 0.0)
    off = dot(axis, normal)
    side = (axis[0] - off * normal[0], axis[1] - off * normal[1], axis[2] - off * normal[2])
    size = np.sqrt(dot(side, side))
    return (side[0] / size, side[1] / size, side[2] / size), 0.0


@inlined
def _normalise_or_fallback(v: Vec3, fallback: Vec3) -> Vec3:
    """Return the unit direction of a gradient, or `fallback` if the gradient is zero."""
    size = np.sqrt(dot(v, v))
    if not size > 1e-6:
        return fallback
    over = 1.0 / size
    return (v[0] * over, v[1] * over, v[2] * over)
