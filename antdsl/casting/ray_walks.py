"""Finds hits of short rays on a static mesh by walking over the faces below the ray, without a search in the grid of triangles.

The ring of a face is the set of all faces that share a corner with it. A ring is flat if, seen along the normal of its face, all
its faces show the same side and none overlaps another. Each face with a flat ring has a ball around its centre, into which no
face outside the ring reaches. So a ray inside the ball can hit only the ring, and passes over its faces one after another. A walk
begins at the face below the ray's origin. It tests faces in this order, with the test of `grid_rays.find_first_hit`.

Rays that pass near a corner or hit near a side are left to the grid, which has a rule for hits at equal distances. So all results
have the same bits as those of the grid, whichever face the walk begins from."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.faces import find_nearest_on_face
from antdsl.casting.grid_rays import GridTables
from antdsl.casting.tolerances import NEAREST_FACE_UNKNOWN, NO_FACE
from antdsl.machine_code.kernels import inlined, kernel, kernel_helper, load_consecutive, prefetch, round_to_int
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I32, I64, Array1, Array2
from antdsl.numerics import parallel, stored_tables
from antdsl.numerics.kernel_vectors import Vec3, cross, dot, minus, plus

if TYPE_CHECKING:
    from antdsl.casting.faces import TriangleFaces

RingTables = tuple[Array1[F64], Array1[I32], Array1[F32]]  # as `build_ring_tables`
Plane = tuple[F64, F64, F64, F64]
Arrays = tuple[NDArray[Any], ...]
CornerTables = tuple[Array1[I64], Array1[I64], Array1[I64], Array1[BOOL]]

WORDS_PER_RING_ROW, SIDE_LINK_OFFSET, CLEAR_BALL_OFFSET = 32, 24, 28  # 4-byte words per row, and the offsets of its parts
_MAX_SEARCHED_FACES, _MAX_WALKED_FACES = (
    4,
    3,
)  # maximum number of faces searched for the start, and of faces in a walk; all are in the ring of the first face
_MIN_INSIDE_WEIGHT = 1e-4  # smallest corner weight for which a ray is certainly inside a face
_MIN_RING_COSINE = 0.2  # smallest cosine between the normals of a face and of a face in its ring
_MIN_FACE_HEIGHT_CUBES = 1e-3  # in cube edges; faces with a smaller height have no ring
_SQUARE_ROUNDING_FACTOR = 1 + 1e-5  # exceeds the rounding error of a square in float32
_MIN_FACES_PER_THREAD = 512  # fewer faces are not worth another thread


def build_ring_tables(faces: TriangleFaces, grid: GridTables, store_tables: bool, threads: int = 1) -> Arrays:
    """Return the table that walks read, as three views of one array, with two cache lines for each of m faces.

    - float64[16 m]: the three planes of a face
    - int32[32 m]: from SIDE_LINK_OFFSET on, the faces across the sides opposite each corner, -1 for none
    - float32[32 m]: from CLEAR_BALL_OFFSET on, centre and squared radius of the ball; 0 if the ring is open or not flat

    If `store_tables`, the table is stored for later runs."""
    count = len(faces.corners) if store_tables else 0
    tables = stored_tables.get_or_compute(
        "rings", count, (faces.corners, *grid[0][:5]), partial(_compute_ring_tables, faces, grid, threads)
    )
    space = np.zeros(16 * len(faces.corners) + 8)
    rows = space[-space.ctypes.data % 64 // 8 :][: 16 * len(faces.corners)].reshape(-1, 4, 4)
    links, balls = (rows.reshape(-1, 16).view(kind) for kind in (np.int32, np.float32))
    rows[:, :3], links[:, SIDE_LINK_OFFSET : SIDE_LINK_OFFSET + 3], balls[:, CLEAR_BALL_OFFSET:] = (
        grid[5],
        tables["links"],
        tables["balls"],
    )
    return rows.ravel(), links.ravel(), balls.ravel()


def _compute_ring_tables(faces: TriangleFaces, grid: GridTables, threads: int) -> stored_tables.Tables:
    """Return the links and balls of all faces, as `build_ring_tables` describes them."""
    tables = faces.build_kernel_tables()
    assert tables is not None
    weld, first, face_list = tables[2:]
    three = weld.reshape(-1, 3)
    links = _find_side_links(three)
    closed = np.ones(len(first) - 1, np.bool_)
    for corner in (1, 2):
        closed[np.roll(three, -corner, axis=1)[links < 0]] = False
    sides, normals = grid[6] - np.roll(grid[6], 1, axis=1), grid[5][:, 0, :3]
    thin = (normals * normals).sum(axis=1) < (_MIN_FACE_HEIGHT_CUBES * grid[0][3]) ** 2 * (sides * sides).sum(axis=2).max(axis=1)
    closed[three[thin]] = False
    balls = np.zeros((len(links), 4), np.float32)
    parallel.run_in_parts(
        partial(_write_clear_balls, grid, (weld, first, face_list, closed), balls), len(links), threads, _MIN_FACES_PER_THREAD
    )
    return {"links": links, "balls": balls}


def _find_side_links(weld: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the face across each side of faces (m, 3), or -1 unless exactly two faces with equal winding share the side. `weld`:
    (m, 3), the vertex numbers of corners."""
    one, two = np.roll(weld, -1, axis=1).ravel(), np.roll(weld, -2, axis=1).ravel()
    key = np.minimum(one, two) * (int(weld.max(initial=0)) + 1) + np.maximum(one, two)
    order = np.argsort(key, kind="stable")
    is_equal = key[order[1:]] == key[order[:-1]]
    pair = is_equal & ~np.concatenate(([False], is_equal[:-1])) & ~np.concatenate((is_equal[1:], [False]))
    half, other = order[:-1][pair], order[1:][pair]
    alike = one[half] == two[other]
    half, other = half[alike], other[alike]
    link = np.full(len(one), -1, np.int32)
    link[half], link[other] = other // 3, half // 3
    return link.reshape(-1, 3)


