"""The field between the nodes, compiled: the operations of `trilinear` in the same order, so the same bits. Imported only where
wanted."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import F32, F64, I32, I64, Array1, inlined, kernel

# Table, values, origin, nodes that a mm has, and shape of the bricks
Bricks = tuple[Array1[I32], Array1[F32], Array1[F64], F64, tuple[I64, I64, I64]]
Places = tuple[Array1[F64], Array1[F64], Array1[F64]]


@inlined
def _at(place, far):  # type: ignore[no-untyped-def]
    """A place among the nodes of one axis, held to the rim, which what is no number comes to as well."""
    if not place > 0.0:
        place = 0.0
    if place > far - 1.0:
        place = far - 1.0
    return place


@inlined
def _value(table, values, b1, b2, i, j, k):  # type: ignore[no-untyped-def]
    slot = table[((i >> 4) * b1 + (j >> 4)) * b2 + (k >> 4)]
    return np.float64(values[(slot << 12) + (((i & 15) << 8) + ((j & 15) << 4) + (k & 15))])


@inlined
def _cell(bricks, x, y, z):  # type: ignore[no-untyped-def]
    """Values at the eight corners of the cell that a place lies in, and where in it."""
    table, values, origin, inverse, shape = bricks
    nx, ny, nz = shape[0] * 16, shape[1] * 16, shape[2] * 16
    ax = _at((x - origin[0]) * inverse, np.float64(nx))
    ay = _at((y - origin[1]) * inverse, np.float64(ny))
    az = _at((z - origin[2]) * inverse, np.float64(nz))
    i, j, k = min(np.int64(ax), nx - 2), min(np.int64(ay), ny - 2), min(np.int64(az), nz - 2)
    b1, b2 = shape[1], shape[2]
    if (i & 15) != 15 and (j & 15) != 15 and (k & 15) != 15:
        slot = table[((i >> 4) * b1 + (j >> 4)) * b2 + (k >> 4)]
        w = (slot << 12) + (((i & 15) << 8) + ((j & 15) << 4) + (k & 15))
        v = (
            np.float64(values[w]), np.float64(values[w + 1]), np.float64(values[w + 16]), np.float64(values[w + 17]),
            np.float64(values[w + 256]), np.float64(values[w + 257]), np.float64(values[w + 272]), np.float64(values[w + 273]),
        )  # fmt: skip
    else:
        v = (
            _value(table, values, b1, b2, i, j, k), _value(table, values, b1, b2, i, j, k + 1),
            _value(table, values, b1, b2, i, j + 1, k), _value(table, values, b1, b2, i, j + 1, k + 1),
            _value(table, values, b1, b2, i + 1, j, k), _value(table, values, b1, b2, i + 1, j, k + 1),
            _value(table, values, b1, b2, i + 1, j + 1, k), _value(table, values, b1, b2, i + 1, j + 1, k + 1),
        )  # fmt: skip
    return v, ax - i, ay - j, az - k


@inlined
def _mix(a, b, t):  # type: ignore[no-untyped-def]
    return a + (b - a) * t


@kernel
def distance(bricks: Bricks, places: Places, found: Array1[F64]) -> None:
    """Fill `found` with the signed distance at places."""
    x, y, z = places
    for n in range(found.size):
        v, fx, fy, fz = _cell(bricks, x[n], y[n], z[n])
        v0 = _mix(_mix(v[0], v[1], fz), _mix(v[2], v[3], fz), fy)
        found[n] = _mix(v0, _mix(_mix(v[4], v[5], fz), _mix(v[6], v[7], fz), fy), fx)


@kernel
def field(bricks: Bricks, places: Places, d: Array1[F64], gradient: Places) -> None:
    """Fill `d` with the signed distance at places, and the others with its gradient."""
    x, y, z = places
    gx, gy, gz = gradient
    inverse = bricks[3]
    for n in range(d.size):
        v, fx, fy, fz = _cell(bricks, x[n], y[n], z[n])
        d00, d01, d10, d11 = v[1] - v[0], v[3] - v[2], v[5] - v[4], v[7] - v[6]
        v00, v01, v10, v11 = v[0] + d00 * fz, v[2] + d01 * fz, v[4] + d10 * fz, v[6] + d11 * fz
        e0, e1 = v01 - v00, v11 - v10
        v0, v1 = v00 + e0 * fy, v10 + e1 * fy
        g = v1 - v0
        gz[n] = _mix(_mix(d00, d01, fy), _mix(d10, d11, fy), fx) * inverse
        d[n], gx[n], gy[n] = v0 + g * fx, g * inverse, _mix(e0, e1, fx) * inverse
