"""Finds the first face that each ray hits in a grid of triangles (`triangle_grid`). A ray is followed from cube to cube."""

from __future__ import annotations

import numpy as np

from antdsl.casting.faces import evaluate_plane, evaluate_plane_slope
from antdsl.casting.tolerances import (
    EDGE_WEIGHT_TOLERANCE,
    FACE_BEYOND_GRID,
    MAX_RAY_CUBES,
    MIN_VECTOR_LENGTH,
    NO_FACE,
    ROUNDING_BOUND,
)
from antdsl.machine_code.kernels import allocate_scratch, inlined, kernel, kernel_helper, prefetch, round_to_int
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I32, I64, Array1, Array2, Array3, Strided2
from antdsl.numerics.kernel_vectors import Vec3, Vec3F32, get_column, minus

# As `TriangleGrid.tables`.
GridTables = tuple[Array1[F64], Array1[I64], Array1[I32], Array1[I32], Array2[F32], Array3[F64], Array3[F64], Array2[F64]]
ThreeColumns = tuple[Array1[F32], Array1[F32], Array1[F32]]
FourColumns = tuple[Array1[F32], Array1[F32], Array1[F32], Array1[F32]]
FeelerResults = tuple[Array1[BOOL], Array1[F32], Array1[F32], Array1[F32], Array1[F32]]
SevenColumns = tuple[Array1[F32], Array1[F32], Array1[F32], Array1[F32], Array1[F32], Array1[F32], Array1[F32]]
FLOAT32_ONE, ROUNDING_SLACK, MIN_VECTOR_LENGTH_F32 = np.float32(1), np.float32(ROUNDING_BOUND), np.float32(MIN_VECTOR_LENGTH)
PREFETCH_GROUP_SIZE = 16  # rays or points with faces prefetched together
_MIN_CUBES_ALONG_AXIS = 1e-12  # cubes along an axis; a ray with a shorter extent stays in its layer


@kernel
def write_first_hits(
    grid: GridTables,
    origin: Strided2[F64],
    displacement: Strided2[F64],
    ray_parameters: Array1[F64],
    face: Array1[I64],
    begin: I64,
    end: I64,
) -> None:
    """Write the results of `TriangleGrid.find_first_faces` for rays `begin` to `end` (exclusive) to `ray_parameters` and
    `face`."""
    cells = allocate_scratch(2 * PREFETCH_GROUP_SIZE, I64)
    for low in range(begin, end, PREFETCH_GROUP_SIZE):
        high = min(low + PREFETCH_GROUP_SIZE, end)
        _prefetch_faces(grid, origin, (0.0, 0.0, 0.0), displacement, cells, low, high)
        for i in range(low, high):
            ray_parameters[i], face[i] = find_first_hit(
                grid, (origin[i, 0], origin[i, 1], origin[i, 2]), (displacement[i, 0], displacement[i, 1], displacement[i, 2])
            )


@kernel
def write_hit_normals(
    grid: GridTables,
    origin: Strided2[F64],
    displacement: Strided2[F64],
    normals: Array2[F64],
    normal_columns: Array1[I64],
    hit_rays: Array1[I64],
    results: Array2[F64],
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64]:
    """Write the results of `TriangleGrid.find_hit_normals` for rays `begin` to `end` (exclusive). They are written to `hit_rays`
    and `results` from index `begin` on.

    - `hit_rays`: the numbers of the rays that hit
    - `results` [4, n]: ray parameter and normal (x y z)

    Returns `begin`, the number of hits, and the number of rays that the grid cannot resolve."""
    shape, count, left = grid[0], 0, 0
    zero = shape[6], shape[7], shape[8]
    cells, faces, column_count = (
        allocate_scratch(2 * PREFETCH_GROUP_SIZE, I64),
        allocate_scratch(PREFETCH_GROUP_SIZE, I64),
        normals.shape[1],
    )
    for low in range(begin, end, PREFETCH_GROUP_SIZE):
        high = min(low + PREFETCH_GROUP_SIZE, end)
        _prefetch_faces(grid, origin, zero, displacement, cells, low, high)
        hit = 0
        for i in range(low, high):
            a = minus((origin[i, 0], origin[i, 1], origin[i, 2]), zero)
            t, face = find_first_hit(grid, a, (displacement[i, 0], displacement[i, 1], displacement[i, 2]))
            left += 1 if face == FACE_BEYOND_GRID else 0
            if face >= 0:
                k = begin + count + hit
                hit_rays[k], results[0, k], faces[hit] = i, t, face
                prefetch(normal_columns, face)
                hit += 1
        for n in range(hit):
            faces[n] = normal_columns[faces[n]]
            for axis in range(3):
                prefetch(normals, axis * column_count + faces[n])
        for n in range(hit):
            for axis in range(3):
                results[1 + axis, begin + count + n] = normals[axis, faces[n]]
        count += hit
    return begin, count, left