@kernel
def _write_clear_balls(grid: GridTables, corners: CornerTables, balls: Array2[F32], begin: I64, end: I64) -> None:
    """Write the centre and the squared radius of the balls of faces `begin` to `end` (exclusive) to `balls`.

    `corners`: the last three arrays of `TriangleFaces.build_kernel_tables`, and a mask of the vertices without an open side."""
    points, weld = grid[6], corners[0]
    for f in range(begin, end):
        middle = 0.0, 0.0, 0.0
        for j in range(3):
            middle = plus(middle, (points[f, j, 0] / 3.0, points[f, j, 1] / 3.0, points[f, j, 2] / 3.0))
        radius = 0.0
        if _is_ring_flat(grid, corners, f, middle):
            radius = max(_measure_ring_clearance(grid, weld, f, middle) - 2.0 * grid[0][4], 0.0)
        balls[f, 0], balls[f, 1], balls[f, 2] = np.float32(middle[0]), np.float32(middle[1]), np.float32(middle[2])
        balls[f, 3] = np.float32(radius * radius / _SQUARE_ROUNDING_FACTOR)


@kernel_helper
def _is_ring_flat(grid: GridTables, corners: CornerTables, f: I64, middle: Vec3) -> BOOL:
    """Return whether the ring of a face is flat and closed. Seen along the normal, its border must go exactly once around the
    centre, `middle`."""
    points, normals = grid[6], grid[7]
    weld, first, face_list, closed = corners
    up = normals[f, 0], normals[f, 1], normals[f, 2]
    is_flat, ahead, turns, sides = dot(up, up) > 0, (0.0, 0.0, 0.0), 0, 0
    for c in range(3):
        v = weld[3 * f + c]
        is_flat = is_flat and closed[v]
        for k in range(first[v], first[v + 1]):
            g = face_list[k]
            if g == f:
                continue
            is_flat = is_flat and dot(up, (normals[g, 0], normals[g, 1], normals[g, 2])) > _MIN_RING_COSINE
            shared, j = 0, 0
            for n in range(3):
                if _has_corner(weld, f, weld[3 * g + n]):
                    shared, j = shared + 1, n
            is_flat = is_flat and shared < 3
            if shared == 1:
                j1, j2 = (j + 1) % 3, (j + 2) % 3
                one = minus((points[g, j1, 0], points[g, j1, 1], points[g, j1, 2]), middle)
                two = minus((points[g, j2, 0], points[g, j2, 1], points[g, j2, 2]), middle)
                if sides == 0:
                    ahead = plus(one, two)
                is_flat = is_flat and dot(cross(one, two), up) > 0
                turns += 1 if dot(cross(one, ahead), up) >= 0 and dot(cross(ahead, two), up) >= 0 else 0
                sides += 1
    return is_flat and turns == 1


