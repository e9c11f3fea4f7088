"""Queries of triangles in float64: ray intersections, nearest points, and the faces that share a corner. Sums, products,
quotients and roots are in a fixed order. So results have the same bits on every processor and for any batch of queries."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.tolerances import EDGE_WEIGHT_TOLERANCE
from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, Array3, Strided2, inlined, kernel
from antdsl.numerics.kernel_vectors import Vec3, minus
from antdsl.numerics.kernel_vectors import dot as dot_of
from antdsl.numerics.vector_rows import dot, normalise

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

# Share of the largest coordinate: several times the float32 rounding error of a corner, a ray and their intersection
TOLERANCE_PER_COORDINATE = 1e-6
# Tolerances by which faces are widened for rays, so that rounded rays hit them even at an angle of 4 degrees
WIDENING_IN_TOLERANCES = 16.0
_BORDER_WIDTH_IN_TOLERANCES = 20.0  # tolerances; nearer to a side than this, the faces at its end are also tested
HIT_RETEST_DEPTH_IN_TOLERANCES = 40.0  # tolerances; another face up to this far behind a reported face may be the first hit
_MAX_PRECOMPUTED_FACES = 200_000  # with more faces, the tables of each face are computed on demand
_SHARP_CORNER_LIMIT = 1 / 128  # 1 + cosine between the outward directions of two sides; limits how far a sharp corner moves out

# Planes and border widths of faces; vertex number of each corner; start of each vertex's faces in a list; the list.
FaceTable = tuple[Array3[F64], Array1[F64], Array1[I64], Array1[I64], Array1[I64]]


class TriangleFaces:
    """Triangles with corners float64[m,3,3] (mm). `is_short_lived`: build no tables, because few faces will be queried.
    `tolerance` (mm) is proportional to `largest_coordinate` (mm), by default the largest coordinate of all corners."""

    def __init__(self, corners: Floats, is_short_lived: bool = False, largest_coordinate: float | None = None) -> None:
        self.corners = corners
        self.tolerance = TOLERANCE_PER_COORDINATE * (
            float(np.abs(corners).max(initial=0.0)) if largest_coordinate is None else largest_coordinate
        )
        self._is_short_lived = is_short_lived or len(corners) > _MAX_PRECOMPUTED_FACES
        self._normals: Floats | None = None
        self._planes: tuple[Floats, Floats] | None = None
        self._corner_tables: tuple[Index, Index, Index] | None = None

    def compute_widened_corners(self) -> NDArray[np.float32]:
        """Return the corners float32[3m,3] of slightly enlarged triangles, so that rays in float32 miss no face. Each side is
        moved outwards by a few times the tolerance."""
        a, b, c = (self.corners[:, k] for k in range(3))
        normal = normalise(np.cross(b - a, c - a))
        ab, bc, ca = (np.cross(normalise(side), normal) for side in (b - a, c - b, a - c))
        moved_corners = []
        for corner, one, two in ((a, ca, ab), (b, ab, bc), (c, bc, ca)):
            moved_corners.append(
                corner
                + (one + two)
                * (WIDENING_IN_TOLERANCES * self.tolerance / np.maximum(1.0 + dot(one, two), _SHARP_CORNER_LIMIT))[:, None]
            )
        return np.stack(moved_corners, axis=1).reshape(-1, 3).astype(np.float32)

    def get_normals(self, face: Index) -> Floats:
        """Return unit normals [k,3] of faces, by their winding. They are 0 for faces without area."""
        if self._is_short_lived:
            corners = self.corners.take(face, axis=0)
            return normalise(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        if self._normals is None:
            self._normals = normalise(np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]))
        return self._normals.take(face, axis=0)

    def _get_planes_and_borders(self, face: Index) -> tuple[Floats, Floats]:
        """Return the planes of faces (`compute_planes`), and the barycentric weight below which a point counts as near a face's
        border."""
        if self._is_short_lived:
            return self._compute_planes(self.corners.take(face, axis=0))
        if self._planes is None:
            rows, rims = self._compute_planes(self.corners)
            rims[self._find_duplicates()] = np.inf  # a face with a duplicate is never the only face at a point
            self._planes = rows, rims
        rows, rims = self._planes
        return rows.take(face, axis=0), rims.take(face)

    def _compute_planes(self, corners: Floats) -> tuple[Floats, Floats]:
        """Compute the results of `_get_planes_and_borders` for triangles [k,3,3]."""
        rows = compute_planes(corners)
        one, two = rows[:, 1, :3], rows[:, 2, :3]
        both = one + two
        steepest = np.maximum(np.maximum(dot(one, one), dot(two, two)), dot(both, both))
        return rows, _BORDER_WIDTH_IN_TOLERANCES * self.tolerance * np.sqrt(steepest)

    def intersect_planes(
        self, face: Index, origin: Floats, displacement: Floats
    ) -> tuple[Floats, Floats, NDArray[np.bool_], NDArray[np.bool_]]:
        """Intersect rays from `origin` [k,3] along `displacement` [k,3] with the planes of faces.

        Returns the ray parameter in lengths of `displacement`, and the barycentric weights [k,3] of the intersection. Two masks
        tell whether the intersection is inside the face, and whether it is within float32 error of the face's border."""
        rows, rim = self._get_planes_and_borders(face)
        base = ((rows[:, :, 0] * origin[:, 0:1] + rows[:, :, 1] * origin[:, 1:2]) + rows[:, :, 2] * origin[:, 2:]) + rows[:, :, 3]
        rate = (rows[:, :, 0] * displacement[:, 0:1] + rows[:, :, 1] * displacement[:, 1:2]) + rows[:, :, 2] * displacement[:, 2:]
        with np.errstate(all="ignore"):
            t = -base[:, 0] / rate[:, 0]
            weights = base + t[:, None] * rate
            weights[:, 0] = (1.0 - weights[:, 1]) - weights[:, 2]
            least_weights = np.minimum(np.minimum(weights[:, 0], weights[:, 1]), weights[:, 2])
            return t, weights, (least_weights >= -EDGE_WEIGHT_TOLERANCE) & (np.abs(t) < np.inf), ~(np.abs(least_weights) > rim)

    def recompute_reported_hits(
        self, reported_faces: Index, origin: Floats, displacement: Floats, ray_parameters: NDArray[np.floating]
    ) -> tuple[Floats, Floats, NDArray[np.bool_], Floats]:
        """Recompute hits that Open3D reports, on `reported_faces` at approximate `ray_parameters` (in lengths of `displacement`).

        Returns the exact ray parameter, the barycentric weights, whether the ray hits, and the tolerance in lengths of
        `displacement`. Near the border of a reported face, all faces that meet there are tested. The first hit counts, and its
        face replaces that in `reported_faces`."""
        tables = self.build_kernel_tables()
        if tables is not None:
            n = len(reported_faces)
            fractions, tolerances, weights, hit = np.empty(n), np.empty(n), np.empty((n, 3)), np.empty(n, np.bool_)
            write_checked_hits(
                tables, self.tolerance, HIT_RETEST_DEPTH_IN_TOLERANCES, ray_parameters.astype(np.float64), origin, displacement,
                reported_faces, fractions, weights, hit, tolerances,
            )  # fmt: skip
            return fractions, weights, hit, tolerances
        tolerances = self.tolerance / np.sqrt(
            (displacement[:, 0] * displacement[:, 0] + displacement[:, 1] * displacement[:, 1])
            + displacement[:, 2] * displacement[:, 2]
        )
        fractions, weights, hit, is_near_border = self.intersect_planes(reported_faces, origin, displacement)
        hit &= fractions > tolerances
        unsure = np.flatnonzero(is_near_border)
        if unsure.size:
            query, other = self.find_faces_at_corner(reported_faces[unsure], weights[unsure])
            row = unsure[query]
            t, other_weights, inside, _ = self.intersect_planes(other, origin[row], displacement[row])
            near = (t <= ray_parameters[row] + HIT_RETEST_DEPTH_IN_TOLERANCES * tolerances[row]) | (other == reported_faces[row])
            usable = np.flatnonzero(inside & near & (t > tolerances[row]))
            order = usable[np.lexsort((other[usable], t[usable], row[usable]))]
            first = order[np.concatenate(([True], row[order[1:]] != row[order[:-1]]))] if order.size else order
            hit[unsure] = False
            row = row[first]
            reported_faces[row], fractions[row], weights[row], hit[row] = other[first], t[first], other_weights[first], True
        return fractions, weights, hit, tolerances

    def build_kernel_tables(self) -> tuple[Floats, Floats, Index, Index, Index] | None:
        """Return the tables of all faces that kernels read, or None for short-lived faces. They are the planes, the border
        weights, and the arrays that `_weld_corners` returns."""
        if self._is_short_lived:
            return None
        self._get_planes_and_borders(np.empty(0, np.int64))
        assert self._planes is not None and self._corner_tables is not None
        return *self._planes, *self._corner_tables

    def find_nearest(self, points: Floats, face: Index) -> tuple[Floats, Floats, Index]:
        """Return the surface position nearest to each point [k,3], its squared distance and its face. `face`: the nearest face as
        found in float32. The result is this face, or a face that meets it at the nearest position. Of equally near faces, the
        first is returned."""
        tables = self.build_kernel_tables()
        if tables is not None:
            face, place, square = face.copy(), np.empty((len(points), 3)), np.empty(len(points))
            write_nearest_points_on_faces(tables, self.corners, points, face, place, square)
            return place, square, face
        place = find_nearest_on_triangle(points, self.corners.take(face, axis=0))
        gap = place - points
        square = dot(gap, gap)
        rows, rim = self._get_planes_and_borders(face)
        weights = ((rows[:, :, 0] * place[:, 0:1] + rows[:, :, 1] * place[:, 1:2]) + rows[:, :, 2] * place[:, 2:]) + rows[:, :, 3]
        weights[:, 0] = (1.0 - weights[:, 1]) - weights[:, 2]
        border_rows = np.flatnonzero(~(np.minimum(np.minimum(weights[:, 0], weights[:, 1]), weights[:, 2]) > rim))
        if border_rows.size:
            query, other = self.find_faces_at_corner(face[border_rows], weights[border_rows])
            other_places = find_nearest_on_triangle(points[border_rows[query]], self.corners.take(other, axis=0))
            gap = other_places - points[border_rows[query]]
            other_squares = dot(gap, gap)
            order = np.lexsort((other, other_squares, query))
            first = order[np.concatenate(([True], query[1:] != query[:-1]))]  # `query` already ascends
            face = face.copy()
            face[border_rows], place[border_rows], square[border_rows] = other[first], other_places[first], other_squares[first]
        return place, square, face

    def find_faces_at_corner(self, face: Index, weights: Floats) -> tuple[Index, Index]:
        """For each of `face`, find all faces at its corner with the largest weight. Return ascending pairs as two arrays: indices
        into `face`, and numbers of faces at this corner."""
        if self._corner_tables is None:
            self._corner_tables = self._weld_corners()
        weld, first, faces = self._corner_tables
        corner = weld.take(3 * face + np.argmax(weights, axis=1))
        count = first.take(corner + 1) - first.take(corner)
        query = np.repeat(np.arange(face.size), count)
        step = np.arange(query.size) - np.repeat(np.cumsum(count) - count, count)
        return query, faces.take(np.repeat(first.take(corner), count) + step)

    def _find_duplicates(self) -> NDArray[np.bool_]:
        """Return a mask of the faces that have the same corners as another face."""
        if self._corner_tables is None:
            self._corner_tables = self._weld_corners()
        three = np.sort(self._corner_tables[0].reshape(-1, 3), axis=1)
        order = np.lexsort((three[:, 2], three[:, 1], three[:, 0]))
        is_equal = (three[order[1:]] == three[order[:-1]]).all(axis=1)
        is_doubled = np.zeros(len(three), bool)
        is_doubled[order[1:][is_equal]] = is_doubled[order[:-1][is_equal]] = True
        return is_doubled

    def _weld_corners(self) -> tuple[Index, Index, Index]:
        """Weld equal corners. Return the vertex number of each corner, and the faces at each vertex: the start of each vertex in
        a list, and the list."""
        flat = self.corners.reshape(-1, 3)
        order = np.lexsort((flat[:, 2], flat[:, 1], flat[:, 0]))
        new = (flat[order[1:]] != flat[order[:-1]]).any(axis=1)
        number = np.concatenate(([0], np.cumsum(new)))[: len(flat)]
        weld = np.empty(len(flat), np.int64)
        weld[order] = number
        first = np.concatenate(([0], np.cumsum(np.bincount(weld))))
        return weld, first, np.argsort(weld, kind="stable") // 3


