"""Kernels of `triangle_grid` that find the face nearest to a position, and the direction out of the surface there."""

from __future__ import annotations

import numpy as np

from antdsl.casting.faces import compute_squared_length, find_nearest_on_face
from antdsl.casting.grid_rays import GridTables, ThreeColumns
from antdsl.casting.tolerances import (
    FACE_BEYOND_GRID,
    MAX_SEARCH_RINGS,
    NEAREST_FACE_BEYOND_RANGE,
    NEAREST_FACE_UNKNOWN,
    TOUCHING_DISTANCE_MM,
)
from antdsl.machine_code.kernels import inlined, kernel, kernel_helper, prefetch, round_to_int
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I64, Array1, Array2, Strided2
from antdsl.numerics.kernel_vectors import Vec3, Vec3F32, minus

_PREFETCHED_FACE_COUNT = 12  # prefetched faces of a row of cubes


@kernel
def write_signed_distances(grid: GridTables, positions: ThreeColumns, results: Array2[F32], begin: I64, end: I64) -> I64:
    """Write the signed distance and the direction out of the surface to `results`, for positions `begin` to `end` (exclusive).
    The distance is NaN if the grid cannot resolve a position. Returns the number of such positions."""
    x, y, z = positions
    count = 0
    for i in range(begin, end):
        gap, outward = measure_signed_distance(grid, (x[i], y[i], z[i]), np.inf)
        count += 1 if gap != gap else 0
        results[0, i], results[1, i], results[2, i], results[3, i] = gap, outward[0], outward[1], outward[2]
    return count


@inlined
def measure_signed_distance(grid: GridTables, place: Vec3F32, max_distance: F64) -> tuple[F32, Vec3F32]:
    """Return the signed distance (mm) of one position to the faces, and the direction out of the surface.

    The distance is NaN if the grid cannot resolve the position, and infinite if it is more than `max_distance` mm."""
    shape, normals = grid[0], grid[7]
    p = np.float64(place[0]), np.float64(place[1]), np.float64(place[2])
    a = p[0] - shape[6], p[1] - shape[7], p[2] - shape[8]
    square, face, q = find_nearest_face(grid, a, max_distance)
    if face == NEAREST_FACE_UNKNOWN:
        square, face, q = find_nearest_face(grid, a, np.inf)
    gap, x, y, z = np.float32(np.nan), np.float32(0), np.float32(0), np.float32(0)
    if face >= 0:
        distance = np.sqrt(square)
        n = normals[face, 0], normals[face, 1], normals[face, 2]
        offset = p[0] - (q[0] + shape[6]), p[1] - (q[1] + shape[7]), p[2] - (q[2] + shape[8])
        side = -1.0 if (offset[0] * n[0] + offset[1] * n[1]) + offset[2] * n[2] < 0 else 1.0
        gap = np.float32(distance * side)
        part = side / max(distance, TOUCHING_DISTANCE_MM)
        if distance < TOUCHING_DISTANCE_MM:
            x, y, z = np.float32(n[0]), np.float32(n[1]), np.float32(n[2])
        else:
            x, y, z = np.float32(offset[0] * part), np.float32(offset[1] * part), np.float32(offset[2] * part)
    elif face == NEAREST_FACE_BEYOND_RANGE:
        gap = np.float32(np.inf)
    return gap, (x, y, z)


@kernel
def write_nearest_points(
    grid: GridTables, points: Strided2[F64], positions: Array2[F64], squared_distances: Array1[F64], face: Array1[I64]
) -> None:
    """Write the results of `TriangleGrid.find_nearest` to the last three arrays: nearest position, squared distance and face."""
    for i in range(face.size):
        p = (points[i, 0], points[i, 1], points[i, 2])
        squared_distances[i], face[i], q = find_nearest_face(grid, p, np.inf)
        positions[i, 0], positions[i, 1], positions[i, 2] = q[0], q[1], q[2]


