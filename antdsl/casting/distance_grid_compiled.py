"""`DistanceGrid.at_least` for one place at a time, as a kernel: the same operations in the same order, and so bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import F32, F64, I64, Array1, independent, inlined, kernel, whole

Columns = tuple[Array1[F32], Array1[F32], Array1[F32]]
Cells = tuple[Array1[F64], Array1[F64], Array1[I64], F64]  # where they begin and end, how many along each axis, and how wide


@kernel
def at_least(places: Columns, cells: Cells, least: Array1[F32], found: Array1[F32], begin: I64, end: I64) -> None:
    """Writes the distances of places from `begin` to before `end`."""
    x, y, z = places
    low, high, size, width = cells
    part = 1.0 / width
    lx, ly, lz, hx, hy, hz = low[0], low[1], low[2], high[0], high[1], high[2]
    nx, ny, nz = size[0], size[1], size[2]
    for n in independent(begin, end):
        px, py, pz = np.float64(x[n]), np.float64(y[n]), np.float64(z[n])
        ix, iy, iz = _inside(px, lx, hx), _inside(py, ly, hy), _inside(pz, lz, hz)
        gx, gy, gz = px - ix, py - iy, pz - iz
        outside = (gx * gx + gy * gy) + gz * gz
        cell = min(_number((ix - lx) * part), nx - 1) * ny + min(_number((iy - ly) * part), ny - 1)
        cell = cell * nz + min(_number((iz - lz) * part), nz - 1)
        away = least[cell]
        found[n] = away
        if outside > 0:
            found[n] = np.float32(np.sqrt(np.float64(away * away) + outside) * (1 - 1e-5))


@inlined
def _number(place):  # type: ignore[no-untyped-def]
    """The number of a cell, of a place among cells that is not below 0."""
    return whole(np.floor(place))


@inlined
def _inside(place, low, high):  # type: ignore[no-untyped-def]
    """As fmin and fmax have it: what is no place lies at the lowest."""
    inside = place if place > low else low
    return inside if inside < high else high
