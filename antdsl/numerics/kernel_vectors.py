"""Vector functions for kernels. A vector is a tuple of three numbers. Terms are added in the same order as in `vectors.dot`
and `vectors.cross`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from antdsl.machine_code.kernels import F32, F64, I64, Array1, Array2, Strided2, inlined

Vec3 = tuple[F64, F64, F64]
Vec3F32 = tuple[F32, F32, F32]
TriangleWeights = tuple[F64, F64]  # of the second and third corner of a triangle
VectorColumns = tuple[Array1[F32], Array1[F32], Array1[F32]]  # x, y and z of vectors
AnyVec3 = tuple[Any, Any, Any]  # of either float type


class AgentPose(NamedTuple):
    """The position (mm) of an agent, and three unit vectors: its up, its heading, and the direction of its path."""

    position: Vec3
    up: Vec3
    heading: Vec3
    direction: Vec3


_MIN_LENGTH, _STEEP_COSINE = 1e-12, 0.9  # as in `vectors.normalise_or_fallback` and `vectors.find_perpendicular`


@inlined
def load_vector(table: Array1[F64], k: I64) -> Vec3:
    """Return the vector that starts at index `k` of a table."""
    return table[k], table[k + 1], table[k + 2]


@inlined
def get_column(vectors: Any, i: I64) -> Vec3:
    """Return column `i` of vectors (3, n)."""
    return vectors[0, i], vectors[1, i], vectors[2, i]


@inlined
def replace_non_finite_vector(x: Any, y: Any, z: Any) -> Vec3:
    """Return a vector in float64, or the zero vector if any component is not finite."""
    a, b, c = np.float64(x), np.float64(y), np.float64(z)
    is_finite = np.isfinite(a) and np.isfinite(b) and np.isfinite(c)
    return (a if is_finite else 0.0), (b if is_finite else 0.0), (c if is_finite else 0.0)


@inlined
def store_column(vectors: Any, i: I64, v: Vec3) -> None:
    """Write column `i` of vectors (3, n)."""
    vectors[0, i], vectors[1, i], vectors[2, i] = v


@inlined
def plus(a: AnyVec3, b: AnyVec3) -> AnyVec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def minus(a: AnyVec3, b: AnyVec3) -> AnyVec3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def times(a: AnyVec3, factor: Any) -> AnyVec3:
    return a[0] * factor, a[1] * factor, a[2] * factor


@inlined
def dot(a: AnyVec3, b: AnyVec3) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: AnyVec3, b: AnyVec3) -> AnyVec3:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def project_to_plane(a: AnyVec3, up: AnyVec3) -> AnyVec3:
    """Return the component of `a` perpendicular to the unit vector `up`. Same as `vectors.project_to_plane`."""
    return minus(a, times(up, dot(a, up)))


@inlined
def find_perpendicular(up: Vec3) -> Vec3:
    """Return a unit vector perpendicular to `up`, in float64. Same as `vectors.find_perpendicular`."""
    steep = abs(up[0]) > _STEEP_COSINE
    side = project_to_plane(((0.0 if steep else 1.0), (1.0 if steep else 0.0), 0.0), up)
    return times(side, 1 / np.sqrt(dot(side, side)))


@inlined
def normalise_or_perpendicular(v: Vec3, up: Vec3) -> Vec3:
    """Return the unit vector along `v` in float64, or a unit vector perpendicular to `up` if `v` is zero."""
    size = np.sqrt(dot(v, v))
    if size > _MIN_LENGTH and np.isfinite(size):
        return times(v, 1 / size)
    return find_perpendicular(up)


@inlined
def fmax(a: F64, b: F64) -> F64:
    """Return the greater of two numbers, like `np.fmax`. Only `a` may be NaN; the result is then `b`."""
    return a if a > b else b


@inlined
def fmin(a: F64, b: F64) -> F64:
    """Return the lesser of two numbers, like `np.fmin`. Only `a` may be NaN; the result is then `b`."""
    return a if a < b else b


@inlined
def clamp_weights(b1: F64, b2: F64) -> TriangleWeights:
    """Return the barycentric weights `b1` and `b2` moved into the triangle, to correct rounding errors. Both results are at
    least 0, and their sum is at most 1."""
    b1, b2 = min(max(b1, 0.0), 1.0), min(max(b2, 0.0), 1.0)
    total = b1 + b2
    if total > 1.0:
        return b1 / total, b2 / total
    return b1, b2


@inlined
def rotate_between_normals(v: Vec3, source: Vec3, target: Vec3, direction: Vec3) -> Vec3:
    """Return the vector `v` after the smallest rotation that takes the unit normal `source` to `target`. For opposite normals,
    the rotation passes through `direction`."""
    cosine = dot(source, target)
    if cosine < -1 + 1e-9:
        hinge = cross(source, direction)
        return minus(times(hinge, 2 * dot(hinge, v)), v)
    axis = cross(source, target)
    part = dot(axis, v) / (1 + cosine)
    return plus(plus(times(v, cosine), cross(axis, v)), times(axis, part))


@inlined
def normalise_or_first_axis(c: F64, s: F64) -> tuple[F64, F64]:
    """Normalise a direction in the plane of a face. Return the cosine and sine of its angle to the face's first axis; (1, 0)
    for a zero vector.

    `c`, `s`: the components of the direction along the first and second axis of the face. The direction may have any length."""
    size = np.sqrt(c * c + s * s)
    if size > 1e-9:
        return c / size, s / size
    return 1.0, 0.0


@inlined
def find_nearest_weights(edge1: Vec3, edge2: Vec3, v: Vec3) -> tuple[F64, F64, F64]:
    """Find the point of a triangle that is nearest to `v`. Return its barycentric weights for the second and third corner, and
    its distance from `v`.

    `edge1`, `edge2`: the edges from the first corner. `v`: a position relative to the first corner. The nearest point is the
    projection of `v` onto the triangle's plane if this is inside the triangle, else a point on an edge."""
    edge3 = minus(edge2, edge1)
    d11, d12, d22, d33 = dot(edge1, edge1), dot(edge1, edge2), dot(edge2, edge2), dot(edge3, edge3)
    w1, w2 = dot(v, edge1), dot(v, edge2)
    size = d11 * d22 - d12 * d12
    b1, b2 = (d22 * w1 - d12 * w2) / size, (d11 * w2 - d12 * w1) / size
    if not (size > 0 and b1 >= 0 and b2 >= 0 and b1 + b2 <= 1.0):
        one, two = min(max(w1 / d11, 0.0), 1.0), min(max(w2 / d22, 0.0), 1.0)
        three = min(max(dot(minus(v, edge1), edge3) / d33, 0.0), 1.0)
        best = np.inf
        for x, y in ((one, 0.0), (0.0, two), (1.0 - three, three)):
            offset = minus(minus(v, times(edge1, x)), times(edge2, y))
            if dot(offset, offset) < best:
                b1, b2, best = x, y, dot(offset, offset)
    offset = minus(minus(v, times(edge1, b1)), times(edge2, b2))
    return b1, b2, np.sqrt(dot(offset, offset))


@inlined
def divide_vector(a: Vec3, s: F64) -> Vec3:
    """Return the vector `a` divided by the number `s`."""
    return a[0] / s, a[1] / s, a[2] / s


@inlined
def normalise_vector(v: Vec3) -> Vec3:
    """Return a vector scaled to length 1; zero stays zero."""
    return divide_vector(v, max(np.sqrt(dot(v, v)), 1e-300))


@inlined
def get_row64(vectors: Array2[F32], i: I64) -> Vec3:
    """Return row `i` of vectors (n, 3), in float64."""
    return np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])


@inlined
def get_column64(vectors: Strided2[F64], i: I64) -> Vec3:
    """Return column `i` of vectors (3, n), in float64."""
    return np.float64(vectors[0, i]), np.float64(vectors[1, i]), np.float64(vectors[2, i])


@inlined
def rotate_about_axis(v: Vec3, axis: Vec3, c: F64, s: F64) -> Vec3:
    """Return the vector `v` rotated about a unit axis (O. Rodrigues, 1840). `c`, `s`: the cosine and sine of the angle."""
    return plus(plus(times(v, c), times(cross(axis, v), s)), times(axis, dot(axis, v) * (1.0 - c)))
