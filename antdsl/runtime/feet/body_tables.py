"""Stores positions and axes of bodies in one table, and converts points between body and world coordinates.

A table is float64[14, n]. The position (mm) and the unit vectors ahead, up and aside have three rows each. The last two rows
are the size (mm), and 1 or 0: 1 if the trunk stays over its feet, 0 if the body has been shifted out of the ground. Body
coordinates are ahead, above and aside, in body lengths."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, F64, I64, Array1, Array2, inlined, kernel, prefetch, simd_range
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.kernel_vectors import (
    Vec3,
    Vec3F32,
    VectorColumns,
    cross,
    dot,
    minus,
    normalise_or_perpendicular,
    project_to_plane,
)
from antdsl.runtime.body_positions import LIFT_REGISTERS, compute_body_positions
from antdsl.runtime.feet.wearers import BodyWearers

POSITION_ROW, UP_ROW = 0, 6  # first of the three rows of the position and of the direction up
SIZE_ROW, TRUNK_PLAY_ROW = 12, 13
_TABLE_ROWS = 14
_MAX_SHIFT_WITH_TRUNK_PLAY = 0.05  # body lengths; with a larger shift, a trunk does not follow the feet
_MIN_SIZE = 1e-12
_F = np.float32


def compute_body_table(population: BodyWearers, buffer_name: str, threads: int) -> NDArray[np.float64]:
    """Return the table of the bodies of a population, float64[14, n].

    `buffer_name`: the name of the buffer for the table. The next call with the same name overwrites the table."""
    n, now = len(population), population.now
    (bodies,) = population.get_buffers(buffer_name, 1, (_TABLE_ROWS, n), np.float64)
    if n:
        columns = vec.get_vector_registers(now, "heading"), vec.get_vector_registers(now, "up"), now["size"]
        work = partial(_write_body_table, np.ascontiguousarray(compute_body_positions(population).T), *columns, bodies)
        parallel.run_in_parts(work, n, threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
        bodies[TRUNK_PLAY_ROW] = 1.0
        if LIFT_REGISTERS[0] in now:
            x, y, z = (now[name].astype(np.float64) for name in LIFT_REGISTERS)
            free = _MAX_SHIFT_WITH_TRUNK_PLAY * np.maximum(bodies[SIZE_ROW], _MIN_SIZE)
            bodies[TRUNK_PLAY_ROW] -= np.minimum(np.sqrt(x * x + y * y + z * z) / free, 1.0)
    return bodies


@kernel
def _write_body_table(
    position: Array2[F64], heading: VectorColumns, up: VectorColumns, size: Array1[F32], bodies: Array2[F64], begin: I64, end: I64
) -> None:
    """Write the columns of the table `bodies` for agents from `begin` to before `end`."""
    for i in simd_range(begin, end):
        place = position[0, i], position[1, i], position[2, i]
        forward = np.float64(heading[0][i]), np.float64(heading[1][i]), np.float64(heading[2][i])
        above = np.float64(up[0][i]), np.float64(up[1][i]), np.float64(up[2][i])
        ahead, straight, aside = compute_orthonormal_axes(forward, above)
        for axis in range(3):
            bodies[axis, i], bodies[3 + axis, i] = place[axis], ahead[axis]
            bodies[6 + axis, i], bodies[9 + axis, i] = straight[axis], aside[axis]
        bodies[12, i] = np.float64(size[i])


@inlined
def compute_orthonormal_axes(heading: Vec3, up: Vec3) -> tuple[Vec3, Vec3, Vec3]:
    """Return the unit vectors ahead, up and aside of a body, which are perpendicular to each other. Ahead has the direction of
    `heading`."""
    ahead = normalise_or_perpendicular(heading, up)
    straight = normalise_or_perpendicular(project_to_plane(up, ahead), ahead)
    return ahead, straight, cross(ahead, straight)


class FootedBody(NamedTuple):
    """A body in world coordinates: its `position` (mm), its unit vectors ahead, up and aside, and its `size` (mm)."""

    position: Vec3
    forward_direction: Vec3
    up: Vec3
    side_direction: Vec3
    size: F64


@inlined
def read_footed_body(bodies: Array2[F64], row: I64) -> FootedBody:
    """Return the body in column `row` of a table."""
    place = bodies[0, row], bodies[1, row], bodies[2, row]
    ahead = bodies[3, row], bodies[4, row], bodies[5, row]
    up = bodies[6, row], bodies[7, row], bodies[8, row]
    aside = bodies[9, row], bodies[10, row], bodies[11, row]
    return FootedBody(place, ahead, up, aside, bodies[12, row])


@inlined
def prefetch_columns(table: Any, rows: I64, group_size: I64, begin: I64, end: I64) -> None:
    """Prefetch the columns from `begin` to before `end` of a table (…, n) with `rows` rows. `group_size`: how many numbers of
    a row one prefetch loads. The kernels of this package read about 100 rows, but a processor automatically prefetches only a
    few."""
    for row in range(rows):
        k = begin
        while k < end:
            prefetch(table, row * table.shape[-1] + k)
            k += group_size


@inlined
def transform_to_world(body: FootedBody, x: F32, y: F32, z: F32) -> Vec3:
    """Return the world position (mm) of a point in body coordinates, given in float32 body lengths."""
    place, ahead, up, aside, size = body
    a, b, c = np.float64(x) * size, np.float64(y) * size, np.float64(z) * size
    return (
        place[0] + ((a * ahead[0] + b * up[0]) + c * aside[0]),
        place[1] + ((a * ahead[1] + b * up[1]) + c * aside[1]),
        place[2] + ((a * ahead[2] + b * up[2]) + c * aside[2]),
    )


@inlined
def transform_to_body(body: FootedBody, position: Vec3) -> Vec3F32:
    """Return a world position (mm) in body coordinates: ahead, above and aside, in float32 body lengths."""
    place, ahead, up, aside, size = body
    by = _F(1.0 / max(size, _MIN_SIZE))
    away = _to_float32(minus(position, place))
    return dot(away, _to_float32(ahead)) * by, dot(away, _to_float32(up)) * by, dot(away, _to_float32(aside)) * by


@inlined
def _to_float32(v: Vec3) -> Vec3F32:
    return _F(v[0]), _F(v[1]), _F(v[2])