def compute_planes(corners: Floats) -> Floats:
    """Return the planes [k,3,4] of triangles [k,3,3], 0 for those without area. The rows of a triangle, multiplied by (x, y, z,
    1), give three values: the height along the normal, and the weights of the second and third corner (D. Baldwin, M. Weber, Fast
    Ray-Triangle Intersections by Coordinate Transformation, JCGT 5(3), 2016)."""
    a, one, two = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, two)
    size = dot(normal, normal)[:, None]
    divisor = np.where(size > 0, size, np.inf)
    rows = np.empty((len(corners), 3, 4))
    for k, row in enumerate((normal, np.cross(two, normal) / divisor, np.cross(normal, one) / divisor)):
        rows[:, k, :3] = row
        rows[:, k, 3] = -dot(row, a)
    return rows


def find_nearest_on_triangle(points: Floats, corners: Floats) -> Floats:
    """Return the point of each triangle [n,3,3] that is nearest to the corresponding point [n,3] (Ericson, Real-Time Collision
    Detection, 2005, p. 136-142)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v, w = b - a, c - a, points - a
    uu, uv, vv, wu, wv = dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v)
    size = uu * vv - uv * uv
    flat = size <= 0
    size = np.where(flat, 1.0, size)
    s, t = (vv * wu - uv * wv) / size, (uu * wv - uv * wu) / size
    inside = ~flat & (s >= 0) & (t >= 0) & (s + t <= 1)
    best = (a + s[:, None] * u) + t[:, None] * v
    outside = np.flatnonzero(~inside)
    if outside.size:
        best[outside] = _find_nearest_on_sides(points[outside], corners[outside])
    return best


def _find_nearest_on_sides(points: Floats, corners: Floats) -> Floats:
    best = np.empty_like(points)
    gap = np.full(len(points), np.inf)
    for k in range(3):
        p = corners[:, k]
        side = corners[:, (k + 1) % 3] - p
        length = dot(side, side)
        s = np.minimum(np.maximum(dot(points - p, side) / np.where(length > 0, length, 1.0), 0.0), 1.0)
        place = p + s[:, None] * side
        offset = place - points
        square = dot(offset, offset)
        is_closer = square < gap
        best[is_closer], gap[is_closer] = place[is_closer], square[is_closer]
    return best


@kernel
def write_checked_hits(
    table: FaceTable, tolerance: F64, retest_tolerances: F64, ray_parameters: Array1[F64], origin: Strided2[F64],
    displacement: Strided2[F64], reported_faces: Array1[I64], fractions: Array1[F64], weights: Array2[F64], hit: Array1[BOOL],
    ray_tolerances: Array1[F64],
) -> None:  # fmt: skip
    """Write the results of `recompute_reported_hits` to the last five arrays: faces, ray parameters, barycentric weights, hit
    flags, and tolerances in lengths of `displacement`."""
    planes, rims, weld, first, faces = table
    for i in range(reported_faces.size):
        x, y, z = displacement[i, 0], displacement[i, 1], displacement[i, 2]
        a, b, c = origin[i, 0], origin[i, 1], origin[i, 2]
        h = tolerance / np.sqrt((x * x + y * y) + z * z)
        face = reported_faces[i]
        t, (w0, w1, w2), least_weight = _intersect_plane(planes, face, a, b, c, x, y, z)
        ray_tolerances[i], fractions[i], hit[i] = h, t, least_weight >= -EDGE_WEIGHT_TOLERANCE and abs(t) < np.inf and t > h
        weights[i, 0], weights[i, 1], weights[i, 2] = w0, w1, w2
        if not abs(least_weight) > rims[face]:
            hit[i] = False
            place = weld[3 * face + _find_largest_index(w0, w1, w2)]
            limit = ray_parameters[i] + retest_tolerances * h
            for k in range(first[place], first[place + 1]):
                t, (w0, w1, w2), least_weight = _intersect_plane(planes, faces[k], a, b, c, x, y, z)
                is_better = (
                    least_weight >= -EDGE_WEIGHT_TOLERANCE and abs(t) < np.inf and t > h and (t <= limit or faces[k] == face)
                )
                if is_better and (not hit[i] or t < fractions[i]):
                    reported_faces[i], fractions[i], hit[i] = faces[k], t, True
                    weights[i, 0], weights[i, 1], weights[i, 2] = w0, w1, w2


@kernel
def write_nearest_points_on_faces(
    table: FaceTable,
    corners: Array3[F64],
    points: Strided2[F64],
    face: Array1[I64],
    positions: Array2[F64],
    squared_distances: Array1[F64],
) -> None:
    """Write the results of `TriangleFaces.find_nearest` to the last three arrays: face, nearest position and squared distance.
    `face` must initially contain the faces that Open3D reports."""
    planes, rims, weld, first, faces = table
    for i in range(face.size):
        p = (points[i, 0], points[i, 1], points[i, 2])
        f = face[i]
        q = find_nearest_on_face(corners, f, p)
        d = compute_squared_length(minus(q, p))
        positions[i, 0], positions[i, 1], positions[i, 2], squared_distances[i] = q[0], q[1], q[2], d
        w1, w2 = evaluate_plane(planes, f, 1, q[0], q[1], q[2]), evaluate_plane(planes, f, 2, q[0], q[1], q[2])
        w0 = (1.0 - w1) - w2
        if not _find_minimum_of_three(w0, w1, w2) > rims[f]:
            vertex = weld[3 * f + _find_largest_index(w0, w1, w2)]
            begin = True
            for k in range(first[vertex], first[vertex + 1]):
                q = find_nearest_on_face(corners, faces[k], p)
                d = compute_squared_length(minus(q, p))
                if begin or d < squared_distances[i]:
                    face[i], begin = faces[k], False
                    positions[i, 0], positions[i, 1], positions[i, 2], squared_distances[i] = q[0], q[1], q[2], d


@inlined
def evaluate_plane(planes: Array3[F64], face: I64, row: I64, x: F64, y: F64, z: F64) -> F64:
    """Return the value of one row of a face's planes at a point: the product of the row's four numbers with (x, y, z, 1)."""
    return ((planes[face, row, 0] * x + planes[face, row, 1] * y) + planes[face, row, 2] * z) + planes[face, row, 3]


@inlined
def evaluate_plane_slope(planes: Array3[F64], face: I64, row: I64, x: F64, y: F64, z: F64) -> F64:
    """Return how much one row of a face's planes changes along a vector: its product with (x, y, z, 0)."""
    return (planes[face, row, 0] * x + planes[face, row, 1] * y) + planes[face, row, 2] * z