@inlined
def _prefetch_faces(
    grid: GridTables, origin: Strided2[F64], zero: Vec3, displacement: Strided2[F64], cells: Array1[I64], low: I64, high: I64
) -> None:
    """Prefetch the faces near both ends of rays `low` to `high` (exclusive). `zero`: the grid's origin, which is subtracted from
    `origin`."""
    for i in range(low, high):
        a = minus((origin[i, 0], origin[i, 1], origin[i, 2]), zero)
        _append_end_cubes(grid, a, (displacement[i, 0], displacement[i, 1], displacement[i, 2]), cells, i - low)
    _prefetch_face_lists(grid, cells, high - low)


@kernel
def write_feeler_hits(grid: GridTables, rays: SevenColumns, results: Array2[F32]) -> I64:
    """Write the results of `TriangleGrid.cast_feelers` to `results`: distances and normals.

    Feelers that the grid cannot resolve get the distance NaN. Returns the number of such feelers."""
    x, y, z, dx, dy, dz, reach = rays
    count = 0
    for i in range(reach.size):
        n, face = cast_feeler(grid, (x[i], y[i], z[i]), (dx[i], dy[i], dz[i]), reach[i])
        if face == FACE_BEYOND_GRID:
            count += 1
        results[0, i] = np.float32(n[3])
        results[1, i], results[2, i], results[3, i] = np.float32(n[0]), np.float32(n[1]), np.float32(n[2])
    return count


@kernel
def write_requested_feelers(
    grid: GridTables,
    positions: FourColumns,
    is_requested: Array1[BOOL],
    directions: FourColumns,
    results: FeelerResults,
    begin: I64,
    end: I64,
) -> I64:
    """Write the results of `TriangleGrid.cast_requested_feelers`, for agents `begin` to `end` (exclusive).

    Feelers that the grid cannot resolve get the distance NaN. Returns the number of such feelers."""
    x, y, z, clear = positions
    wx, wy, wz, reach = directions
    hit, t, nx, ny, nz = results
    count = 0
    for i in range(begin, end):
        if not is_requested[i]:
            continue
        far = reach[i]
        if not (far > 0 and far < np.inf and clear[i] <= far * (FLOAT32_ONE + ROUNDING_SLACK) + ROUNDING_SLACK):
            continue
        size = np.sqrt((wx[i] * wx[i] + wy[i] * wy[i]) + wz[i] * wz[i])
        if not (size > MIN_VECTOR_LENGTH_F32 and size < np.inf):
            continue
        n, face = cast_feeler(grid, (x[i], y[i], z[i]), (wx[i] / size, wy[i] / size, wz[i] / size), far)
        if face == FACE_BEYOND_GRID:
            count += 1
            t[i] = np.float32(n[3])
        elif face >= 0:
            hit[i], t[i] = True, np.float32(n[3])
            nx[i], ny[i], nz[i] = np.float32(n[0]), np.float32(n[1]), np.float32(n[2])
    return count


@kernel_helper
def cast_feeler(grid: GridTables, position: Vec3F32, direction: Vec3F32, reach: F32) -> tuple[tuple[F64, F64, F64, F64], I64]:
    """Return the first hit of a feeler: its distance (mm), the unit normal on the side of the feeler's origin, and the face. The
    distance is infinite without a hit, and NaN if the grid cannot resolve the feeler."""
    shape, normals = grid[0], grid[7]
    far = np.float64(reach)
    a = np.float64(position[0]) - shape[6], np.float64(position[1]) - shape[7], np.float64(position[2]) - shape[8]
    w = np.float64(direction[0]) * far, np.float64(direction[1]) * far, np.float64(direction[2]) * far
    t, face = find_first_hit(grid, a, w)
    if face < 0:
        return (0.0, 0.0, 0.0, np.nan if face == FACE_BEYOND_GRID else np.inf), face
    x, y, z = normals[face, 0], normals[face, 1], normals[face, 2]
    if (x * w[0] + y * w[1]) + z * w[2] > 0:
        x, y, z = -x, -y, -z
    return (x, y, z, t * far), face


