"""The passes of `planes` as loops over agents: the same operations in the same order, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import F32, F64, I64, Array1, Array2, independent, inlined, kernel
from antdsl.numerics.vectors_compiled import cross, direction, dot, flat, put

Vectors32 = tuple[Array1[F32], Array1[F32], Array1[F32]]
Vectors64 = tuple[Array1[F64], Array1[F64], Array1[F64]]
_FASTEST = 1e9  # as `planes`


@inlined
def known(x, y, z):  # type: ignore[no-untyped-def]
    """A vector in float64, 0 where it is no number."""
    a, b, c = np.float64(x), np.float64(y), np.float64(z)
    good = np.isfinite(a) and np.isfinite(b) and np.isfinite(c)
    return (a if good else 0.0), (b if good else 0.0), (c if good else 0.0)


@inlined
def _of(vectors, k):  # type: ignore[no-untyped-def]
    return vectors[0][k], vectors[1][k], vectors[2][k]


@inlined
def _known_of(vectors, k):  # type: ignore[no-untyped-def]
    return known(vectors[0][k], vectors[1][k], vectors[2][k])


@kernel
def stand(
    rows: Array1[I64],
    up: Vectors32,
    heading: Vectors32,
    above: Array2[F64],
    ahead: Array2[F64],
    left: Array2[F64],
    begin: I64,
    end: I64,
) -> None:
    """`Plane.of` some rows, from the `begin`-th to before the `end`-th: their axes (3, n)."""
    for k in independent(begin, end):
        row = rows[k]
        u = _known_of(up, row)
        way = direction(flat(_known_of(heading, row), u), u)
        put(above, k, u)
        put(ahead, k, way)
        put(left, k, cross(u, way))


@kernel
def move(
    rows: Array1[I64],
    velocity: Vectors32,
    max_speed: Array1[F32],
    wish: Vectors64,
    ahead: Vectors64,
    left: Vectors64,
    own: Array2[F64],
    laid: Array2[F64],
    fastest: Array1[F64],
    begin: I64,
    end: I64,
) -> None:
    """`Plane.moves` of some rows, from the `begin`-th to before the `end`-th: velocities (3, n), and their parts and those of the
    wish (4, n)."""
    for k in independent(begin, end):
        row = rows[k]
        v, w, x, y = _known_of(velocity, row), _known_of(wish, k), _of(ahead, k), _of(left, k)
        put(own, k, v)
        laid[0, k], laid[1, k], laid[2, k], laid[3, k] = dot(v, x), dot(v, y), dot(w, x), dot(w, y)
        speed = np.float64(max_speed[row])
        fastest[k] = min(speed if speed > 0.0 else 0.0, _FASTEST)


@kernel
def lift(ahead: Vectors64, left: Vectors64, x: Array1[F64], y: Array1[F64], made: Array2[F32], begin: I64, end: I64) -> None:
    """`Plane.raised`, from the `begin`-th to before the `end`-th, to `made` (3, n)."""
    for k in independent(begin, end):
        for axis in range(3):
            made[axis, k] = np.float32(ahead[axis][k] * x[k] + left[axis][k] * y[k])