@inlined
def _find_minimum_of_three(a: F64, b: F64, c: F64) -> F64:
    """Return the smallest of three numbers, or NaN if any of them is NaN (like `np.minimum`)."""
    if a != a or b != b or c != c:
        return np.nan
    return min(min(a, b), c)


@inlined
def _find_largest_index(a: F64, b: F64, c: F64) -> I64:
    """Return the index of the largest number, like `np.argmax`. NaN counts as the largest. Of equal numbers, the first counts."""
    if a != a or (not (b > a or b != b) and not (c > a or c != c)):
        return 0
    if b != b or (b >= c and c == c):
        return 1
    return 2


@inlined
def _intersect_plane(planes: Array3[F64], face: I64, a: F64, b: F64, c: F64, x: F64, y: F64, z: F64) -> tuple[F64, Vec3, F64]:
    """Return the ray parameter at a face's plane, the barycentric weights there, and the smallest of these weights."""
    t = -evaluate_plane(planes, face, 0, a, b, c) / evaluate_plane_slope(planes, face, 0, x, y, z)
    w1 = evaluate_plane(planes, face, 1, a, b, c) + t * evaluate_plane_slope(planes, face, 1, x, y, z)
    w2 = evaluate_plane(planes, face, 2, a, b, c) + t * evaluate_plane_slope(planes, face, 2, x, y, z)
    w0 = (1.0 - w1) - w2
    return t, (w0, w1, w2), _find_minimum_of_three(w0, w1, w2)