@kernel_helper
def find_first_hit(grid: GridTables, start: Vec3, displacement: Vec3) -> tuple[F64, I64]:
    """Return the ray parameter (0 to 1) of a ray's first hit, and the face. The ray goes from `start` to
    `start + displacement`."""
    shape, size, first, face_list, bound, planes = grid[0], grid[1], grid[2], grid[3], grid[4], grid[5]
    part = 1.0 / shape[3]
    px, py, pz = (start[0] - shape[0]) * part, (start[1] - shape[1]) * part, (start[2] - shape[2]) * part
    dx, dy, dz = displacement[0] * part, displacement[1] * part, displacement[2] * part
    long = (abs(dx) + abs(dy)) + abs(dz)
    if long > MAX_RAY_CUBES:
        return np.inf, FACE_BEYOND_GRID
    if not (abs(px) + abs(py) + abs(pz) < np.inf and long <= MAX_RAY_CUBES):
        return np.inf, NO_FACE
    # A ray that stays in a layer never reaches the layer's borders; a ray outside a layer never enters it.
    mx, my, mz = abs(dx) > _MIN_CUBES_ALONG_AXIS, abs(dy) > _MIN_CUBES_ALONG_AXIS, abs(dz) > _MIN_CUBES_ALONG_AXIS
    ix, iy, iz = 1.0 / dx if mx else np.inf, 1.0 / dy if my else np.inf, 1.0 / dz if mz else np.inf
    begin_x, end_x = _intersect_axis(px, ix, mx, np.float64(size[0]))
    begin_y, end_y = _intersect_axis(py, iy, my, np.float64(size[1]))
    begin_z, end_z = _intersect_axis(pz, iz, mz, np.float64(size[2]))
    begin, end = max(max(max(begin_x, begin_y), begin_z), 0.0), min(min(min(end_x, end_y), end_z), 1.0)
    if begin > end:
        return np.inf, NO_FACE
    x = min(max(np.int64(np.floor(px + dx * begin)), 0), size[0] - 1)
    y = min(max(np.int64(np.floor(py + dy * begin)), 0), size[1] - 1)
    z = min(max(np.int64(np.floor(pz + dz * begin)), 0), size[2] - 1)
    ux, uy, uz = 1 if dx > 0 else 0, 1 if dy > 0 else 0, 1 if dz > 0 else 0
    square = (displacement[0] * displacement[0] + displacement[1] * displacement[1]) + displacement[2] * displacement[2]
    h, inverse_square, slack = shape[5] / np.sqrt(square), 1.0 / square, shape[4]
    best, face, max_parameter = np.inf, NO_FACE, 1.0
    while x >= 0 and x < size[0] and y >= 0 and y < size[1] and z >= 0 and z < size[2]:
        cell = (x * size[1] + y) * size[2] + z
        for k in range(first[cell], first[cell + 1]):
            # Most faces have both ends of the ray on one side of their plane, or the ray misses their ball.
            nx, ny, nz = np.float64(bound[k, 0]), np.float64(bound[k, 1]), np.float64(bound[k, 2])
            start_distance = ((nx * start[0] + ny * start[1]) + nz * start[2]) + np.float64(bound[k, 3])
            distance = start_distance + ((nx * displacement[0] + ny * displacement[1]) + nz * displacement[2]) * max_parameter
            if abs(start_distance + distance) - abs(start_distance - distance) > 2.0 * slack:
                continue
            cx, cy, cz = (
                np.float64(bound[k, 4]) - start[0],
                np.float64(bound[k, 5]) - start[1],
                np.float64(bound[k, 6]) - start[2],
            )
            radius = np.float64(bound[k, 7]) + slack
            distance = min(
                max((cx * displacement[0] + cy * displacement[1] + cz * displacement[2]) * inverse_square, 0.0), max_parameter
            )
            cx, cy, cz = cx - distance * displacement[0], cy - distance * displacement[1], cz - distance * displacement[2]
            if cx * cx + cy * cy + cz * cz > radius * radius:
                continue
            f = face_list[k]
            t = -evaluate_plane(planes, f, 0, start[0], start[1], start[2]) / evaluate_plane_slope(
                planes, f, 0, displacement[0], displacement[1], displacement[2]
            )
            if t > h and t <= max_parameter:
                w1 = evaluate_plane(planes, f, 1, start[0], start[1], start[2]) + t * evaluate_plane_slope(
                    planes, f, 1, displacement[0], displacement[1], displacement[2]
                )
                w2 = evaluate_plane(planes, f, 2, start[0], start[1], start[2]) + t * evaluate_plane_slope(
                    planes, f, 2, displacement[0], displacement[1], displacement[2]
                )
                if (
                    (1.0 - w1) - w2 >= -EDGE_WEIGHT_TOLERANCE
                    and w1 >= -EDGE_WEIGHT_TOLERANCE
                    and w2 >= -EDGE_WEIGHT_TOLERANCE
                    and (t < best or f < face)
                ):
                    best, face, max_parameter = t, f, t
        # Where the ray leaves the cube: all earlier hits are listed in this cube.
        tx = (np.float64(x + ux) - px) * ix if mx else np.inf
        ty = (np.float64(y + uy) - py) * iy if my else np.inf
        tz = (np.float64(z + uz) - pz) * iz if mz else np.inf
        cube_end = min(min(tx, ty), tz)
        if best <= cube_end or cube_end > end:
            break
        if tx == cube_end:
            x += 2 * ux - 1
        elif ty == cube_end:
            y += 2 * uy - 1
        else:
            z += 2 * uz - 1
    return best, face


