"""What `faces` and the rays do for faces that Open3D names, as loops: the same float64 operations in the same order."""

from __future__ import annotations

import numpy as np

from antdsl.casting.tolerances import CLOSED
from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, Array3, Strided2, inlined, kernel
from antdsl.numerics.vectors_compiled import dot, minus

# Planes and rims of faces; the place of each corner by number, where the faces at each place begin, and these faces.
Table = tuple[Array3[F64], Array1[F64], Array1[I64], Array1[I64], Array1[I64]]


@kernel
def hits(
    table: Table,
    hair: F64,
    ahead: F64,
    at: Array1[F64],
    origin: Strided2[F64],
    way: Strided2[F64],
    named: Array1[I64],
    here: Array1[F64],
    weights: Array2[F64],
    hit: Array1[BOOL],
    short: Array1[F64],
) -> None:
    """As `Faces.judged`, into the last five arrays: the face, after what part of the way, the weights of its corners, whether
    it is hit, and a hair as a part of the way."""
    planes, rims, weld, first, faces = table
    for i in range(named.size):
        x, y, z = way[i, 0], way[i, 1], way[i, 2]
        a, b, c = origin[i, 0], origin[i, 1], origin[i, 2]
        h = hair / np.sqrt((x * x + y * y) + z * z)
        face = named[i]
        t, w0, w1, w2, least = _crossing(planes, face, a, b, c, x, y, z)
        short[i], here[i], hit[i] = h, t, least >= -CLOSED and abs(t) < np.inf and t > h
        weights[i, 0], weights[i, 1], weights[i, 2] = w0, w1, w2
        if not abs(least) > rims[face]:
            hit[i] = False
            place = weld[3 * face + _heaviest(w0, w1, w2)]
            most = at[i] + ahead * h
            for k in range(first[place], first[place + 1]):
                t, w0, w1, w2, least = _crossing(planes, faces[k], a, b, c, x, y, z)
                good = least >= -CLOSED and abs(t) < np.inf and t > h and (t <= most or faces[k] == face)
                if good and (not hit[i] or t < here[i]):
                    named[i], here[i], hit[i] = faces[k], t, True
                    weights[i, 0], weights[i, 1], weights[i, 2] = w0, w1, w2


@kernel
def nearest(
    table: Table,
    corners: Array3[F64],
    points: Strided2[F64],
    face: Array1[I64],
    place: Array2[F64],
    square: Array1[F64],
) -> None:
    """As `Faces.nearest`, into the last three arrays; `face` holds what Open3D names."""
    planes, rims, weld, first, faces = table
    for i in range(face.size):
        p = (points[i, 0], points[i, 1], points[i, 2])
        f = face[i]
        q = _nearest(corners, f, p)
        d = _square(minus(q, p))
        place[i, 0], place[i, 1], place[i, 2], square[i] = q[0], q[1], q[2], d
        w1, w2 = _along(planes, f, 1, q[0], q[1], q[2]), _along(planes, f, 2, q[0], q[1], q[2])
        w0 = (1.0 - w1) - w2
        if not _least(w0, w1, w2) > rims[f]:
            at = weld[3 * f + _heaviest(w0, w1, w2)]
            begin = True
            for k in range(first[at], first[at + 1]):
                q = _nearest(corners, faces[k], p)
                d = _square(minus(q, p))
                if begin or d < square[i]:
                    face[i], begin = faces[k], False
                    place[i, 0], place[i, 1], place[i, 2], square[i] = q[0], q[1], q[2], d


@inlined
def _along(planes, face, row, x, y, z):  # type: ignore[no-untyped-def]
    return ((planes[face, row, 0] * x + planes[face, row, 1] * y) + planes[face, row, 2] * z) + planes[face, row, 3]


@inlined
def _towards(planes, face, row, x, y, z):  # type: ignore[no-untyped-def]
    return (planes[face, row, 0] * x + planes[face, row, 1] * y) + planes[face, row, 2] * z


@inlined
def _least(a, b, c):  # type: ignore[no-untyped-def]
    """NaN if any is, as `np.minimum` has it."""
    if a != a or b != b or c != c:
        return np.nan
    return min(min(a, b), c)


@inlined
def _heaviest(a, b, c):  # type: ignore[no-untyped-def]
    """As `np.argmax` has it: NaN is the greatest, and the first of equals counts."""
    if a != a or (not (b > a or b != b) and not (c > a or c != c)):
        return 0
    if b != b or (b >= c and c == c):
        return 1
    return 2


@inlined
def _crossing(planes, face, a, b, c, x, y, z):  # type: ignore[no-untyped-def]
    t = -_along(planes, face, 0, a, b, c) / _towards(planes, face, 0, x, y, z)
    w1 = _along(planes, face, 1, a, b, c) + t * _towards(planes, face, 1, x, y, z)
    w2 = _along(planes, face, 2, a, b, c) + t * _towards(planes, face, 2, x, y, z)
    w0 = (1.0 - w1) - w2
    return t, w0, w1, w2, _least(w0, w1, w2)


@inlined
def _square(a):  # type: ignore[no-untyped-def]
    return dot(a, a)


@inlined
def _on(a, v, s):  # type: ignore[no-untyped-def]
    return a[0] + s * v[0], a[1] + s * v[1], a[2] + s * v[2]


@inlined
def _nearest(corners, face, p):  # type: ignore[no-untyped-def]
    """As `nearest_on_triangle`."""
    a = (corners[face, 0, 0], corners[face, 0, 1], corners[face, 0, 2])
    b = (corners[face, 1, 0], corners[face, 1, 1], corners[face, 1, 2])
    c = (corners[face, 2, 0], corners[face, 2, 1], corners[face, 2, 2])
    u, v, w = minus(b, a), minus(c, a), minus(p, a)
    uu, uv, vv, wu, wv = dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v)
    size = uu * vv - uv * uv
    if size > 0:
        s, t = (vv * wu - uv * wv) / size, (uu * wv - uv * wu) / size
        if s >= 0 and t >= 0 and s + t <= 1:
            return _on(_on(a, u, s), v, t)
    best, gap = a, np.inf
    for k in range(3):
        start = a if k == 0 else (b if k == 1 else c)
        side = minus(b if k == 0 else (c if k == 1 else a), start)
        length = dot(side, side)
        s = min(max(dot(minus(p, start), side) / (length if length > 0 else 1.0), 0.0), 1.0)
        place = _on(start, side, s)
        here = _square(minus(place, p))
        if here < gap:
            best, gap = place, here
    return best