@inlined
def prefetch_cells_around(grid: GridTables, place: Vec3F32, rows: Array1[I64], k: I64) -> None:
    """Prefetch the starts of the face lists of the 27 cubes around a position. They are nine rows of three cubes. Write the first
    cube of each row to `rows`, from index 9 * `k` on."""
    shape, size, first = grid[0], grid[1], grid[2]
    part = 1.0 / shape[3]
    mx = _find_cell_layer(np.float64(place[0]) - shape[6], shape[0], part, size[0])
    my = _find_cell_layer(np.float64(place[1]) - shape[7], shape[1], part, size[1])
    mz = _find_cell_layer(np.float64(place[2]) - shape[8], shape[2], part, size[2])
    for x in range(3):
        for y in range(3):
            row = min(max(mx + x - 1, 0), size[0] - 1) * size[1] + min(max(my + y - 1, 0), size[1] - 1)
            cell = row * size[2] + max(mz - 1, 0)
            rows[9 * k + 3 * x + y] = cell
            prefetch(first, cell)


@inlined
def prefetch_face_lists_of_rows(grid: GridTables, rows: Array1[I64], count: I64) -> None:
    """Prefetch the first faces of the first `count` of `rows`, which are rows of three cubes."""
    first, face_list, bound = grid[2], grid[3], grid[4]
    last = first.size - 1
    for n in range(count):
        begin, end = first[rows[n]], first[min(rows[n] + 3, last)]
        for k in range(begin, min(end, begin + _PREFETCHED_FACE_COUNT), 2):
            prefetch(bound, 8 * k)
        if begin < end:
            prefetch(face_list, begin)


@inlined
def _find_cell_layer(coordinate: F64, low: F64, offset: F64, size: I64) -> I64:
    """Return the number of the layer of cubes at a coordinate (mm), clamped to the grid. `offset`: cubes per mm."""
    return min(max(round_to_int(np.floor((coordinate - low) * offset)), 0), size - 1)


@kernel_helper
def find_nearest_face(grid: GridTables, p: Vec3, max_distance: F64) -> tuple[F64, I64, Vec3]:
    """Return the squared distance from a point to its nearest face, this face, and the nearest position on it.

    If all faces are farther than `max_distance` (mm), the result may be NEAREST_FACE_BEYOND_RANGE or NEAREST_FACE_UNKNOWN instead
    of a face. NEAREST_FACE_BEYOND_RANGE means that the point is in front of its nearest face, but the distance was not measured.
    Bounds of the distances are enough to know this."""
    shape, size, first, face_list, bound, corners = grid[0], grid[1], grid[2], grid[3], grid[4], grid[6]
    width, slack = shape[3], shape[4]
    part = 1.0 / width
    ax, ay, az = (p[0] - shape[0]) * part, (p[1] - shape[1]) * part, (p[2] - shape[2]) * part
    best, face, place, bound_of_best = np.inf, FACE_BEYOND_GRID, p, np.inf
    # Upper bounds: of the nearest face in front, and of any face; limits for faces in front and behind.
    ahead, square_limit, front_limit, back_limit = np.inf, np.inf, max_distance + slack, np.inf
    latest, second, third = (
        FACE_BEYOND_GRID,
        FACE_BEYOND_GRID,
        FACE_BEYOND_GRID,
    )  # faces queried last: neighbouring cubes contain them too
    if not (_is_near_grid(ax, size[0]) and _is_near_grid(ay, size[1]) and _is_near_grid(az, size[2])):
        return best, face, place
    mx, my, mz = _clamp_index(ax, size[0]), _clamp_index(ay, size[1]), _clamp_index(az, size[2])
    ring, is_searching = 0, True
    while is_searching and ring <= MAX_SEARCH_RINGS:
        low, high = max(mz - ring, 0), min(mz + ring, size[2] - 1)
        for x in range(max(mx - ring, 0), min(mx + ring, size[0] - 1) + 1):
            for y in range(max(my - ring, 0), min(my + ring, size[1] - 1) + 1):
                if _measure_squared_gap(ax, x) + _measure_squared_gap(ay, y) > square_limit * part * part * (1 + 1e-6):
                    continue
                # On the sides of the ring all cubes of a row are new and contiguous; elsewhere only its two ends are new.
                side = abs(x - mx) == ring or abs(y - my) == ring
                row = (x * size[1] + y) * size[2]
                z = low
                while z <= high:
                    last = high if side else z
                    if side or abs(z - mz) == ring:
                        for k in range(first[row + z], first[row + last + 1]):
                            height, from_ball = _measure_distances_to_plane_and_ball(bound, k, p)
                            if height > slack:
                                if from_ball < ahead:
                                    ahead = from_ball
                                    limit = np.sqrt(ahead) + slack
                                    square_limit = min(square_limit, limit * limit)
                                    back_limit = min(back_limit, limit + slack)
                                if _is_face_farther(np.float64(bound[k, 7]) + slack, height, from_ball, front_limit):
                                    continue
                            elif _is_face_farther(np.float64(bound[k, 7]) + slack, height, from_ball, back_limit):
                                continue
                            f = face_list[k]
                            if f == face or latest == f or second == f or third == f:
                                continue
                            latest, second, third = f, latest, second
                            q = find_nearest_on_face(corners, f, p)
                            d = compute_squared_length(minus(q, p))
                            if d < best or (d == best and f < face):
                                best, face, place, bound_of_best = d, f, q, np.sqrt(d) + slack
                                square_limit, front_limit, back_limit = (
                                    min(square_limit, d),
                                    min(front_limit, bound_of_best),
                                    min(back_limit, bound_of_best),
                                )
                    z = last + 1 if side or z == high else high
        searched = _measure_searched_distance(ax, mx, ring, size[0])
        searched = min(searched, _measure_searched_distance(ay, my, ring, size[1]))
        searched = min(searched, _measure_searched_distance(az, mz, ring, size[2])) * width
        is_searching = not square_limit <= searched * searched
        ring += 1
    if max_distance < np.inf and (is_searching or best > max_distance * max_distance):
        return np.inf, NEAREST_FACE_BEYOND_RANGE if square_limit < best and not is_searching else NEAREST_FACE_UNKNOWN, p
    if is_searching:
        best, face, place = np.inf, FACE_BEYOND_GRID, p
    return best, face, place