@inlined
def compute_squared_length(a: Vec3) -> F64:
    """Return the square of a vector's length."""
    return dot_of(a, a)


@inlined
def _advance_point(a: Vec3, v: Vec3, s: F64) -> Vec3:
    return a[0] + s * v[0], a[1] + s * v[1], a[2] + s * v[2]


@inlined
def find_nearest_on_face(corners: Array3[F64], face: I64, p: Vec3) -> Vec3:
    """Return the point of a face that is nearest to `p`. Same method as `find_nearest_on_triangle`."""
    a = (corners[face, 0, 0], corners[face, 0, 1], corners[face, 0, 2])
    b = (corners[face, 1, 0], corners[face, 1, 1], corners[face, 1, 2])
    c = (corners[face, 2, 0], corners[face, 2, 1], corners[face, 2, 2])
    u, v, w = minus(b, a), minus(c, a), minus(p, a)
    uu, uv, vv, wu, wv = dot_of(u, u), dot_of(u, v), dot_of(v, v), dot_of(w, u), dot_of(w, v)
    size = uu * vv - uv * uv
    if size > 0:
        s, t = (vv * wu - uv * wv) / size, (uu * wv - uv * wu) / size
        if s >= 0 and t >= 0 and s + t <= 1:
            return _advance_point(_advance_point(a, u, s), v, t)
    best, gap = a, np.inf
    for k in range(3):
        start = a if k == 0 else (b if k == 1 else c)
        side = minus(b if k == 0 else (c if k == 1 else a), start)
        length = dot_of(side, side)
        s = min(max(dot_of(minus(p, start), side) / (length if length > 0 else 1.0), 0.0), 1.0)
        place = _advance_point(start, side, s)
        square = compute_squared_length(minus(place, p))
        if square < gap:
            best, gap = place, square
    return best
