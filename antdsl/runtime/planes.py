"""The plane of its own ground in which an agent sees who is about it: vectors by their parts ahead and to the left."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, F64, I64, Array1, Array2, independent, inlined, kernel
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.kernel_vectors import Vec3, cross, direction, dot, flat, put
from antdsl.numerics.vectors import Vector
from antdsl.runtime.world import Population

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Vectors32 = tuple[Array1[F32], Array1[F32], Array1[F32]]
Vectors64 = tuple[Array1[F64], Array1[F64], Array1[F64]]

_FASTEST = 1e9  # mm/s that count at most


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """How some agents move: their velocities `own` in space, these and those that they wish by their parts ahead and to the left,
    and how fast (mm/s) each may be, float64."""

    own: Vector
    velocity: tuple[Floats, Floats]
    wish: tuple[Floats, Floats]
    fastest: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """The ground of some agents: unit `up`, `ahead` along their heading and `left`, float64."""

    up: Vector
    ahead: Vector
    left: Vector

    @classmethod
    def of(cls, population: Population, rows: Rows, threads: int) -> Plane:
        """That of the agents of some rows, as the step began."""
        up, heading = (vec.named(population.start, name) for name in ("up", "heading"))
        found = np.empty((3, 3, len(rows)))
        parallel.in_parts(partial(_stand, rows, up, heading, *found), len(rows), threads, parallel.LIGHT)
        return cls(*(tuple(each) for each in found))

    def moves(self, population: Population, rows: Rows, wish: Vector, threads: int) -> Moves:
        """How these agents move, with the velocities (mm/s) in space that they wish; what is no number is 0."""
        start = population.start
        velocity, speed = vec.named(start, "velocity"), start["max_speed"]
        wished, n = tuple(np.ascontiguousarray(component, np.float64) for component in wish), len(rows)
        own, laid, fastest = np.empty((3, n)), np.empty((4, n)), np.empty(n)
        work = partial(_move, rows, velocity, speed, wished, self.ahead, self.left, own, laid, fastest)
        parallel.in_parts(work, n, threads, parallel.LIGHT)
        return Moves((own[0], own[1], own[2]), (laid[0], laid[1]), (laid[2], laid[3]), fastest)

    def raised(self, x: Floats, y: Floats, threads: int) -> tuple[NDArray[np.float32], ...]:
        """Vectors of such parts."""
        made = np.empty((3, len(x)), np.float32)
        parallel.in_parts(partial(_lift, self.ahead, self.left, x, y, made), len(x), threads, parallel.LIGHT)
        return tuple(made)


@inlined
def known(x: Any, y: Any, z: Any) -> Vec3:
    """A vector in float64, 0 where it is no number."""
    a, b, c = np.float64(x), np.float64(y), np.float64(z)
    good = np.isfinite(a) and np.isfinite(b) and np.isfinite(c)
    return (a if good else 0.0), (b if good else 0.0), (c if good else 0.0)


@inlined
def _of(vectors: Vectors64, k: I64) -> Vec3:
    return vectors[0][k], vectors[1][k], vectors[2][k]


@inlined
def _known_of(vectors: tuple[Array1[Any], Array1[Any], Array1[Any]], k: I64) -> Vec3:
    return known(vectors[0][k], vectors[1][k], vectors[2][k])


@kernel
def _stand(
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
def _move(
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
def _lift(ahead: Vectors64, left: Vectors64, x: Array1[F64], y: Array1[F64], made: Array2[F32], begin: I64, end: I64) -> None:
    """`Plane.raised`, from the `begin`-th to before the `end`-th, to `made` (3, n)."""
    for k in independent(begin, end):
        for axis in range(3):
            made[axis, k] = np.float32(ahead[axis][k] * x[k] + left[axis][k] * y[k])