@kernel_helper
def _measure_ring_clearance(grid: GridTables, weld: Array1[I64], f: I64, middle: Vec3) -> F64:
    """Return the distance of a position from the nearest face outside the ring of face `f`. It is limited to the distance of the
    cubes that are not searched."""
    shape, size, first, face_list, bound, corners = grid[0], grid[1], grid[2], grid[3], grid[4], grid[6]
    width, clearance = shape[3], np.inf
    p = (middle[0] - shape[0]) / width, (middle[1] - shape[1]) / width, (middle[2] - shape[2]) / width
    x, y, z = (round_to_int(np.floor(p[0])), round_to_int(np.floor(p[1])), round_to_int(np.floor(p[2])))
    for axis in range(3):
        part = p[axis] - np.floor(p[axis])
        clearance = min(clearance, (1.0 + min(part, 1.0 - part)) * width)
    for i in range(max(x - 1, 0), min(x + 1, size[0] - 1) + 1):
        for j in range(max(y - 1, 0), min(y + 1, size[1] - 1) + 1):
            row = (i * size[1] + j) * size[2]
            row_begin: I64 = first[row + max(z - 1, 0)]
            row_end: I64 = first[row + min(z + 1, size[2] - 1) + 1]
            for k in range(row_begin, row_end):
                g = face_list[k]
                ball = np.float64(bound[k, 4]), np.float64(bound[k, 5]), np.float64(bound[k, 6])
                gap, far = minus(ball, middle), clearance + np.float64(bound[k, 7]) + shape[4]
                if dot(gap, gap) < far * far:
                    near = (
                        _has_corner(weld, f, weld[3 * g])
                        or _has_corner(weld, f, weld[3 * g + 1])
                        or _has_corner(weld, f, weld[3 * g + 2])
                    )
                    if not near:
                        gap = minus(find_nearest_on_face(corners, g, middle), middle)
                        clearance = min(clearance, np.sqrt(dot(gap, gap)))
    return clearance


@inlined
def _has_corner(weld: Array1[I64], f: I64, v: I64) -> BOOL:
    """Return whether a face has the corner `v`."""
    return weld[3 * f] == v or weld[3 * f + 1] == v or weld[3 * f + 2] == v


@inlined
def prefetch_first_face(rings: RingTables, face: I64) -> None:
    """Prefetch the data that a walk reads of its first face."""
    prefetch(rings[0], 16 * face)
    prefetch(rings[0], 16 * face + 8)


@inlined
def find_hit_by_walk(grid: GridTables, rings: RingTables, start: I64, a: Vec3, w: Vec3) -> tuple[F64, I64]:
    """Return the first hit of a ray, like `find_first_hit`, by a walk over faces. The walk starts at the face below the ray's
    origin `a`. The search for this face begins at the face `start`. If a walk cannot find the hit, the face in the result is
    NEAREST_FACE_UNKNOWN."""
    links, balls = rings[1], rings[2]
    f = _find_face_below(rings, start, a)
    if f < 0 or not _is_in_clear_ball(balls, f, a):
        return np.inf, NEAREST_FACE_UNKNOWN
    plane, _, _ = _load_side_planes(rings, f)
    up = plane[0], plane[1], plane[2]
    h = grid[0][5] / np.sqrt(dot(w, w))
    g, count = f, 0
    while g >= 0 and count < _MAX_WALKED_FACES:
        plane, plane1, plane2 = _load_side_planes(rings, g)
        height, slope = _evaluate_plane(plane, a), _evaluate_plane_slope(plane, w)
        a1, d1 = _evaluate_plane(plane1, a), _evaluate_plane_slope(plane1, w)
        a2, d2 = _evaluate_plane(plane2, a), _evaluate_plane_slope(plane2, w)
        t = -height / slope
        if t > h and t <= 1.0:
            w1, w2 = a1 + t * d1, a2 + t * d2
            least_weight = min(min((1.0 - w1) - w2, w1), w2)
            if least_weight >= _MIN_INSIDE_WEIGHT and _is_in_clear_ball(
                balls, f, (a[0] + t * w[0], a[1] + t * w[1], a[2] + t * w[2])
            ):
                return t, g
            if least_weight > -_MIN_INSIDE_WEIGHT:
                break
        # Weights of the ray's projection along the first face's normal: at the origin, and their change along the ray.
        rise = _evaluate_plane_slope(plane, up)
        r1, r2 = _evaluate_plane_slope(plane1, up) / rise, _evaluate_plane_slope(plane2, up) / rise
        a1, d1, a2, d2 = a1 - r1 * height, d1 - r1 * slope, a2 - r2 * height, d2 - r2 * slope
        a0, d0 = (1.0 - a1) - a2, -d1 - d2
        out0, out1 = -a0 / d0 if d0 < 0 else 1.0, -a1 / d1 if d1 < 0 else 1.0
        face_end = min(min(min(out0, out1), -a2 / d2 if d2 < 0 else 1.0), 1.0)
        w0, w1, w2 = a0 + face_end * d0, a1 + face_end * d1, a2 + face_end * d2
        if face_end == 1.0:
            if min(min(w0, w1), w2) >= _MIN_INSIDE_WEIGHT and _is_in_clear_ball(balls, f, plus(a, w)):
                return np.inf, NO_FACE
            break
        if max(max(min(w0, w1), min(w1, w2)), min(w2, w0)) < _MIN_INSIDE_WEIGHT:
            break
        g = links[WORDS_PER_RING_ROW * g + SIDE_LINK_OFFSET + _find_index_of_minimum(w0, w1, w2)]
        count += 1
    return np.inf, NEAREST_FACE_UNKNOWN


