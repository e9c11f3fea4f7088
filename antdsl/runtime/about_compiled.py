"""The nearest others of agents by loops: the same tables as `about` makes of sorted pairs."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, Array2, inlined, kernel
from antdsl.runtime.planes_compiled import known

Vectors64 = tuple[Array1[F64], Array1[F64], Array1[F64]]
Vectors32 = tuple[Array1[F32], Array1[F32], Array1[F32]]
# Of each place in the table: distance, species, id, and which pair of the species' it is; then how many places are taken
Nearest = tuple[Array2[F32], Array2[I64], Array2[I64], Array2[I64], Array1[I64]]


@inlined
def _dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


@kernel
def choose(
    i: Array1[I64], j: Array1[I64], distance: Array1[F32], up: Vectors64, theirs: Vectors32, ids: Array1[I64], number: I64,
    most: Array1[I64], nearest: Nearest,
) -> None:  # fmt: skip
    """Put those of a species' pairs (agent i sees j) that stand on i's side of the ground into the tables of the nearest, at most
    so many of each agent, by distance, then species, then id."""
    far, species, names, pairs, taken = nearest
    for k in range(i.size):
        a, b = i[k], j[k]
        if not _dot((up[0][a], up[1][a], up[2][a]), known(theirs[0][b], theirs[1][b], theirs[2][b])) > 0.0:
            continue
        d, name, at = distance[k], ids[b], taken[a]
        while at > 0:
            before = at - 1
            if far[a, before] < d:
                break
            if far[a, before] == d:
                if species[a, before] < number:
                    break
                if species[a, before] == number and names[a, before] < name:
                    break
            at = before
        if at >= most[a]:
            continue
        last = min(taken[a], most[a] - 1)
        taken[a] = last + 1
        while last > at:
            far[a, last], species[a, last] = far[a, last - 1], species[a, last - 1]
            names[a, last], pairs[a, last] = names[a, last - 1], pairs[a, last - 1]
            last -= 1
        far[a, at], species[a, at], names[a, at], pairs[a, at] = d, number, name, k


@kernel
def lay(
    nearest: Nearest, number: I64, j: Array1[I64], way: Vectors32, ahead: Vectors64, left: Vectors64, moves: BOOL, own: Vectors64,
    theirs: Vectors32, radius: Array1[F64], other: Array1[F64], ids: Array1[I64], same: BOOL, sooner: BOOL, x: Array2[F64],
    y: Array2[F64], vx: Array2[F64], vy: Array2[F64], room: Array2[F64], there: Array2[BOOL], first: Array2[BOOL],
) -> None:  # fmt: skip
    """Fill the columns of `Others` with those in the tables who are of one species: `same` as the agents that ask, else `sooner`
    by name or not."""
    _, species, names, pairs, taken = nearest
    for a in range(taken.size):
        ax, ay, az = ahead[0][a], ahead[1][a], ahead[2][a]
        lx, ly, lz = left[0][a], left[1][a], left[2][a]
        for c in range(taken[a]):
            if species[a, c] != number:
                continue
            k = pairs[a, c]
            b = j[k]
            wx, wy, wz = np.float64(way[0][k]), np.float64(way[1][k]), np.float64(way[2][k])
            x[a, c] = _dot((wx, wy, wz), (ax, ay, az))
            y[a, c] = _dot((wx, wy, wz), (lx, ly, lz))
            if moves:
                tx, ty, tz = known(theirs[0][b], theirs[1][b], theirs[2][b])
                mx, my, mz = own[0][a] - tx, own[1][a] - ty, own[2][a] - tz
                vx[a, c] = _dot((mx, my, mz), (ax, ay, az))
                vy[a, c] = _dot((mx, my, mz), (lx, ly, lz))
            room[a, c] = radius[a] + other[b]
            there[a, c] = True
            first[a, c] = ids[a] < names[a, c] if same else sooner