@inlined
def _measure_distances_to_plane_and_ball(bound: Array2[F32], k: I64, p: Vec3) -> tuple[F64, F64]:
    """Return a point's height above a face's plane, and its squared distance from the centre of the face's bounding ball."""
    nx, ny, nz = np.float64(bound[k, 0]), np.float64(bound[k, 1]), np.float64(bound[k, 2])
    height = ((nx * p[0] + ny * p[1]) + nz * p[2]) + np.float64(bound[k, 3])
    x, y, z = p[0] - np.float64(bound[k, 4]), p[1] - np.float64(bound[k, 5]), p[2] - np.float64(bound[k, 6])
    return height, x * x + y * y + z * z


@inlined
def _is_face_farther(radius: F64, height: F64, square: F64, distance: F64) -> BOOL:
    """Return whether a face is certainly farther from a point than `distance`, judged by its plane and its bounding ball.

    `height`: the point's height above the face's plane. `square`: its squared distance from the centre of the face's bounding
    ball. `radius`: the radius of this ball."""
    if abs(height) > distance:
        return True
    square_in_plane = square - height * height
    # The largest distance along the plane for which the total distance is at most `distance`.
    margin = distance * distance - height * height
    return square_in_plane > radius * radius and square_in_plane > radius * radius + margin + 2.0 * radius * np.sqrt(margin)


@inlined
def _is_near_grid(coordinate: F64, size: I64) -> BOOL:
    """Return whether a coordinate (in cubes) is in the grid, or outside it by at most the search range."""
    return coordinate >= -MAX_SEARCH_RINGS and coordinate <= size + MAX_SEARCH_RINGS


@inlined
def _clamp_index(coordinate: F64, size: I64) -> I64:
    """Return the number of the layer of cubes at a coordinate (in cubes), clamped to the grid."""
    return min(np.int64(np.floor(max(coordinate, 0.0))), size - 1)


@inlined
def _measure_searched_distance(coordinate: F64, middle: I64, ring: I64, size: I64) -> F64:
    """Return the distance (in cubes) along an axis up to which the search is complete: all nearer faces are in the rings searched
    so far."""
    begin, end = middle - ring, middle + ring + 1
    low = np.inf if begin <= 0 else coordinate - np.float64(begin)
    high = np.inf if end >= size else np.float64(end) - coordinate
    return min(low, high)


@inlined
def _measure_squared_gap(coordinate: F64, cell: I64) -> F64:
    """Return the squared distance (in cubes) along one axis between a point and a layer of cubes.

    A tolerance allows for faces that extend beyond their cubes."""
    gap = max(max(np.float64(cell) - coordinate, coordinate - np.float64(cell + 1)) - 1e-5, 0.0)
    return gap * gap