@inlined
def _find_face_below(rings: RingTables, start: I64, place: Vec3) -> I64:
    """Return the face directly below or above a position. The search goes from neighbour to neighbour, beginning at the face
    `start`. Return -1 if there is no such face, or if the position is near a side."""
    f, count = start, 0
    while f >= 0 and count < _MAX_SEARCHED_FACES:
        _, plane1, plane2 = _load_side_planes(rings, f)
        w1, w2 = _evaluate_plane(plane1, place), _evaluate_plane(plane2, place)
        w0 = (1.0 - w1) - w2
        least_weight = min(min(w0, w1), w2)
        if least_weight >= _MIN_INSIDE_WEIGHT:
            return f
        f = (
            np.int64(rings[1][WORDS_PER_RING_ROW * f + SIDE_LINK_OFFSET + _find_index_of_minimum(w0, w1, w2)])
            if least_weight < 0
            else -1
        )
        count += 1
    return -1


@inlined
def _load_side_planes(rings: RingTables, f: I64) -> tuple[Plane, Plane, Plane]:
    """Return the three planes of a face: its own plane, and two planes that give the weights of its second and third corner."""
    x0, y0, z0, c0, x1, y1, z1, c1, x2, y2, z2, c2 = load_consecutive(rings[0], 16 * f, 12)
    return (x0, y0, z0, c0), (x1, y1, z1, c1), (x2, y2, z2, c2)


@inlined
def _evaluate_plane(plane: Plane, place: Vec3) -> F64:
    """Return the plane equation evaluated at a position, as `faces.evaluate_plane` does."""
    return ((plane[0] * place[0] + plane[1] * place[1]) + plane[2] * place[2]) + plane[3]


@inlined
def _evaluate_plane_slope(plane: Plane, displacement: Vec3) -> F64:
    """Return how much the value of a plane changes along a displacement. Same as `faces.evaluate_plane_slope`."""
    return (plane[0] * displacement[0] + plane[1] * displacement[1]) + plane[2] * displacement[2]


@inlined
def _find_index_of_minimum(a: F64, b: F64, c: F64) -> I64:
    """Return the index of the smallest number. Of equal numbers, the first is chosen."""
    return 0 if a <= b and a <= c else (1 if b <= c else 2)


@inlined
def _is_in_clear_ball(balls: Array1[F32], f: I64, place: Vec3) -> BOOL:
    """Return whether a position is in the ball of a face."""
    x, y, z, square = load_consecutive(balls, WORDS_PER_RING_ROW * f + CLEAR_BALL_OFFSET, 4)
    gap = minus(place, (np.float64(x), np.float64(y), np.float64(z)))
    return dot(gap, gap) < np.float64(square)