@inlined
def prefetch_rays(
    grid: GridTables,
    origins: Array2[F64],
    zero: Vec3,
    displacements: Array2[F64],
    rays: Array1[I64],
    cells: Array1[I64],
    count: I64,
) -> None:
    """Prefetch the faces near both ends of the first `count` rays in `rays`. Origins and displacements are float64[3,k]. `zero`:
    the grid's origin, which is subtracted from `origins`."""
    for n in range(count):
        _append_end_cubes(grid, minus(get_column(origins, rays[n]), zero), get_column(displacements, rays[n]), cells, n)
    _prefetch_face_lists(grid, cells, count)


@inlined
def _append_end_cubes(grid: GridTables, a: Vec3, w: Vec3, cells: Array1[I64], n: I64) -> None:
    """Append the numbers of the cubes at both ends of ray `n` to `cells`."""
    cells[2 * n] = _prefetch_cube_of_point(grid, a)
    cells[2 * n + 1] = _prefetch_cube_of_point(grid, (a[0] + w[0], a[1] + w[1], a[2] + w[2]))


@inlined
def _prefetch_face_lists(grid: GridTables, cells: Array1[I64], count: I64) -> None:
    """Prefetch the first faces of the cubes that `_append_end_cubes` has appended for `count` rays."""
    for n in range(2 * count):
        _prefetch_face_list(grid, cells[n])


@inlined
def _prefetch_cube_of_point(grid: GridTables, a: Vec3) -> I64:
    """Return the number of the cube that contains a position, or outside the grid that of the nearest cube. Prefetch the start of
    its face list."""
    shape, size, first = grid[0], grid[1], grid[2]
    part = 1.0 / shape[3]
    x = min(max(round_to_int(np.floor((a[0] - shape[0]) * part)), 0), size[0] - 1)
    y = min(max(round_to_int(np.floor((a[1] - shape[1]) * part)), 0), size[1] - 1)
    z = min(max(round_to_int(np.floor((a[2] - shape[2]) * part)), 0), size[2] - 1)
    cell = (x * size[1] + y) * size[2] + z
    prefetch(first, cell)
    return cell


@inlined
def _prefetch_face_list(grid: GridTables, cell: I64) -> None:
    """Prefetch the first faces of a cube. One cache line holds two faces."""
    first, face_list, bound = grid[2], grid[3], grid[4]
    k: I64 = first[cell]
    prefetch(face_list, k)
    prefetch(bound, 8 * k)
    prefetch(bound, 8 * k + 16)
    prefetch(bound, 8 * k + 32)
    prefetch(bound, 8 * k + 48)


@inlined
def _intersect_axis(p: F64, inverse_direction: F64, is_moving: BOOL, size: F64) -> tuple[F64, F64]:
    """Return the ray parameters at which a ray enters and leaves the grid along one axis."""
    if not is_moving:
        return (0.0, 1.0) if p >= 0.0 and p < size else (np.inf, -np.inf)
    one, two = -p * inverse_direction, (size - p) * inverse_direction
    return (one, two) if one < two else (two, one)
